"""Elements of a mechanism: elements with an exact energy, dampers, and loads, whose work is counted."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from typing import Any, ClassVar, Protocol, Self

import numpy as np
from numpy.typing import ArrayLike

from protochain.core.arrays import Floats, Integers, read_only
from protochain.core.checks import Check
from protochain.core.errors import Fault, MechanicsError
from protochain.core.settings import document_fields
from protochain.mechanics import multibody
from protochain.mechanics.motion import Applied, Load, Phase
from protochain.mechanics.multibody import Frames, Tree, algebra
from protochain.mechanics.multibody.algebra import cross, dot, kernel, scale
from protochain.mechanics.multibody.articulated import Articulated
from protochain.mechanics.multibody.tree import FIRST_MOMENT, MASS
from protochain.mechanisms.bodies import Bodies
from protochain.mechanisms.element_arguments import numbers


class Conservative(Protocol):
    """Elements of one kind, whose forces are minus the gradient of an energy."""

    def add(self, q: Floats, frames: Frames, wrenches: Floats, torques: Floats) -> float:
        """Add wrenches (nb, 6), about the bodies' origins along world axes, and torques (n_v,) in place.

        Returns the energy.
        """


class Damping(Protocol):
    """Elements of one kind, whose forces oppose velocities."""

    def resist(self, frames: Frames, twists: Floats, qd: Floats, wrenches: Floats, torques: Floats) -> None:
        """Add wrenches (nb, 6) and torques (n_v,) in place, from the twists (nb, 6) of the bodies."""


class Memory(Protocol):
    """Memory of an element from step to step, as anchors of friction. It is constant within a step."""

    def begin(self, start: Phase) -> None:
        """Begin a run."""

    def settle(self, at: Phase) -> None:
        """End a step. The start of a run is one, too."""

    def end(self, at: Phase | None) -> None:
        """End a run at a phase from which another may go on. The phase is None after a failure."""

    @property
    def kept(self) -> Any:
        """Memory now, on which forces depend, as a frozen value for the rows of a run."""

    def recall(self, memory: Any) -> None:
        """Restore the forces of a row. None restores forces without a past."""


@document_fields
@dataclass(frozen=True, eq=False)
class Acting:
    """Forces and loads of one element."""

    conservative: Conservative | None = None  # Part with an energy.
    load: Load | None = None  # Part whose work is counted, under the element's name.
    dissipates: bool = False  # Whether the work of the load is dissipation.
    # Whether all of it acts between bodies of the mechanism, so that it conserves their momentum.
    inside: bool = False
    memory: Memory | None = None  # Its memory from step to step.
    damping: Damping | None = None  # Part that is one load with the damping of all other elements.
    friction: Any = None  # Friction of a hinge, combined with all other friction into one load.
    hinges: tuple[str, ...] = ()  # Hinges of a motor, whose torque and power :attr:`Run.motion` shows.


class Element(Protocol):
    """Forces of the user's own, for :meth:`protochain.mechanisms.Mechanism.force`."""

    def bind(self, bodies: Bodies) -> Acting:
        """Return what acts in a mechanism with these bodies, whose names become numbers here."""


@document_fields
@dataclass(frozen=True, eq=False)
class Named:
    """Part of a mechanism, as given: checked by itself, not yet bound to bodies."""

    noun: ClassVar[str] = "element"
    """Name of its kind in messages."""

    name: str  # Name.

    def __init_subclass__(cls, noun: str = "") -> None:
        """Name the kind of a class, by default as its base."""
        cls.noun = noun or cls.noun

    @property
    def label(self) -> str:
        """Its kind and name, for messages."""
        return f'{self.noun} "{self.name}"'

    def refusal(self, problem: str, fault: Fault | None = None) -> MechanicsError:
        """Return the error that names it."""
        return MechanicsError(f"{self.label}: {problem}", fault=fault)

    def fix(self, **values: Any) -> None:
        """Set fields to their checked values."""
        for name, value in values.items():
            object.__setattr__(self, name, value)

    def check(self, **checks: Check) -> None:
        """Check fields, and set them to the checked values."""
        for name, check in checks.items():
            self.fix(**{name: check(getattr(self, name), f"{self.label}: its {name}")})


@document_fields
@dataclass(frozen=True, eq=False)
class Between(Named):
    """Element between points of two bodies."""

    a: tuple[str, ArrayLike]  # Body, or "world", and a point of it, (3,).
    b: tuple[str, ArrayLike]  # Body, or "world", and a point of it, (3,).

    def __post_init__(self) -> None:
        for end in (self.a, self.b):
            if not (isinstance(end, tuple | list) and len(end) == 2 and isinstance(end[0], str)):
                raise self.refusal('give its ends as ("body", (x, y, z))')
        if self.a[0] == self.b[0]:
            raise self.refusal(f'both of its ends are on "{self.a[0]}"; join two bodies')
        for side, (body, at) in (("a", self.a), ("b", self.b)):
            self.fix(**{side: (body, numbers(at, f"{self.label}: its point"))})

    def ends(self, bodies: Bodies) -> tuple[Integers, Floats]:
        """(1, 2) int, (1, 6) float: both bodies, and their points along the axes of the tree's frames."""
        ends = [bodies.number(body, self.label) for body, _ in (self.a, self.b)]
        points = [bodies.inside(b, at) for b, (_, at) in zip(ends, (self.a, self.b), strict=True)]
        return read_only([ends], np.int64), read_only([np.concatenate(points)])


@document_fields
@dataclass(frozen=True, eq=False)
class CustomForce(Named, noun="force"):
    """User-defined forces, as the forces of contacts are.

    Raises
    ------
    MechanicsError
        If the name is already in use, or the element has no ``bind``.
    """

    # Object whose ``bind`` makes forces, with the bodies of the model, or a load as it is.
    element: Element | Load

    def __post_init__(self) -> None:
        if not (isinstance(self.element, Load) or callable(getattr(self.element, "bind", None))):
            raise self.refusal("give a motion.Load, or an object with bind(bodies) -> Acting")

    def bind(self, bodies: Bodies) -> Acting:
        """Return the bound forces of the element."""
        return Acting(load=self.element) if isinstance(self.element, Load) else self.element.bind(bodies)


@dataclass(frozen=True, eq=False)
class Rows:
    """Elements of one kind as rows of arrays, computed by one call of a kernel."""

    @classmethod
    def concatenate(cls, parts: Iterable[Self]) -> Self:
        """All rows of several."""
        columns = zip(*([getattr(part, f.name) for f in fields(cls)] for part in parts), strict=True)
        return cls(*(read_only(np.concatenate(column), column[0].dtype) for column in columns))


def join_rows(parts: Iterable[Any]) -> list[Any]:
    """Return parts in order. Rows of one class become one part, at the place of the first."""
    kinds: dict[Any, list[Any]] = {}
    for part in parts:
        kinds.setdefault(type(part) if isinstance(part, Rows) else id(part), []).append(part)
    return [rows[0] if len(rows) == 1 else rows[0].concatenate(rows) for rows in kinds.values()]


@dataclass(frozen=True, eq=False)
class Sum:
    """Potential of conservative elements: wrenches of all of them are pulled back once."""

    tree: Tree  # Rigid bodies.
    parts: Sequence[Conservative]  # Elements, by kind.

    def __call__(self, q: Floats, factors: Articulated) -> tuple[float, Floats]:
        """Energy and torques (n_v,)."""
        tree = self.tree
        torques = np.zeros(tree.n_v)
        if not self.parts:
            return 0.0, torques
        wrenches = np.zeros((tree.n_bodies, 6))
        energy = 0.0
        for part in self.parts:
            energy += part.add(q, factors.frames, wrenches, torques)
        return energy, torques + multibody.pull_back(tree, factors.frames, wrenches)


@dataclass(frozen=True, eq=False)
class Gravity:
    """Weight of all bodies. Its energy is zero at the world's origin."""

    tree: Tree  # Rigid bodies.
    acceleration: Floats  # (3,): Acceleration of free fall.

    def add(self, q: Floats, frames: Frames, wrenches: Floats, torques: Floats) -> float:
        """Add the weights."""
        energy: float = weigh(self.tree.bodies, frames.rotation, frames.origin, self.acceleration, wrenches)
        return energy


@dataclass(frozen=True, eq=False)
class Dampers(Load):
    """All dampers as one load, with their parts."""

    parts: tuple[Damping, ...] = ()


def damping(tree: Tree, parts: Sequence[Damping]) -> Dampers:
    """Return all dampers as one load."""

    def apply(time: float, q: Floats, qd: Floats, frames: Frames) -> Applied:
        twists = multibody.velocities(tree, frames, qd)
        wrenches, torques = np.zeros((tree.n_bodies, 6)), np.zeros(tree.n_v)
        for part in parts:
            part.resist(frames, twists, qd, wrenches, torques)
        return Applied(wrenches, torques)

    return Dampers(apply, parts=tuple(parts))


@kernel
def weigh(bodies: Floats, rotation: Floats, origin: Floats, gravity: Floats, wrenches: Floats) -> float:
    """Add the weights. Return their energy."""
    energy, g = 0.0, algebra.vector_at(gravity, 0)
    for b in range(len(bodies)):
        turn, mass = algebra.matrix(rotation, b), bodies[b, MASS]
        first = algebra.rotate(turn, algebra.vector(bodies, b, FIRST_MOMENT))
        energy -= mass * dot(g, algebra.vector(origin, b)) + dot(g, first)
        algebra.add_pair(cross(first, g), scale(mass, g), wrenches, b)
    return energy
