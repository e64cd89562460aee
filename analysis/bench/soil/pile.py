"""Many free cubes that touch each other, fixed planes, and plates on bodies that move: a soil.

A contact has the points of :mod:`protochain.mechanisms.box_kernels`. At each a spring and a damper push along
the normal; together, at the centre of pressure, anchored springs resist sliding and turning about the normal,
up to friction times the force. Cundall, Strack, Geotechnique 29:47 (1979), for boxes.
"""

from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from bench.soil.box_volume import WHOLE
from bench.soil.contact import N_MEMORY
from bench.soil.kernels import DONE, LISTS, TOO_DEEP, Boards, Cubes, Lists, Planes, carry_over, march
from bench.soil.parts import Heap, Law, Motion, Plates, Sleep, check_boxes
from protochain.core.arrays import Floats, Integers, Value, floats, freeze, read_only
from protochain.core.checks import at_least, brief, number
from protochain.core.errors import Fault, MechanicsError
from protochain.mechanics.motion.system import StepTooLargeError
from protochain.mechanisms.search import in_order, touching

SKIN = 0.15
"""How far apart cubes may be that are on a list, in edges. Longer lists last longer."""
FACES_PREFERRED = 1e-2
"""Half edges by which a contact of two edges must be shallower than one with a face, to be taken: of bodies
almost flat upon each other either may be, but only a face carries. Cubes on each other tilt by less."""
DEEPEST = 1.0
"""Deepest contact, in half edges: beyond it, the shortest way out may be through the body."""
STIFFEST = 50.0
"""Stiffness of a cube's fastest mode, in those of one contact, where six faces are pressed: each pushes and
rubs, also against turning, and gives way from both sides."""


_OWN = (
    *("position", "quaternion", "velocity", "spin", "acceleration", "asleep", "still"),
    *("plane_memory", "sums"),
)
"""Arrays of a heap that steps change in place; the first are those of :class:`Cubes`."""


@dataclass(frozen=True, eq=False)
class Pile(Value):
    """Cubes, and what they may touch.

    edge, mass (n,): Edges and masses of the cubes; homogeneous.
    law: How contacts push and rub.
    gravity (3,).
    normal (p, 3): Outward normals of fixed half spaces, the ground and walls.
    offset (p,): Their surfaces are normal . x = offset.
    plates: Boxes on bodies that move.
    sleep: When cubes at rest are left out; never by default.
    """

    edge: Floats
    mass: Floats
    law: Law
    gravity: Floats
    normal: Floats = field(default_factory=lambda: np.empty((0, 3)))
    offset: Floats = field(default_factory=lambda: np.empty(0))
    plates: Plates = field(default_factory=Plates)
    sleep: Sleep | None = None

    def __post_init__(self) -> None:
        n, p = np.size(self.edge), np.size(self.offset)
        if not isinstance(self.law, Law):
            raise MechanicsError(f"law {brief(self.law)}: give one of pile_parts, as Law(1e5, 0.5)")
        for name, shape in (
            ("edge", (n,)), ("mass", (n,)), ("gravity", (3,)), ("normal", (p, 3)), ("offset", (p,)),
        ):  # fmt: skip
            object.__setattr__(self, name, read_only(floats(getattr(self, name), shape, name)))
        if not np.isfinite(self.gravity).all():
            raise MechanicsError(f"gravity {self.gravity} must be finite")
        for name in ("edge", "mass"):
            wrong = ~((getattr(self, name) > 0.0) & np.isfinite(getattr(self, name)))
            if np.any(wrong):
                i = int(np.argmax(wrong))
                raise MechanicsError(
                    f"cube {i}: its {name} {getattr(self, name)[i]:g} must be positive and finite"
                )
        flat = ~(np.abs(np.linalg.norm(self.normal, axis=1) - 1.0) <= 1e-9)
        if np.any(flat):
            raise MechanicsError(f"plane {int(np.argmax(flat))}: its normal must have unit length")

    @property
    def longest_step(self) -> float:
        """Longest time step that is stable where cubes press from all sides.

        Of central differences with damping ratio z: 2/w (sqrt(1 + z^2) - z).
        """
        lightest = float(np.min(self.mass, initial=np.inf))
        ratio = self.law.damping * np.sqrt(0.5 * STIFFEST)
        return float(2.0 * np.sqrt(lightest / self.law.stiffness / STIFFEST) * (np.hypot(1.0, ratio) - ratio))

    def kinetic(self, heap: Heap) -> float:
        """Kinetic energy."""
        turning = self.mass * self.edge**2 / 6.0
        return 0.5 * float(
            self.mass @ np.sum(heap.velocity**2, axis=1) + turning @ np.sum(heap.spin**2, axis=1)
        )

    def potential(self, heap: Heap) -> float:
        """Energy in gravity's field."""
        return -float(self.mass @ (heap.position @ self.gravity))

    def total(self, heap: Heap) -> float:
        """Energy that is left, plus what was lost, minus what plates have done: constant but for errors."""
        return self.kinetic(heap) + self.potential(heap) + heap.stored + heap.dissipated - heap.work

    def start(
        self,
        position: ArrayLike,
        rotation: ArrayLike | None = None,
        velocity: ArrayLike | None = None,
        spin: ArrayLike | None = None,
        motion: Motion | None = None,
    ) -> Heap:
        """Heap of cubes as they are given: position (n, 3), rotation (n, 3, 3), velocity, spin (n, 3)."""
        from scipy.spatial.transform import Rotation

        n = len(self.edge)
        turns = np.broadcast_to(np.eye(3), (n, 3, 3)) if rotation is None else rotation
        turns = floats(turns, (n, 3, 3), "rotation")
        x = floats(position, (n, 3), "position")
        check_boxes(x, turns, np.repeat(self.edge[:, None], 3, axis=1))
        quaternion = np.roll(Rotation.from_matrix(turns).as_quat(), 1, axis=1) if n else np.empty((0, 4))
        still = np.zeros((n, 3))
        v = floats(still if velocity is None else velocity, (n, 3), "velocity")
        w = floats(still if spin is None else spin, (n, 3), "spin")
        heap = Heap(
            0.0, x, quaternion, v, w, np.zeros((n, 6)), np.zeros(n, np.int64), np.zeros(n),
            np.zeros(n + 1, np.int64), np.empty(0, np.int64), np.empty((0, N_MEMORY)),
            np.zeros((n * len(self.offset), N_MEMORY)), np.zeros(5),
        )  # fmt: skip
        return self._advance(heap, 0, 0.0, motion and Motion(*(a[:1] for a in motion)))[0]

    def advance(
        self, heap: Heap, steps: int, time_step: float, motion: Motion | None = None
    ) -> tuple[Heap, Floats]:
        """Take steps.

        -> (steps, nb, 6): Moment about the origin of each body's frame, and force, on the bodies, at the end
            of each step.
        """
        if not isinstance(heap, Heap):
            raise MechanicsError(f"heap {brief(heap)}: give one, as start() makes it")
        steps, time_step = at_least(0)(steps, "steps"), number(time_step, "time_step")
        if not 0.0 < time_step <= self.longest_step * (1.0 + 1e-9):
            raise StepTooLargeError(
                f"the time step {time_step:g} must be positive and at most {self.longest_step:.3g}, "
                "by mass and stiffness of the lightest cube"
            )
        after, reaction = self._advance(heap, steps, time_step, motion)
        return after, reaction[1:]

    def _advance(self, heap: Heap, steps: int, h: float, motion: Motion | None) -> tuple[Heap, Floats]:
        """Take steps; none: only find the forces."""
        motion = self._moments(motion, steps)
        own = {name: getattr(heap, name).copy() for name in _OWN}
        lists = (heap.start, heap.other, heap.memory.copy())
        plate = np.column_stack([self.plates.centre, self.plates.rotation.reshape(-1, 9), self.plates.half])
        reaction = np.zeros((steps + 1, motion.origin.shape[1], 6))
        cubes = Cubes(0.5 * self.edge, self.mass, *(own[name] for name in _OWN[:7]))
        planes = Planes(np.column_stack([self.normal, self.offset]), own["plane_memory"])
        plates = Boards(self.plates.body, plate, *motion)
        skin = SKIN * float(np.min(self.edge, initial=np.inf)) if len(self.edge) else 1.0
        s, drifted = min(steps, 1), False
        gx, gy, gz = map(float, self.gravity)
        why, then, placed = LISTS, np.empty(0), np.empty(0)
        while why == LISTS:
            placed = self._placed(motion, s if drifted else 0 if s <= 1 else s - 1)
            then = own["position"].copy()
            lists = self._lists(then, placed, skin, lists)
            s, why, i, j, depth = march(
                s, steps if steps else -1, drifted, h, cubes, planes, plates,
                Lists(*lists, then, placed, skin), self._numbers, (gx, gy, gz), reaction, own["sums"],
            )  # fmt: skip
            drifted = True
        time = heap.time + (s if steps else 0) * h
        if why != DONE:
            self._refuse(why, i, j, depth, time)
        start, other, memory = lists
        values: dict[str, Any] = {name: freeze(array) for name, array in own.items()}
        end = replace(
            heap, time=heap.time + steps * h, start=start, other=other, memory=freeze(memory), **values
        )
        return end, reaction

    @property
    def _numbers(self) -> Floats:
        law = self.law
        sleep = (
            (self.sleep.speed, self.sleep.acceleration, self.sleep.time) if self.sleep else (0.0, 0.0, -1.0)
        )
        k = law.stiffness
        own = k, law.tangential * k, law.damping, law.friction, FACES_PREFERRED, DEEPEST
        return np.array([*own, *sleep, law.by == "volume"])

    def _moments(self, motion: Motion | None, steps: int) -> Motion:
        """Motion of as many bodies as plates need, for these steps."""
        if motion is None:
            if self.plates.n_bodies:
                raise MechanicsError("the plates are on bodies; give their motion")
            motion = Motion(
                np.zeros((steps + 1, 0, 3)), np.zeros((steps + 1, 0, 3, 3)), np.zeros((steps + 1, 0, 6))
            )
        nb = motion.origin.shape[1]
        if nb < self.plates.n_bodies:
            raise MechanicsError(f"plates are on body {self.plates.n_bodies - 1}, but {nb} bodies move")
        shapes = ((steps + 1, nb, 3), (steps + 1, nb, 3, 3), (steps + 1, nb, 6))
        return Motion(
            *(
                floats(a, shape, f"motion: {n}")
                for a, shape, n in zip(motion, shapes, Motion._fields, strict=True)
            )
        )

    def _placed(self, motion: Motion, s: int) -> Floats:
        """(m, 12) float: centres and rotations of the plates at moment s."""
        body, rotation = self.plates.body, motion.rotation[s]
        centre = motion.origin[s][body] + np.einsum("mij,mj->mi", rotation[body], self.plates.centre)
        turned = rotation[body] @ self.plates.rotation
        return np.column_stack([centre, turned.reshape(-1, 9)])

    def _lists(
        self, x: Floats, placed: Floats, skin: float, before: Any
    ) -> tuple[Integers, Integers, Floats]:
        """Neighbours of each cube that may touch before anything moves by half the skin, and their memory."""
        n, radius = len(x), 0.5 * np.sqrt(3.0) * self.edge
        found = [touching(x, radius + 0.5 * skin)]
        for m, row in enumerate(placed):
            beyond = np.abs((x - row[:3]) @ row[3:].reshape(3, 3)) - self.plates.half[m]
            near = np.flatnonzero(np.sum(np.maximum(beyond, 0.0) ** 2, axis=1) <= (radius + skin) ** 2)
            found.append(np.column_stack([near, np.full(len(near), n + m)]))
        pairs = in_order(np.concatenate(found), n + len(placed))
        start = np.searchsorted(pairs[:, 0], np.arange(n + 1))
        other, memory = pairs[:, 1].copy(), np.zeros((len(pairs), N_MEMORY))
        before_start, before_other, before_memory = before
        carry_over(before_start, before_other, before_memory, start, other, memory)
        return start, other, memory

    def _refuse(self, why: int, i: int, j: int, depth: float, time: float) -> None:
        if why == TOO_DEEP:
            n = len(self.edge)
            what = f"plane {-1 - j}" if j < 0 else f"cube {j}" if j < n else f"plate {j - n}"
            where = f"lies in {what}" if depth >= WHOLE else f"is {depth:.3g} deep in {what}"
            raise MechanicsError(
                f"at time {time:g}: cube {i} {where}, more than half of its edge, so "
                "that no side is its way out; take stiffer contacts, or start without overlap",
                fault=Fault.OVERLAP,
            )
        raise StepTooLargeError(
            f"at time {time:g}: cube {i} moves by more than half of its edge in a step; take a shorter one"
        )


assert all(name in {each.name for each in fields(Heap)} for name in _OWN)
