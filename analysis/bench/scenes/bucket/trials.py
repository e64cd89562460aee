"""Cubes alone against textbooks, at the extremes, and the cost of looking for neighbours."""

from collections.abc import Iterator
from functools import partial
from typing import Literal

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from bench.cases import Found, check, judged, vanishes
from bench.cost import timed
from bench.scenes.bucket.dig import DENSITY, FRICTION, PITCH, SIDE, STIFFNESS
from bench.soil.parts import Heap, Law
from bench.soil.pile import Pile
from protochain.core.arrays import Floats
from protochain.core.errors import Fault
from protochain.mechanisms.search import touching

FREE_FALL = 9.81
MASS = DENSITY * SIDE**3
STEPS = 3000
KEPT = 1e-3
"""Largest change of the energy in impacts without loss, by volume."""
By = Literal["points", "volume"]
WAYS: tuple[By, ...] = ("points", "volume")


def alone(law: Law | None = None, angle: float = 0.0, mass: float = MASS) -> Pile:
    """One cube on a plane that is tilted by an angle."""
    gravity = FREE_FALL * np.array([np.sin(angle), 0.0, -np.cos(angle)])
    law = law or Law(STIFFNESS, FRICTION)
    return Pile(np.array([SIDE]), np.array([mass]), law, gravity, np.array([[0.0, 0.0, 1.0]]), np.zeros(1))


def acceleration(pile: Pile) -> float:
    """How fast a cube becomes faster on a slope, once it has settled."""
    start = pile.start([[0.0, 0.0, 0.5 * SIDE]])
    early, _ = pile.advance(start, STEPS, pile.longest_step)
    late, _ = pile.advance(early, STEPS, pile.longest_step)
    return float((late.velocity - early.velocity)[0, 0]) / (late.time - early.time)


def checks(kept: pd.DataFrame) -> Iterator[Found]:
    """Slopes, impacts; ``kept`` is of :func:`energies`."""
    for degrees in (20.0, 30.0, 60.0):
        angle = np.deg2rad(degrees)
        wanted = max(FREE_FALL * (np.sin(angle) - FRICTION * np.cos(angle)), 0.0)
        found = acceleration(alone(angle=angle))
        yield check(f"cube on a slope of {degrees:g} degrees, m/s^2", found, wanted, 1e-5,
                    "g (sin - mu cos), or at rest", "absolute")  # fmt: skip
    z = alone().law.damping
    w = np.sqrt(1.0 - z * z)
    wanted = np.exp(-z / w * (np.pi - np.arctan(2.0 * z * w / (1.0 - 2.0 * z * z))))
    source = "Schwager, Poeschel, Granul. Matter 9:465 (2007)"
    yield check("restitution of a face", restitution(0.02), wanted, 5e-3, source)
    volume = kept[kept["method"] == "volume"]
    name = f"energy of {volume['impacts'].iloc[0]} random impacts by volume, longest step, largest change"
    yield vanishes(name, volume["error"].iloc[0], KEPT, "the energy before")
    order = float(np.log2(volume["median"].iloc[-2] / volume["median"].iloc[-1]))
    yield check("order of it in the step", order, 2.0, 0.2, "velocity Verlet", "absolute")


def restitution(part: float) -> float:
    """Speed after an impact of a face, of that before; steps are a part of the longest."""
    pile = Pile(np.array([SIDE]), np.array([MASS]), Law(STIFFNESS, FRICTION), np.zeros(3),
                np.array([[0.0, 0.0, 1.0]]), np.zeros(1))  # fmt: skip
    h = part * pile.longest_step
    start = pile.start([[0.0, 0.0, 0.5 * SIDE]], velocity=[[0.0, 0.0, -1.0]])
    heap, _ = pile.advance(start, int(5.0 * np.sqrt(MASS / STIFFNESS) / h), h)
    return float(heap.velocity[0, 2])


def sunk(law: Law, mass: float) -> Found:
    """Depth at which a cube rests."""
    pile = alone(law, mass=mass)
    depth = mass * FREE_FALL / law.stiffness
    at = 0.5 * SIDE - (depth if depth < 0.5 * SIDE else 0.0)
    heap, _ = pile.advance(pile.start([[0.0, 0.0, at]]), STEPS, pile.longest_step)
    found = 0.5 * SIDE - float(heap.position[0, 2])
    # The place is rounded, and so is the depth.
    return check("depth", found, depth, 1e-6 + 1e-17 / depth, "m g / k")


def slid(friction: float, angle: float) -> Found:
    """How a cube slides on a slope."""
    wanted = max(FREE_FALL * (np.sin(angle) - friction * np.cos(angle)), 0.0)
    found = acceleration(alone(Law(STIFFNESS, friction), angle))
    return check("acceleration", found, wanted, 1e-5, "g (sin - mu cos), or at rest", "absolute")


def _apart(gap: float, by: By = "points") -> Found:
    pile = Pile(np.full(2, SIDE), np.full(2, MASS), Law(STIFFNESS, FRICTION, by=by), np.zeros(3))
    heap = pile.start([[0.0, 0.0, 0.0], [gap, 0.0, 0.0]])
    return check("force", MASS * float(np.linalg.norm(heap.acceleration[0, :3])), STIFFNESS * (SIDE - gap),
                 1e-9, "k d")  # fmt: skip


def _kept(speed: float, part: float) -> Found:
    found = impacts(Law(STIFFNESS, 0.0, 0.0, by="volume"), part, speed=speed)
    return vanishes("energy", float(np.max(np.abs(found))), KEPT, "the energy before")


def _thrown(speed: float, step: float) -> Found:
    pile = alone()
    start = pile.start([[0.0, 0.0, 1.0]], velocity=[[speed, 0.0, 0.0]])
    heap, _ = pile.advance(start, 10, step * pile.longest_step)
    return check("place", float(heap.position[0, 0]), speed * heap.time, 1e-12, "v t")


def extremes() -> Iterator[Found]:
    """What is deep, stiff, light, slippery, rough or fast."""
    for gap, refusal in ((0.9, None), (0.55, None), (0.4, Fault.OVERLAP), (0.0, Fault.OVERLAP)):
        for by in WAYS:
            name = f"two cubes, centres {gap:g} edges apart, by {by}"
            yield judged(name, partial(_apart, gap * SIDE, by), refusal)
    for speed, part in ((1e-3, 1.0), (0.1, 1.0), (10.0, 0.125)):
        name = f"200 impacts by volume at {speed:g} m/s, {part:g} of the longest step"
        yield judged(name, partial(_kept, speed, part))
    for k in (1.0, 1e3, 1e6, 1e9, 1e12):
        refusal = Fault.OVERLAP if MASS * FREE_FALL / k > 0.5 * SIDE else None
        yield judged(f"stiffness {k:g} N/m", partial(sunk, Law(k, FRICTION), MASS), refusal)
    for mass in (1e-9, 1e-3, 1e3):
        refusal = Fault.OVERLAP if mass * FREE_FALL / STIFFNESS > 0.5 * SIDE else None
        yield judged(f"mass {mass:g} kg", partial(sunk, Law(STIFFNESS, FRICTION), mass), refusal)
    for friction in (0.0, 10.0):
        yield judged(f"friction {friction:g} at 30 degrees", partial(slid, friction, np.pi / 6.0))
    yield judged("step beyond the longest", partial(_thrown, 1.0, 1.5), Fault.STEP)
    yield judged("100 m/s", partial(_thrown, 100.0, 1.0))
    yield judged("1e6 m/s", partial(_thrown, 1e6, 1.0), Fault.STEP)


def impacts(law: Law, part: float, number: int = 200, speed: float = 1.0, seed: int = 0) -> Floats:
    """Changes (k,) of the kinetic energy of pairs of cubes that meet at random and part, of that before.

    Steps are a part of the longest; cubes turn by a fifth of their speed.
    """
    rng = np.random.default_rng(seed)
    n = 2 * number
    pile = Pile(np.full(n, SIDE), np.full(n, MASS), law, np.zeros(3))
    along = rng.normal(size=(number, 3))
    along /= np.linalg.norm(along, axis=1)[:, None]
    aside = 0.15 * SIDE * rng.normal(size=(number, 3))
    aside -= np.sum(aside * along, axis=1)[:, None] * along
    # Pairs do not reach each other, and hardly the next place for rounding.
    middle = 10.0 * SIDE * np.column_stack(np.unravel_index(np.arange(number), (10, 10, -(-number // 100))))
    position = np.stack([middle + aside - 0.9 * SIDE * along, middle - aside + 0.9 * SIDE * along], axis=1)
    velocity = 0.5 * speed * np.stack([along, -along], axis=1)
    spin = 0.2 * speed / SIDE * rng.normal(size=(n, 3))
    start = pile.start(
        position.reshape(n, 3), Rotation.random(n, random_state=rng).as_matrix(), velocity.reshape(n, 3), spin
    )
    h = part * pile.longest_step
    after, _ = pile.advance(start, round(4.0 * SIDE / speed / h), h)
    # Of those that still touch, or never did, nothing is told.
    met = ~np.all(np.isclose(after.velocity, start.velocity, rtol=1e-9), axis=1).reshape(-1, 2).any(axis=1)
    parted = (
        np.linalg.norm(np.diff(after.position.reshape(-1, 2, 3), axis=1)[:, 0], axis=1) > np.sqrt(3.0) * SIDE
    )
    before, now = (_kinetic_of_pairs(pile, heap) for heap in (start, after))
    return (now / before - 1.0)[met & parted]


def _kinetic_of_pairs(pile: Pile, heap: Heap) -> Floats:
    """(n,) float: kinetic energy of each pair of cubes."""
    each = pile.mass * np.sum(heap.velocity**2, axis=1)
    each += pile.mass * pile.edge**2 / 6.0 * np.sum(heap.spin**2, axis=1)
    return 0.5 * each.reshape(-1, 2).sum(axis=1)


def energies(parts: tuple[float, ...]) -> pd.DataFrame:
    """Largest change of the energy in 200 random impacts without loss, by what presses and by the step."""
    rows = []
    for by in WAYS:
        law = Law(STIFFNESS, 0.0, 0.0, by=by)
        for part in parts:
            found, seconds = timed(partial(impacts, law, part), 3)
            rows.append(
                {"method": by, "step": part, "seconds": seconds, "impacts": len(found),
                 "error": float(np.max(np.abs(found))), "median": float(np.median(np.abs(found)))}
            )  # fmt: skip
    return pd.DataFrame(rows)


def search(sizes: tuple[int, ...]) -> pd.DataFrame:
    """Seconds of finding neighbours among cubes anywhere, as dense as in a heap."""
    rows = []
    for n in sizes:
        rng = np.random.default_rng(n)
        # Numbered layer by layer, as cubes of a heap are.
        x = rng.uniform(0.0, SIDE * (n / 0.6) ** (1.0 / 3.0), (n, 3))
        x = x[np.lexsort((x // PITCH).T)]
        radius = np.full(n, 0.5 * np.sqrt(3.0) * SIDE)
        pairs, seconds = timed(partial(touching, x, radius), 5)
        rows.append({"cubes": n, "pairs": len(pairs), "seconds": seconds})
    return pd.DataFrame(rows)
