"""Guns that are stiff, soft, undamped, or make no sense; and what a rigid deck or barrel leaves out."""

from collections.abc import Iterator
from functools import partial

import numpy as np

from bench.cases import Found, check, judged, left_out, vanishes
from bench.scenes.gun.oracle import Planar
from bench.scenes.gun.parts import Gun, built
from protochain.core.arrays import Floats
from protochain.core.errors import Fault
from protochain.mechanics.motion import DormandPrince, Integrator, RungeKutta4
from protochain.mechanisms import Rosenbrock

REFUSED: tuple[tuple[str, Gun, Fault], ...] = (
    ("no axle, no equilibrator", Gun(axle=0.0, balanced=0.0), Fault.NO_EQUILIBRIUM),
    ("an equilibrator, but no axle: the barrel slides", Gun(axle=0.0), Fault.NO_EQUILIBRIUM),
    ("a deck without stiffness", Gun(deck=0.0), Fault.NO_STIFFNESS),
    ("an axle below zero", Gun(axle=-1.0), Fault.NEGATIVE),
    ("a deck that is no number", Gun(deck=np.nan), Fault.NOT_FINITE),
    ("a tube without stiffness", Gun(cells=4, bending=0.0), Fault.NO_STIFFNESS),
)
"""Name, gun, and refusal."""
EXPLICIT, IMPLICIT = DormandPrince(1e-9), Rosenbrock()


def _end(gun: Gun, integrator: Integrator = EXPLICIT, step: float = 5e-3, until: float = 0.03) -> Floats:
    return built(gun).end(integrator, step, until)


def _beside(
    gun: Gun, other: Gun, bound: float, source: str, integrator: Integrator = EXPLICIT, step: float = 5e-3
) -> Found:
    """Muzzle of a gun beside that of another, by the same integrator."""
    off = np.linalg.norm((_end(gun, integrator, step) - _end(other, integrator, step))[:2])
    return vanishes("muzzle, m", float(off), bound, source)


def _bent() -> Found:
    """Tube so soft that it hangs: by other equations."""
    gun, until = Gun(cells=8, bending=1e-3), 0.02
    found = _end(gun, DormandPrince(1e-10), until=until)
    off = np.linalg.norm(found - np.array(Planar(gun).moved(np.array([until]))[0]))
    return vanishes("muzzle, m", float(off), 1e-8, "equations in absolute angles, DOP853")


def _undamped() -> Found:
    error = built(Gun(damped=0.0)).run(0.1, 1e-10).audit().energy
    return vanishes("energy", error, 1e-8, "work of the powder")


def _unfired() -> Found:
    found = built(Gun(charge=0.0))
    off = found.end(EXPLICIT, 0.01, 0.1) - found.muzzle_at(found.start)
    return vanishes("muzzle, m", float(np.max(np.abs(off))), 1e-10, "where it stood")


def _too_long() -> Found:
    """Steps that are stable for the tube as it is, for one that is a million times as stiff."""
    found = built(Gun(cells=8, bending=1e6))
    run = found.model.simulate(0.05, 2e-4, RungeKutta4(), start=found.start)
    return vanishes("energy", run.audit().energy, 1e-2, "work")


def _freedoms(gun: Gun) -> Found:
    return check("freedoms", built(gun).model.tree.n_v, 4, 0.0, "deck, axle, slide")


def limits(quick: bool) -> Iterator[Found]:
    """Yield the extreme cases."""
    fixed = Gun(deck=np.inf)
    # Quasi-static: some 2e5 N over k_d, and what the trunnion's height makes of it.
    yield judged("deck 1e12 N/m", partial(_beside, Gun(deck=1e12), fixed, 1e-6, "no deck, 1/k_d"))
    hard = IMPLICIT, 1e-3
    yield judged("deck 1e16 N/m, 1 ms steps", partial(_beside, Gun(deck=1e16), fixed, 2e-5, "no deck", *hard))
    yield judged("no dampers, no brake", _undamped)
    yield judged("no charge", _unfired)
    yield judged("tube a thousandth as stiff, which hangs by a radian", _bent)
    for factor in (1e6,) if quick else (1e3, 1e6):
        # What bends for the steel itself is some millimetres.
        case = partial(
            _beside, Gun(cells=8, bending=factor), Gun(), 0.01 / factor + 1e-8, "rigid barrel", *hard
        )
        yield judged(f"tube {factor:g} times as stiff, 1 ms steps", case)
    yield judged("tube 1e6 times as stiff, explicit steps", _too_long, Fault.STEP)
    for name, gun, words in REFUSED:
        yield judged(name, partial(_freedoms, gun), words)


def without(quick: bool) -> Iterator[Found]:
    """Yield rigid parts that are left out of the coordinates, not made stiff."""
    until = 0.02 if quick else 0.1
    deck = partial(_end, integrator=DormandPrince(1e-8), until=until)
    yield left_out(
        "freedoms of a rigid deck, not made 1e12 N/m stiff", lambda: deck(Gun(deck=1e12))[:2],
        lambda: deck(Gun(deck=np.inf))[:2], 1e-6, 2,
    )  # fmt: skip
    barrel = partial(_end, integrator=IMPLICIT, step=5e-4, until=until)
    yield left_out(
        "hinges of a rigid barrel, not made 1e6 times as stiff as steel",
        lambda: barrel(Gun(cells=8, bending=1e6))[:2], lambda: barrel(Gun())[:2], 1e-6, 2,
    )  # fmt: skip
