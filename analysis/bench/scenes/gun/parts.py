"""The gun: its data, its mechanism, how it stands before it fires, and where its muzzle goes.

In a plane, x forward and z up. All angles raise the muzzle.
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import exp
from typing import Any

import numpy as np

from protochain.core.arrays import Floats
from protochain.core.errors import Fault, MechanicsError
from protochain.mechanics.motion import DormandPrince, Integrator, Phase
from protochain.mechanisms import Beam, Mechanism, Model, Run, State, add_beam

GRAVITY = 9.81
"""m/s^2."""
DECK, MOUNT, CRADLE, BREECH = 20e3, 5e3, 1.5e3, 316.5
"""kg. Breech and tube recoil, 800 kg together."""
DECK_INERTIA, MOUNT_INERTIA, CRADLE_INERTIA, BREECH_INERTIA = 60e3, 3e3, 600.0, 20.0
"""kg m^2, about their centres of mass."""
SPAN, MOUNT_HEIGHT, TRUNNION = 2.5, 0.9, 1.8
"""m. The deck's springs stand so far to either side; heights of the mount's mass and the trunnion over the
deck's."""
CRADLE_AT, BREECH_AT, TUBE_AT = -0.1, -0.4, 0.3
"""m along the bore from the trunnion: centres of mass, and the root of the tube."""
ELEVATION = 0.35
"""rad."""
TUBE = Beam(3.5, 483.5 / 3.5, 2.1e11 * np.pi / 64.0 * (0.18**4 - 0.1**4))
"""3.5 m of steel, 0.18 m outside and 0.1 m inside: 9.8e6 N m^2."""
RECUPERATOR, BRAKE = 4e4, 1600.0
"""N/m, and N s^2/m^2 of speed times its size."""
DECK_RATIO, TUBE_TIME = 0.05, 1e-4
"""Dampers of the deck, relative to critical; time constant of those of the tube, s."""
IMPULSE, PULSE, PERIOD = 7.5e3, 2.5e-3, 0.5
"""N s, s to the peak, s from shot to shot."""
LEVER = 0.5, 0.6
"""m above the trunnion on the mount and before it on the cradle, where the equilibrator is hooked."""
_EQUAL = 1e-10
"""Torque left where the gun stands, relative to its weights."""


@dataclass(frozen=True)
class Gun:
    """What is varied.

    deck: Stiffness k_d of the deck in heave, N/m; ``inf`` leaves the deck out.
    axle: Stiffness of the axle, N m/rad.
    balanced: Stiffness of the equilibrator, relative to the one that balances cradle and barrel at any
        elevation; 0 leaves it out.
    ratio: Damper of the axle, relative to critical.
    cells: Cells of the tube; none is a rigid one.
    bending: Factor of the tube's stiffness.
    offset: How far the breech's centre of mass lies below the bore, m.
    damped: Factor of all dampers and of the brake.
    charge: Factor of the firing force.
    shots: Number of shots.
    blow: Impulse of a moment on the deck that comes and goes as the firing force does, N m s.
    """

    deck: float = 1e8
    axle: float = 1e8
    balanced: float = 1.0
    ratio: float = 0.2
    cells: int = 0
    bending: float = 1.0
    offset: float = 0.02
    damped: float = 1.0
    charge: float = 1.0
    shots: int = 1
    blow: float = 0.0

    @property
    def floats(self) -> bool:
        """Whether the deck moves."""
        return self.deck != np.inf

    @property
    def equilibrator(self) -> float:
        """Stiffness of the equilibrator, N/m, without a length at rest."""
        above, before = LEVER
        return self.balanced * GRAVITY * MOMENT / (above * before)

    @property
    def dampers(self) -> tuple[float, float, float]:
        """Of deck in heave and roll, and of the axle: N s/m, N m s, N m s."""
        deck = self.deck if self.floats else 0.0
        heave = 2.0 * DECK_RATIO * np.sqrt(deck * (DECK + MOUNT + CRADLE + BREECH + _TUBE_MASS))
        roll = 2.0 * DECK_RATIO * SPAN * np.sqrt(deck * HEELING)
        axle = 2.0 * self.ratio * np.sqrt(self.axle * SWING)
        return self.damped * heave, self.damped * roll, self.damped * axle

    def thrust(self, time: float) -> float:
        """Firing force, N."""
        return self.charge * IMPULSE * sum(_pulse(time - PERIOD * k) for k in range(self.shots))

    def heel(self, time: float) -> float:
        """Moment on the deck, N m."""
        return self.blow * _pulse(time)


def _pulse(time: float) -> float:
    """Rise to a peak and fall, whose integral is one, 1/s."""
    return time / PULSE**2 * exp(-time / PULSE) if time > 0.0 else 0.0


_TUBE_MASS = TUBE.length * TUBE.mass
_TUBE_CENTRE = TUBE_AT + 0.5 * TUBE.length
MOMENT = CRADLE * CRADLE_AT + BREECH * BREECH_AT + _TUBE_MASS * _TUBE_CENTRE
"""kg m of cradle and barrel before the trunnion."""
SWING = (
    CRADLE_INERTIA + CRADLE * CRADLE_AT**2 + BREECH_INERTIA + BREECH * BREECH_AT**2
    + _TUBE_MASS * (_TUBE_CENTRE**2 + TUBE.length**2 / 12.0)
)  # fmt: skip
"""kg m^2 of both about the trunnion."""
HEELING = (
    DECK_INERTIA + MOUNT_INERTIA + MOUNT * MOUNT_HEIGHT**2 + (CRADLE + BREECH + _TUBE_MASS) * TRUNNION**2
)  # fmt: skip
"""kg m^2 of all about the deck, cradle and barrel as points at the trunnion."""


@dataclass(frozen=True, eq=False)
class Built:
    """A gun as a mechanism, standing.

    muzzle: Body and point.
    start: Where it stands before it fires.
    """

    gun: Gun
    model: Model
    muzzle: tuple[str, Any]
    start: Phase

    def muzzle_at(self, at: Phase | State) -> Floats:
        """(3,) float: x and z of the muzzle, m, and its elevation, rad."""
        state = at if isinstance(at, State) else self.model.state(at)
        x, _, z = state.point(*self.muzzle)
        along = state.rotation(self.muzzle[0])[:, 0]
        return np.array([x, z, np.arctan2(along[2], along[0])])

    def aside(self, run: Run) -> Floats:
        """(n, 2) float: the muzzle's way across the bore as it stood, m, and change of elevation, rad."""
        first = self.muzzle_at(self.start)
        moved = np.array([
            self.muzzle_at(self.model.state(self.model.system.at(q, qd)))
            for q, qd in zip(run.q, run.qd, strict=True)
        ]) - first  # fmt: skip
        return np.column_stack([
            moved[:, 1] * np.cos(first[2]) - moved[:, 0] * np.sin(first[2]), moved[:, 2],
        ])  # fmt: skip

    def end(self, integrator: Integrator, time_step: float, until: float) -> Floats:
        """Muzzle at a time, without the table and audit of a run."""
        at, n = self.start, max(1, round(until / time_step))
        for _ in range(n):
            at = integrator.step(self.model.system, at, until / n)
        return self.muzzle_at(at)

    def run(self, until: float, tolerance: float = 1e-8, every: float = 2e-3) -> Run:
        """Follow the motion, in substeps of a tolerance."""
        return self.model.simulate(until, every, DormandPrince(tolerance), start=self.start)


def built(gun: Gun) -> Built:
    """Build a gun, and let it come to rest."""
    mechanism = Mechanism(gravity=(0.0, 0.0, -GRAVITY))
    heave, roll, axle = gun.dampers
    under = "world"
    up = (0.0, -1.0, 0.0)
    if gun.floats:
        under = "deck"
        mechanism.body("float", 0.0)
        mechanism.hinge("heave", "world", "float", "prismatic", axis=(0.0, 0.0, 1.0))
        mechanism.torsion("heave", "heave", gun.deck, damping=heave)
        mechanism.body("deck", DECK, inertia=DECK_INERTIA)
        mechanism.hinge("roll", "float", "deck", axis=up)
        mechanism.torsion("roll", "roll", gun.deck * SPAN**2, damping=roll)
        if gun.blow:
            mechanism.torque("blow", "roll", gun.heel)
    mechanism.body("mount", MOUNT, inertia=MOUNT_INERTIA)
    mechanism.hinge("foot", under, "mount", "fixed", at=(0.0, 0.0, MOUNT_HEIGHT))
    trunnion = (0.0, 0.0, TRUNNION - MOUNT_HEIGHT)
    mechanism.body("cradle", CRADLE, com=(CRADLE_AT, 0.0, 0.0), inertia=CRADLE_INERTIA)
    mechanism.hinge("trunnion", "mount", "cradle", at=trunnion, axis=up, q=ELEVATION)
    if gun.axle:
        mechanism.torsion("axle", "trunnion", gun.axle, rest=ELEVATION, damping=axle)
    if gun.balanced:
        above, before = LEVER
        hook = "mount", (0.0, 0.0, trunnion[2] + above)
        mechanism.spring("equilibrator", ("cradle", (before, 0, 0)), hook, gun.equilibrator, rest=0.0)
    slide = {"kind": "prismatic", "at": (TUBE_AT, 0.0, 0.0), "axis": (1.0, 0.0, 0.0)}
    muzzle = _barrel(mechanism, gun, slide)
    mechanism.torsion("recuperator", "tube", RECUPERATOR)
    if gun.damped:
        mechanism.torque("brake", "tube", _brake(gun.damped * BRAKE))

    def force(t: float, state: State) -> Floats:
        return np.asarray(-gun.thrust(t) * state.rotation("breech")[:, 0])

    mechanism.load("powder", "breech", at=(0.0, 0.0, gun.offset), force=force)
    model = mechanism.build()
    return Built(gun, model, muzzle, _standing(model))


def _brake(constant: float) -> Callable[[float, State], float]:
    def brake(t: float, state: State) -> float:
        rate = state.rate("tube")
        return -constant * rate * abs(rate)

    return brake


def _barrel(mechanism: Mechanism, gun: Gun, slide: dict[str, Any]) -> tuple[str, Any]:
    """Add tube and breech, which recoil on a slide; return the muzzle."""
    if gun.cells:
        beam = Beam(TUBE.length, TUBE.mass, gun.bending * TUBE.stiffness("y"))
        time = gun.damped * TUBE_TIME / gun.bending if gun.bending else 0.0
        segments = add_beam(
            mechanism, "tube", beam, gun.cells, "cradle", slide, bends="y", damping=time
        )  # fmt: skip
        root, muzzle = segments.bodies[0], segments.tip
    else:
        root, muzzle = "tube", ("tube", (TUBE.length, 0.0, 0.0))
        half = (0.5 * TUBE.length, 0.0, 0.0)
        mechanism.body(root, _TUBE_MASS, com=half, inertia=TUBE.inertia(TUBE.length))
        mechanism.hinge("tube", "cradle", root, **slide)
    at = (BREECH_AT - TUBE_AT, 0.0, -gun.offset)
    mechanism.body("breech", BREECH, inertia=BREECH_INERTIA)
    mechanism.hinge("thread", root, "breech", "fixed", at=at)
    return muzzle


def _standing(model: Model, most: int = 60) -> Phase:
    """Phase at rest where nothing pulls, and does not push it further: by Newton's method, by differences."""
    system, n = model.system, model.tree.n_v
    q, still, nudge = model.q.copy(), np.zeros(n), 1e-6
    least, there = _EQUAL * GRAVITY * CRADLE, False
    for _ in range(most):
        torque = system.at(q, still).torque
        slope = np.column_stack([
            (system.at(q - d, still).torque - system.at(q + d, still).torque) / (2.0 * nudge)
            for d in nudge * np.eye(n)
        ])  # fmt: skip
        if there:
            # Scaled, since a deck may be 1e12 times as stiff as a slide.
            size = np.sqrt(np.abs(np.diag(slope)))
            if np.min(np.linalg.eigvalsh(0.5 * (slope + slope.T) / np.outer(size, size))) > 1e-9:
                return system.at(q, still)
            break
        # Once more from where it is good enough, to the end of the digits.
        there = bool(np.max(np.abs(torque)) < least)
        step = np.linalg.lstsq(slope, torque, rcond=1e-14)[0]
        q = q + step * min(1.0, 0.3 / max(0.3, float(np.max(np.abs(step)))))
    raise MechanicsError(
        "the gun falls: give the axle a stiffness that holds its barrel up", fault=Fault.NO_EQUILIBRIUM
    )
