"""The builder: bodies, hinges and what acts on them, by name, of which it makes a model."""

import inspect
from collections.abc import Callable, Collection, Iterator
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Concatenate, ParamSpec, Self, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from protochain.core.checks import brief
from protochain.core.errors import MechanicsError
from protochain.mechanisms.assemble import NOWHERE, Body, Hinge, assemble
from protochain.mechanisms.bodies import WORLD
from protochain.mechanisms.bushing import Bushing
from protochain.mechanisms.closing import Closing, close_loops
from protochain.mechanisms.contact import Contact
from protochain.mechanisms.element_arguments import numbers
from protochain.mechanisms.elements import CustomForce, Named
from protochain.mechanisms.event import Event
from protochain.mechanisms.hinge_friction import HingeFriction
from protochain.mechanisms.hinge_springs import Stop, Torsion
from protochain.mechanisms.linear_springs import Spring
from protochain.mechanisms.loads import AppliedForce, HingeTorque
from protochain.mechanisms.mjcf_files import read_mjcf
from protochain.mechanisms.mjcf_text import mjcf
from protochain.mechanisms.model import Model, model_of
from protochain.mechanisms.motors import Driven, Motor
from protochain.mechanisms.robot_files import read_urdf

P = ParamSpec("P")
T = TypeVar("T")
_RESERVED: dict[type[Named], tuple[str, ...]] = {
    Body: (WORLD,), Hinge: (), Closing: (), Driven: (), Named: ("drives", "damping", "hinge friction"),
    Event: (),
}  # fmt: skip
"""Kinds of parts, of which elements are Named -> names that they must not have."""


def _adds(make: Callable[P, Named], doc: str) -> Callable[Concatenate["Mechanism", P], None]:
    """Method that makes a part of its arguments and adds it, with the docstring of the part."""

    def method(self: "Mechanism", *args: P.args, **kwargs: P.kwargs) -> None:
        for name in kwargs.keys() - arguments.parameters.keys():
            near = get_close_matches(name, arguments.parameters, 1)
            part_name = kwargs.get("name", args[0] if args else "")
            noun = getattr(make, "noun", "element")
            remedy = near[0] if near else ", ".join(arguments.parameters)
            raise MechanicsError(f'{noun} "{part_name}": there is no argument {name}; give {remedy}')
        self.add(make(*args, **kwargs))

    arguments = inspect.signature(make)
    first = inspect.Parameter("self", inspect.Parameter.POSITIONAL_OR_KEYWORD)
    signature = arguments.replace(parameters=[first, *arguments.parameters.values()], return_annotation=None)
    method.__signature__ = signature  # type: ignore[attr-defined]  # which functions have
    method.__doc__ = "\n\n".join([doc, *(make.__doc__ or "").split("\n\n")[1:]])
    return method


class Mechanism:
    """Builder of mechanisms, in any consistent units.

    Every element has a name, and may be given before the bodies it names. A body without a hinge is free.

    Parameters
    ----------
    gravity : (3,) array_like
        Acceleration of free fall. By default none.
    units : {"rad", "deg"}
        Of angles of hinges and their rates, given and shown: coordinates, drives, targets, rests and limits.
        Stiffness, damping and pitch are by radian, and ``spin`` is in radians, in either.

    Examples
    --------
    >>> m = Mechanism(gravity=(0.0, 0.0, -9.81))
    >>> m.body("rod", mass=1.0, com=(0, 0, -0.5), inertia=(1 / 12, 1 / 12, 0))
    >>> m.hinge("pin", parent="world", child="rod", axis=(0, 1, 0), q=0.3)
    >>> run = m.build().simulate(until=1.0, time_step=0.01)
    """

    def __init__(self, gravity: ArrayLike = NOWHERE, units: str = "rad") -> None:
        if units not in ("rad", "deg"):
            raise MechanicsError(f"units {brief(units)}: give rad or deg")
        self._gravity = numbers(gravity, "gravity")
        self.degrees = units == "deg"
        """Whether angles are in degrees."""
        self._parts: dict[type[Named], dict[str, Any]] = {kind: {} for kind in _RESERVED}
        self.left_out: dict[str, str] = {}
        """Parts of the file that the mechanism does not have: kind -> an example's name."""

    @classmethod
    def from_urdf(
        cls,
        source: str | Path,
        gravity: ArrayLike = (0.0, 0.0, -9.81),
        free: bool = False,
        stops: float = 0.0,
        leave_out: Collection[str] = (),
    ) -> Self:
        """Read a robot from a URDF: links as bodies, joints as hinges, in m, kg and s.

        Parameters
        ----------
        source : str or Path
            File, or its text.
        gravity : (3,) array_like
            As of the class.
        free : bool
            Whether links without a joint inward are free. Otherwise they are fixed to the world.
        stops : float
            Stiffness of stops at limits of joints. Without it limits have no effect.
        leave_out : collection of str
            Kinds to go on without, as ``mimic``. Looks of bodies, their contact geometry, and transmissions
            are always skipped.

        Returns
        -------
        Mechanism
            To which more can be added, with damping and friction of joints. An inertia that no body has, as
            of a dummy link, is used as it is, with an ``InertiaWarning`` that names the link.

        Raises
        ------
        MechanicsError
            If the file is invalid, or has unsupported parts.
        """
        mechanism = cls(gravity)
        read_urdf(mechanism, source, free, stops, leave_out)
        return mechanism

    @classmethod
    def from_mjcf(
        cls, source: str | Path, stops: float = 0.0, leave_out: Collection[str] = (), units: str = "rad"
    ) -> Self:
        """Read a model from an MJCF by MuJoCo, of the extra ``robots``.

        Bodies have the frames of the file. If a joint is not at its body's origin, or one of several, a body
        without mass is between. Equality constraints close loops exactly. Flags, defaults and settings of the
        compiler act as in MuJoCo. Everything else that the file has is refused by its kind, or listed in
        :attr:`left_out`.

        Parameters
        ----------
        source : str or Path
            File, or its text.
        stops : float
            As of :meth:`from_urdf`.
        leave_out : collection of str
            Kinds that move bodies, to go on without: ``armature``, ``tendons``, ``equality``, ``gravcomp``,
            ``flex``, ``fluid``, ``plugins``, ``polynomials``, ``springyield``, ``resistance of balls`` (their
            friction and limits), ``friction of free bodies``. Parts without an effect are listed only:
            actuators (but their armature and damping), contacts, limits without ``stops``, sensors,
            keyframes, mocap, sleep and inactive equalities.
        units : {"rad", "deg"}
            As of the class.

        Returns
        -------
        Mechanism
            With springs, dampers, friction and armature of joints, and gravity.

        Raises
        ------
        MechanicsError
            If MuJoCo is not there or does not read the file, or the file has unsupported parts.
        """
        mechanism = cls(units=units)
        read_mjcf(mechanism, source, stops, leave_out)
        return mechanism

    to_mjcf = mjcf

    def set_gravity(self, gravity: ArrayLike) -> None:
        """Change the acceleration of free fall (3,)."""
        self._gravity = numbers(gravity, "gravity")

    def parts(self, kind: type[T]) -> Iterator[T]:
        """Yield the parts of a kind, in the order given."""
        for group in self._parts.values():
            yield from (part for part in group.values() if isinstance(part, kind))

    def add(self, part: Named) -> None:
        """Add a part: an element with ``bind``, a body, a hinge, a drive or an event.

        Parameters
        ----------
        part : Named
            Part with a name, as :class:`Spring`, or of a class of one's own that derives from :class:`Named`
            and has ``bind(bodies) -> Acting``.

        Raises
        ------
        MechanicsError
            If the name is already in use.
        """
        kind = next(kind for kind in type(part).__mro__ if kind in self._parts)
        group, name, noun = self._parts[kind], part.name, part.noun
        if not isinstance(name, str) or not name:
            raise MechanicsError(f"the name {brief(name)} of a {noun}: give a text")
        if name in _RESERVED[kind]:
            raise MechanicsError(f'"{name}" is reserved; give another name to the {noun}')
        if name in group:
            raise MechanicsError(f"{part.label} is named twice; give each a different name")
        group[name] = part

    body = _adds(Body, "Add a body.")
    hinge = _adds(Hinge, "Join a body to its parent.")
    close = _adds(Closing, "Close a loop: join two bodies of the tree, or one to the world, by a joint.")
    spring = _adds(Spring, "Join two points by a spring, a damper, or both.")
    torsion = _adds(Torsion, "Put a spring, a damper, or both on a hinge: on its angle, or its slide.")
    bushing = _adds(Bushing, "Join two bodies by an elastic joint, at rest where the points meet, as built.")
    load = _adds(AppliedForce, "Apply a force at a point of a body, a moment, or both.")
    torque = _adds(HingeTorque, "Apply a torque at a hinge, between parent and child; a force at a slide.")
    motor = _adds(Motor, "Let motors of hinges follow a motion: PD, and feed-forward by inverse dynamics.")
    stop = _adds(Stop, "Limit a hinge: stops push back beyond its limits.")
    friction = _adds(HingeFriction, "Put friction in a hinge: Coulomb's, by its forces too, and viscous.")
    contact = _adds(Contact, "Let balls touch a plane, a surface, other balls, or each other.")
    force = _adds(CustomForce, "Add forces of one's own.")
    on = _adds(Event, "Let something happen when a value falls through zero.")

    def drive(self, hinge: str, motion: Callable[[float], tuple[float, float, float]]) -> None:
        """Prescribe the motion of a hinge: time -> coordinate, rate, acceleration."""
        self.add(Driven(hinge, motion))

    def build(self) -> Model:
        """Make a model, which no later change of the builder reaches.

        Returns
        -------
        Model
            Bodies, elements and events, with the state at the start.

        Raises
        ------
        MechanicsError
            If an element names an unknown part, or one of the wrong kind, as a torsion at a fixed hinge. If
            bodies and hinges are not trees, or a body has no inertia.
        """
        bodies, hinges, closings, drives, others, events = self._parts.values()
        if not bodies:
            raise MechanicsError("the mechanism is empty; add a body by body()")
        starts = {}
        for name, driven in drives.items():
            if name not in hinges:
                raise MechanicsError(f'drive: there is no hinge "{name}"; add it by hinge()')
            hinge = hinges[name]
            if hinge.kind in ("fixed", "ball"):
                raise MechanicsError(f'drive: hinge "{name}" is {hinge.kind}; give it another kind')
            q, qd, _ = driven.at(0.0)
            if any(has not in (0.0, is_) for has, is_ in ((hinge.q, q), (hinge.qd, qd))):
                raise MechanicsError(
                    f'hinge "{name}": its drive begins at q = {q:g}, qd = {qd:g}, not at the given values; '
                    "remove q and qd of the hinge"
                )
            unit = np.pi / 180.0 if self.degrees and hinge.kind != "prismatic" else 1.0
            starts[name] = unit * q, unit * qd
        tree = assemble(bodies, hinges, starts, self._gravity, self.degrees)
        # Springs first, kind by kind, in whatever order they are given: so their sums are rounded alike.
        first = (Spring, Torsion, Bushing)
        elements = [one for kind in first for one in others.values() if isinstance(one, kind)]
        elements += [one for one in others.values() if not isinstance(one, first)]
        closed = close_loops(tree, [*closings.values()])
        return model_of(closed, elements, list(drives.values()), tuple(events.values()))
