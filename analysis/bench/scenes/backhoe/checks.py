"""The vehicle against statics, d'Alembert's principle, and balances of energy and momentum."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.integrate import simpson, trapezoid

from bench.cases import Found, check, vanishes
from bench.scenes.backhoe import oracle
from bench.scenes.backhoe.cycle import Worked, soil_table, working
from bench.scenes.backhoe.machine import ARM, DESIGNS, LOWER, Design, G, Path, hold, posture, vehicle
from bench.scenes.backhoe.stability import inside_by, loads, traced
from bench.scenes.backhoe.track import ROLLING, TEETH, crawler
from protochain.core.arrays import Floats
from protochain.mechanisms import Plane, Run, State
from protochain.mechanisms.reactions import phases

OUT = posture((0.8, 0.3), np.deg2rad(5.0))
"""Arm stretched, bucket level."""
COARSE = 2e-3
"""s. Step where nothing but the machine moves."""


def standing(design: Design, angles: Floats = OUT, until: float = 0.4) -> tuple[State, Run]:
    """Stand still with the arm at four angles."""
    model = vehicle(design, hold(angles), Plane()).build()
    run = model.simulate(until, COARSE, every=10)
    return model.state(run.end), run


def statics(designs: tuple[Design, ...]) -> Iterator[Found]:
    """Loads of the feet, and both measures of stability, against moments about edges."""
    for design in designs:
        state, run = standing(design)
        carried, middle = loads(state, design), oracle.middle(design, OUT)
        label = design.name
        yield check(f"{label}: load of the feet, N", float(carried.sum()), design.mass * G, 1e-4, "weight")
        last = traced(Worked(design, run, None, 0.0)).iloc[-1]  # type: ignore[arg-type]  # without soil
        # The vehicle tilts a little on its feet.
        within = float(np.min(inside_by(middle[:2], design.corners[:, :2])))
        yield check(f"{label}: centre of pressure inside the edges, m", float(last["pressure"]), within, 1e-3,
                    "centre of mass, by trigonometry")  # fmt: skip
        edge = np.array([state.point("tracks", corner) for corner in design.corners])
        place = state.rotation("tracks") @ middle + state.point("tracks")
        inside = inside_by(place[:2], edge[:, :2])
        exact = np.degrees(np.min(np.arctan2(inside, place[2] - np.mean(edge[:, 2]))))
        yield check(f"{label}: force-angle measure at rest, degrees", float(last["angle"]), float(exact),
                    2e-3, "way to the edge over height")  # fmt: skip
        ring = run.reactions("slew").iloc[-1]
        above, through = (design.mass - LOWER) * G, float(ring["force z"])
        yield check(f"{label}: force through the slewing ring, N", through, above, 1e-4, "weight")


def flat(path: Path) -> Path:
    """Path without slewing."""
    return lambda t: tuple(np.append(0.0, each[1:]) for each in path(t))  # type: ignore[return-value]  # mypy does not count them


def arm(until: float = 1.2) -> Iterator[Found]:
    """Forces of the cylinders and their power, of the machine held, while it goes through a cycle."""
    path = flat(working(0.06))
    run = vehicle(DESIGNS[0], path, None).build().simulate(until, 5e-3)
    motion = run.motion
    found = motion[[f"{name} cylinder drive" for name in ARM]].to_numpy()
    exact = np.array([oracle.cylinder_forces(path, float(t)) for t in run.time])
    most = float(np.max(np.abs(exact)))
    # Differences over a tenth of a millisecond, where the third derivative of the way jumps.
    yield vanishes("forces of the cylinders through a cycle, held, of the largest",
                   float(np.max(np.abs(found - exact))) / most, 1e-3, "d'Alembert's principle")  # fmt: skip
    rates = motion[[f"{name} cylinder rate" for name in ARM]].to_numpy()
    power = np.sum(found * rates, axis=1)
    work = float(run.work[-1, -1])
    yield check("work of the cylinders, held, J", float(simpson(power, x=run.time)), work, 1e-4,
                "integral of force times rate")  # fmt: skip
    yield vanishes("energy less work, held", run.audit().energy, 1e-4, "balance")


@dataclass(frozen=True, eq=False)
class Balance:
    """Where the drives' work of a cycle went, J, and impulses, N s.

    drives, machine, soil, ground: Work of the drives; energy gained by the machine and by the soil, with what
        was lost in it; lost at the feet.
    passed: What the soil did to the machine and the machine to the soil together: zero but for errors.
    created: Energy that the cubes alone have from nothing.
    push (3,): Impulse of the soil on the bucket.
    missing (3,): Momentum of machine and cubes that no force from outside gave.
    """

    drives: float
    machine: float
    soil: float
    ground: float
    passed: float
    created: float
    push: Floats
    missing: Floats


def balance(worked: Worked) -> Balance:
    """Balance energy and momentum of a cycle; rows must be those of all steps."""
    run, model, cubes = worked.run, worked.model, soil_table(worked.soil)
    pile, heap = worked.soil.pile, worked.soil.soil.heap
    before = pile.kinetic(heap) + pile.potential(heap) + heap.stored
    last = cubes.iloc[-1]
    gained = float(last["kinetic"] + last["potential"] + last["stored"] + last["dissipated"] - before)
    done = dict(zip(model.works, run.work[-1], strict=True))
    # Momentum: of the machine by all forces at rows, less the soil's; of the cubes by weight and bin.
    root = int(model.tree.v_start[model.bodies.number("tracks")]) + 3
    mine = next(k for k, each in enumerate(model.memories) if each is worked.soil)
    outer = np.array([at.torque[root : root + 3] for at in phases(run)])
    soil = np.array([kept[mine][1, 3:] for kept in run.kept])
    spans = np.diff(run.time)
    pushes = np.array([look.pushes for look in worked.soil.looks])
    on_bin, push = np.einsum("n,nbi->bi", spans, pushes)
    weight = pile.mass.sum() * pile.gravity * run.time[-1]
    given = trapezoid(outer - soil, x=run.time, axis=0) - on_bin + weight
    moved = run.momenta[-1, 0] - run.momenta[0, 0]
    moved = moved + worked.soil.looks[-1].momentum - pile.mass @ heap.velocity
    return Balance(
        float(done["drives"]), float(run.total[-1] - run.total[0]), gained, -float(done["ground"]),
        float(done["soil"] + last["work"]), gained - float(last["work"]), push, moved - given,
    )  # fmt: skip


def excavation(worked: Worked) -> Iterator[Found]:
    """Energy and momentum of machine and soil together."""
    found = balance(worked)
    spent = found.machine + found.soil + found.ground
    yield check("work of the drives in a cycle, J", found.drives, spent, 5e-3,
                "energy of machine and soil, and dissipation")  # fmt: skip
    done = float(worked.soil.heap.work)
    yield vanishes("work of the bucket on the soil less the soil's on it, of that", found.passed / done, 5e-3,
                   "action and reaction")  # fmt: skip
    created = found.created / done
    yield vanishes("energy of the soil from nothing, of the work on it", created, 5e-3, "balance")
    size = float(np.linalg.norm(found.push))
    yield vanishes("momentum of machine and cubes from nothing, of the soil's impulse",
                   float(np.linalg.norm(found.missing)) / size, 0.02, "forces from outside")  # fmt: skip


@dataclass(frozen=True)
class Turning:
    """Turning of the sprocket that rises smoothly to a rate in a time."""

    rate: float
    rise: float = 0.2

    def __call__(self, t: float) -> tuple[float, float, float]:
        """Angle, rate and acceleration at a time."""
        s = min(t / self.rise, 1.0)
        angle = self.rise * (s**3 - 0.5 * s**4) + max(t - self.rise, 0.0)
        second = 6.0 * s * (1.0 - s) / self.rise
        return self.rate * angle, self.rate * s * s * (3.0 - 2.0 * s), self.rate * second


def driven(rate: float, until: float, slope: float = 0.0, grip: float = 0.8, step: float = 5e-4) -> Run:
    """Drive on one track for a time."""
    return crawler(Turning(rate), slope, grip).build().simulate(until, step, every=round(5e-3 / step))


def advance(run: Run) -> tuple[float, float]:
    """Way of the vehicle over its last whole teeth, and the sprocket's angle there."""
    motion = run.motion
    angle, way = motion["sprocket"].to_numpy(), motion["frame x"].to_numpy()
    tooth = 2.0 * np.pi / TEETH
    teeth = max(int((angle[-1] - 0.3 * tooth) / tooth), 1)
    begin = float(np.interp(angle[-1] - teeth * tooth, angle, way))
    return float(way[-1]) - begin, teeth * tooth


def track(run: Run, bound: float) -> Iterator[Found]:
    """The track rolls; by how much it may creep, and its pins move in their seats, in few teeth.

    It creeps on the ground, not on its wheels: all pads that lie there move on together, by half a millimetre
    per tooth, while the frame hops from tooth to tooth. That stays with wheels nearer to the chain's pitch,
    and hardly changes with pads that give way four times as much.
    """
    way, angle = advance(run)
    yield check("way of the vehicle on its track per tooth, m", way * 2.0 * np.pi / TEETH / angle,
                ROLLING * 2.0 * np.pi / TEETH, bound, "a pitch")  # fmt: skip
    audit = run.audit()
    yield vanishes("energy less work, of the track", audit.energy, 1e-3, "balance")
    assert audit.gap is not None
    yield vanishes("gap of the chain, of its size", audit.gap, 1e-11, "closed")


def slipping(runs: dict[float, Run]) -> pd.DataFrame:
    """Way of the vehicle, of that without slip, by rate of the sprocket: at speed it hops on its teeth."""
    rows = []
    for rate, run in runs.items():
        way, angle = advance(run)
        up = run.motion["frame z"].to_numpy()
        rows.append((rate, rate * ROLLING, way / angle / ROLLING, float(np.ptp(up[len(up) // 3 :]))))
    return pd.DataFrame(rows, columns=["rate", "speed", "share", "bounce"])
