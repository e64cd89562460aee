"""Cubes alone against textbooks, at the extremes, and the cost of looking for neighbours."""

from collections.abc import Iterator
from functools import partial

import numpy as np
import pandas as pd

from protochain.core.errors import Fault
from protochain.lab.cases import Check, Extreme, check, extreme
from protochain.lab.cost import timed
from protochain.mechanisms.pile import Pile
from protochain.mechanisms.pile_parts import Law
from protochain.mechanisms.search import touching
from protochain.scenes.bucket.dig import DENSITY, FRICTION, PITCH, SIDE, STIFFNESS

FREE_FALL = 9.81
MASS = DENSITY * SIDE**3
STEPS = 3000


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


def checks() -> Iterator[Check]:
    """Slopes, and an impact."""
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


def restitution(part: float) -> float:
    """Speed after an impact of a face, of that before; steps are a part of the longest."""
    pile = Pile(np.array([SIDE]), np.array([MASS]), Law(STIFFNESS, FRICTION), np.zeros(3),
                np.array([[0.0, 0.0, 1.0]]), np.zeros(1))  # fmt: skip
    h = part * pile.longest_step
    start = pile.start([[0.0, 0.0, 0.5 * SIDE]], velocity=[[0.0, 0.0, -1.0]])
    heap, _ = pile.advance(start, int(5.0 * np.sqrt(MASS / STIFFNESS) / h), h)
    return float(heap.velocity[0, 2])


def sunk(law: Law, mass: float) -> Check:
    """Depth at which a cube rests."""
    pile = alone(law, mass=mass)
    depth = mass * FREE_FALL / law.stiffness
    at = 0.5 * SIDE - (depth if depth < 0.5 * SIDE else 0.0)
    heap, _ = pile.advance(pile.start([[0.0, 0.0, at]]), STEPS, pile.longest_step)
    found = 0.5 * SIDE - float(heap.position[0, 2])
    # The place is rounded, and so is the depth.
    return check("depth", found, depth, 1e-6 + 1e-17 / depth, "m g / k")


def slid(friction: float, angle: float) -> Check:
    """How a cube slides on a slope."""
    wanted = max(FREE_FALL * (np.sin(angle) - friction * np.cos(angle)), 0.0)
    found = acceleration(alone(Law(STIFFNESS, friction), angle))
    return check("acceleration", found, wanted, 1e-5, "g (sin - mu cos), or at rest", "absolute")


def _apart(gap: float) -> Check:
    pile = Pile(np.full(2, SIDE), np.full(2, MASS), Law(STIFFNESS, FRICTION), np.zeros(3))
    heap = pile.start([[0.0, 0.0, 0.0], [gap, 0.0, 0.0]])
    return check("force", MASS * float(np.linalg.norm(heap.acceleration[0, :3])), STIFFNESS * (SIDE - gap),
                 1e-9, "k d")  # fmt: skip


def _thrown(speed: float, step: float) -> Check:
    pile = alone()
    start = pile.start([[0.0, 0.0, 1.0]], velocity=[[speed, 0.0, 0.0]])
    heap, _ = pile.advance(start, 10, step * pile.longest_step)
    return check("place", float(heap.position[0, 0]), speed * heap.time, 1e-12, "v t")


def extremes() -> Iterator[Extreme]:
    """What is deep, stiff, light, slippery, rough or fast."""
    for gap, refusal in ((0.9, None), (0.55, None), (0.4, Fault.OVERLAP), (0.0, Fault.OVERLAP)):
        yield extreme(f"two cubes, centres {gap:g} edges apart", partial(_apart, gap * SIDE), refusal)
    for k in (1.0, 1e3, 1e6, 1e9, 1e12):
        refusal = Fault.OVERLAP if MASS * FREE_FALL / k > 0.5 * SIDE else None
        yield extreme(f"stiffness {k:g} N/m", partial(sunk, Law(k, FRICTION), MASS), refusal)
    for mass in (1e-9, 1e-3, 1e3):
        refusal = Fault.OVERLAP if mass * FREE_FALL / STIFFNESS > 0.5 * SIDE else None
        yield extreme(f"mass {mass:g} kg", partial(sunk, Law(STIFFNESS, FRICTION), mass), refusal)
    for friction in (0.0, 10.0):
        yield extreme(f"friction {friction:g} at 30 degrees", partial(slid, friction, np.pi / 6.0))
    yield extreme("step beyond the longest", partial(_thrown, 1.0, 1.5), Fault.STEP)
    yield extreme("100 m/s", partial(_thrown, 100.0, 1.0))
    yield extreme("1e6 m/s", partial(_thrown, 1e6, 1.0), Fault.STEP)


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
