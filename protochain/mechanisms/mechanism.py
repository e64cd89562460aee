"""The builder: bodies, hinges and what acts on them, by name, of which it makes a model."""

from collections.abc import Callable, Sequence
from typing import Any

from numpy.typing import ArrayLike

from protochain.arrays import read_only
from protochain.errors import MechanicsError
from protochain.mechanisms import given
from protochain.mechanisms.assemble import KINDS, Body, Hinge, assemble
from protochain.mechanisms.bodies import WORLD
from protochain.mechanisms.connect import connect
from protochain.mechanisms.contact import Contact, Friction, Law
from protochain.mechanisms.elements import Element
from protochain.mechanisms.model import Model
from protochain.mechanisms.parts import Bushing, Driven, Forced, Happening, Pushed, Spring, Torsion, Turned
from protochain.mechanisms.shapes import Ball, Other
from protochain.motion import Load

Point = tuple[str, ArrayLike]
"""Name of a body, or "world", and a point in its axes."""
NOWHERE = (0.0, 0.0, 0.0)


class Mechanism:
    """Builder of mechanisms, in any consistent units.

    Every element has a name, and may be given before the bodies it names. A body without a hinge is free.

    Parameters
    ----------
    gravity : (3,) array_like
        Acceleration of free fall; by default none.

    Examples
    --------
    >>> m = Mechanism(gravity=(0.0, 0.0, -9.81))
    >>> m.body("rod", mass=1.0, com=(0, 0, -0.5), inertia=(1 / 12, 1 / 12, 0))
    >>> m.hinge("pin", parent="world", child="rod", axis=(0, 1, 0), q=0.3)
    >>> run = m.build().simulate(until=1.0, time_step=0.01)
    """

    def __init__(self, gravity: ArrayLike = NOWHERE) -> None:
        self._gravity = given.numbers(gravity, (3,), "gravity")
        self._bodies: dict[str, Body] = {}
        self._hinges: dict[str, Hinge] = {}
        self._drives: dict[str, Driven] = {}
        self._parts: dict[str, Any] = {}
        self._events: dict[str, Happening] = {}

    def body(
        self,
        name: str,
        mass: float,
        com: ArrayLike = NOWHERE,
        inertia: ArrayLike = 0.0,
        position: ArrayLike | None = None,
        rotation: ArrayLike | None = None,
        velocity: ArrayLike | None = None,
        spin: ArrayLike | None = None,
    ) -> None:
        """Add a body.

        Parameters
        ----------
        name : str
            Name.
        mass : float
            Mass; none if a body further out has some that its hinge moves.
        com : (3,) array_like
            Centre of mass, from the body's origin in its own axes. The origin lies on the body's hinge.
        inertia : float, (3,) or (3, 3) array_like
            Tensor about the centre of mass, or its diagonal, or one moment for all axes.
        position, rotation : (3,) and (3, 3) array_like, optional
            Where the origin of a free body starts, and its axes in the world, as columns.
        velocity, spin : (3,) array_like, optional
            Velocity of the origin of a free body, and its angular velocity, world axes.

        Raises
        ------
        MechanicsError
            If the name is taken, or an argument is unphysical.
        """
        given.name_of(name, "body", self._bodies, (WORLD,))
        said = f'body "{name}": its'
        where = {"position": position, "rotation": rotation, "velocity": velocity, "spin": spin}
        self._bodies[name] = Body(
            mass=float(given.not_negative(mass, f"{said} mass")),
            com=given.numbers(com, (3,), f"{said} centre of mass"),
            inertia=given.inertia(inertia, f"{said} inertia"),
            rotation=given.rotation(rotation, f"{said} rotation"),
            says_where=tuple(key for key, value in where.items() if value is not None),
            **{
                key: given.numbers(NOWHERE if where[key] is None else where[key], (3,), f"{said} {key}")
                for key in ("position", "velocity", "spin")
            },
        )

    def hinge(
        self,
        name: str,
        parent: str,
        child: str,
        kind: str = "revolute",
        at: ArrayLike = NOWHERE,
        axis: ArrayLike = (0.0, 0.0, 1.0),
        rotation: ArrayLike | None = None,
        **motion: float,
    ) -> None:
        """Join a body to its parent.

        Parameters
        ----------
        name : str
            Name.
        parent, child : str
            Bodies; the parent may be "world". A body has one inward hinge.
        kind : {"revolute", "prismatic", "screw", "fixed"}
            Kind of its motion.
        at, axis : (3,) array_like
            Origin of the child at q = 0, and the hinge's axis, in the parent's axes.
        rotation : (3, 3) array_like, optional
            Axes of the child at q = 0, as columns, in those of the parent; by default the same.
        **motion : float
            ``q``, ``qd``: coordinate and rate at the start, by default 0; ``pitch``: slide of a screw per
            radian.

        Raises
        ------
        MechanicsError
            If the name is taken, or an argument is unphysical.
        """
        given.name_of(name, "hinge", self._hinges)
        said = f'hinge "{name}": its'
        given.choice(kind, tuple(KINDS), f"{said} kind")
        for key in motion:
            given.choice(key, ("q", "qd", "pitch"), f'hinge "{name}":')
        values = {key: given.number(motion.get(key, 0.0), f"{said} {key}") for key in ("q", "qd", "pitch")}
        if kind == "screw" and values["pitch"] == 0.0:
            raise MechanicsError(f"{said} pitch is zero; give a pitch, or kind revolute")
        if kind != "screw" and "pitch" in motion:
            raise MechanicsError(f"{said} pitch is of screws only; give kind screw")
        if kind == "fixed" and (values["q"] or values["qd"]):
            raise MechanicsError(
                f"{said} q and qd must be zero as it is fixed; give a rotation, or another kind"
            )
        self._hinges[name] = Hinge(
            parent, child, kind, given.numbers(at, (3,), f"{said} place"),
            given.direction(axis, f"{said} axis"), given.rotation(rotation, f"{said} rotation"), **values,
        )  # fmt: skip

    def spring(
        self,
        name: str,
        a: Point,
        b: Point,
        stiffness: float = 0.0,
        rest: float | None = None,
        damping: float = 0.0,
    ) -> None:
        """Join two points by a spring, a damper, or both.

        Parameters
        ----------
        name : str
            Name.
        a, b : tuple of str and (3,) array_like
            Body, or "world", and a point of it.
        stiffness, damping : float
            Force per length, and force per speed, along the line.
        rest : float, optional
            Length without force; by default the length as built.

        Raises
        ------
        MechanicsError
            If the name is taken, or a constant negative.
        """
        said = self._named(name, "spring")
        self._parts[name] = Spring(
            *given.ends(a, b, said), *given.constants(stiffness, damping, said),
            None if rest is None else float(given.not_negative(rest, f"{said} its rest")),
        )  # fmt: skip

    def torsion(
        self, name: str, hinge: str, stiffness: float = 0.0, rest: float | None = 0.0, damping: float = 0.0
    ) -> None:
        """Put a spring, a damper, or both on a hinge: on its angle, or its slide.

        Parameters
        ----------
        name, hinge : str
            Name, and that of the hinge.
        stiffness, damping : float
            Torque per radian (force per length), and per rate.
        rest : float, optional
            Coordinate without torque; None is the coordinate as built.

        Raises
        ------
        MechanicsError
            If the name is taken, or a constant negative.
        """
        said = self._named(name, "torsion")
        self._parts[name] = Torsion(
            hinge, *given.constants(stiffness, damping, said),
            None if rest is None else given.number(rest, f"{said} its rest"),
        )  # fmt: skip

    def bushing(self, name: str, a: Point, b: Point, stiffness: ArrayLike, damping: ArrayLike = 0.0) -> None:
        """Join two bodies by an elastic joint, at rest where the points meet, turned as built.

        Parameters
        ----------
        name : str
            Name.
        a, b : tuple of str and (3,) array_like
            Body, or "world", and a point of it.
        stiffness, damping : (6,) array_like
            Of three rotations, by the rotation vector of a in b, and of three translations, in b's axes.

        Raises
        ------
        MechanicsError
            If the name is taken, or a constant negative.
        """
        said = self._named(name, "bushing")
        self._parts[name] = Bushing(
            *given.ends(a, b, said),
            given.not_negative(stiffness, f"{said} its stiffness", (6,)),
            given.not_negative(damping, f"{said} its damping", (6,)),
        )

    def drive(self, hinge: str, motion: Callable[[float], tuple[float, float, float]]) -> None:
        """Prescribe the motion of a hinge.

        Parameters
        ----------
        hinge : str
            Name of the hinge.
        motion : callable
            Time -> coordinate, rate, acceleration.

        Raises
        ------
        MechanicsError
            If the hinge is driven already, or the motion is not three numbers at the start.
        """
        given.name_of(hinge, "drive of hinge", self._drives)
        self._drives[hinge] = Driven(hinge, motion)

    def load(
        self, name: str, body: str, at: ArrayLike = NOWHERE, force: Any = None, moment: Any = None
    ) -> None:
        """Apply a force at a point of a body, a moment, or both.

        Parameters
        ----------
        name, body : str
            Name, and that of the body.
        at : (3,) array_like
            Point of the body at which the force acts.
        force, moment : (3,) array_like or callable, optional
            Along world axes; or a function of the time, or of the time and the :class:`State`, that returns
            it.

        Raises
        ------
        MechanicsError
            If the name is taken, or nothing acts.
        """
        said = self._named(name, "load")
        if force is None and moment is None:
            raise MechanicsError(f"{said} nothing acts; give a force or a moment")
        self._parts[name] = Pushed(
            name, body, given.numbers(at, (3,), f"{said} its point"),
            given.law(force, (3,), f"{said} its force"), given.law(moment, (3,), f"{said} its moment"),
        )  # fmt: skip

    def torque(self, name: str, hinge: str, value: Any) -> None:
        """Apply a torque at a hinge, between parent and child; a force at a slide.

        Parameters
        ----------
        name, hinge : str
            Name, and that of the hinge.
        value : float or callable
            Torque, or a function of the time, or of the time and the :class:`State`, that returns it.

        Raises
        ------
        MechanicsError
            If the name is taken.
        """
        said = self._named(name, "torque")
        self._parts[name] = Turned(name, hinge, given.law(value, (), f"{said} its value"))

    def contact(
        self, name: str, balls: Sequence[Ball], other: Other, law: Law, friction: Friction | None = None
    ) -> None:
        """Let balls touch a plane, a surface, other balls, or each other.

        Parameters
        ----------
        name : str
            Name.
        balls : sequence of Ball
            Balls, or points, fixed in bodies. Those of one body do not touch each other.
        other : Plane, Surface, sequence of Ball or None
            What they touch; None is each other.
        law, friction : Law, and Friction, optional
            Normal and tangential forces.
        """
        self._named(name, "contact")
        self._parts[name] = Forced(Contact(tuple(balls), other, law, friction, f'contact "{name}"'))

    def force(self, name: str, element: Element | Load) -> None:
        """Add forces of one's own, as contacts are.

        Parameters
        ----------
        name : str
            Name.
        element : Element or Load
            What ``bind`` makes forces of, with the bodies of the model; or a load as it is.

        Raises
        ------
        MechanicsError
            If the name is taken, or the element has no ``bind``.
        """
        said = self._named(name, "force")
        if not (isinstance(element, Load) or callable(getattr(element, "bind", None))):
            raise MechanicsError(f"{said} give a motion.Load, or an object with bind(bodies) -> Acting")
        self._parts[name] = Forced(element)

    def on(
        self, name: str, value: Callable[..., float], jump: Callable[..., Any], passes: bool = False
    ) -> None:
        """Let something happen when a value falls through zero.

        Parameters
        ----------
        name : str
            Name.
        value : callable
            :class:`State` -> float, positive before the event.
        jump : callable
            :class:`State` -> velocities (n_v,) from which the motion goes on, or None if it goes on as it
            was.
        passes : bool
            Whether the motion goes on below zero, as past a mark; otherwise the value must rise again.

        Raises
        ------
        MechanicsError
            If the name is taken, or one is no function.
        """
        given.name_of(name, "event", self._events)
        for what, function in (("value", value), ("jump", jump)):
            if not callable(function):
                raise MechanicsError(f'event "{name}": its {what} must be a function of the state')
        self._events[name] = Happening(name, value, jump, passes)

    def build(self) -> Model:
        """Make a model, which no later change of the builder reaches.

        Returns
        -------
        Model
            Bodies, elements and events, with the state at the start.

        Raises
        ------
        MechanicsError
            If an element names what there is not, bodies and hinges are no trees, or a body has no inertia.
        """
        if not self._bodies:
            raise MechanicsError("the mechanism is empty; add a body by body()")
        for name in self._drives:
            if name not in self._hinges:
                raise MechanicsError(f'drive: there is no hinge "{name}"; add it by hinge()')
            hinge = self._hinges[name]
            if hinge.kind == "fixed":
                raise MechanicsError(f'drive: hinge "{name}" is fixed; give it another kind')
        starts = {name: drive.start() for name, drive in self._drives.items()}
        for name, start in starts.items():
            hinge = self._hinges[name]
            if any(has != 0.0 and has != is_ for has, is_ in zip((hinge.q, hinge.qd), start, strict=True)):
                raise MechanicsError(
                    f'hinge "{name}": its drive begins at q = {start[0]:g}, qd = {start[1]:g}, not at those '
                    "given; leave them to the drive"
                )
        bodies, q, qd = assemble(self._bodies, self._hinges, starts)
        return connect(bodies, q, qd, read_only(self._gravity), self._parts, self._drives, self._events)

    def _named(self, name: str, kind: str) -> str:
        return f'{kind} "{given.name_of(name, kind, self._parts, ("drives", "damping"))}":'
