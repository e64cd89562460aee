"""Gears at rest under their torque, place by place, and their vibrations about it."""

from dataclasses import replace

import numpy as np
from scipy.optimize import brentq, root

from bench.scenes.gear.geometry import overlap
from bench.scenes.gear.mesh import Gear, gears
from protochain.core.arrays import Floats
from protochain.core.errors import MechanicsError
from protochain.mechanics import multibody
from protochain.mechanisms import Model
from protochain.mechanisms.assembly import Assembly
from protochain.mechanisms.contact import Law


def near(gear: Gear, place: float = 0.0, until: float | None = None) -> tuple[range, range]:
    """Teeth that may touch while the driving wheel moves from a place along the line of action to another."""
    begin, end = gear.pair.path
    pitch = gear.pair.base_pitch
    last = place if until is None else until
    numbers = range(
        int(np.ceil((begin - last) / pitch - 0.5)), int(np.floor((end - place) / pitch + 0.5)) + 1
    )
    return numbers, numbers


def stiff_flanks(gear: Gear, factor: float = 1e5) -> Gear:
    """The same with flanks so many times as stiff as the teeth, and linear."""
    return replace(gear, flank=Law(factor * gear.stiffness * gear.pair.width, 1.0))


def at_rest(gear: Gear, place: float) -> tuple[Model, Floats]:
    """Model with the teeth that may touch, and its coordinates at rest, the driving wheel held at a place."""
    if not gear.torque > 0.0:
        raise MechanicsError(f"torque {gear.torque:g}: give one above 0, which holds the flanks together")
    base = gear.pair.wheels[0].base
    model = gears(gear, near(gear, place), start={"wheel 0": place / base})
    one, other = (model.bodies.freedom(f"wheel {k}")[0] for k in (0, 1))
    radius = np.full(model.tree.n_q, gear.pair.wheels[1].base)
    radius[:other] = base
    # Lengths along the line of action, in that by which one pair of teeth gives way.
    give = gear.error(1) * base
    free = np.delete(np.arange(model.tree.n_q), one)
    load = np.zeros(model.tree.n_q)
    load[other] = -gear.torque * gear.ratio

    def spread(y: Floats) -> Floats:
        q = model.q.copy()
        q[free] = y * give / radius[free]
        q[other] += place / gear.pair.wheels[1].base
        return q

    def lack(y: Floats) -> Floats:
        _, torque = model.system.potential(spread(y), model.start().factors)
        return (torque + load)[free] / gear.torque

    lag, forces = _in_series(gear, place)
    guess = np.zeros(model.tree.n_q)
    guess[other] = lag / give
    for n, force in forces.items():
        for k, sign in ((0, -1.0), (1, 1.0)):
            tooth = model.bodies.freedom(f"tooth {k} {n % gear.pair.teeth[k]}")[0]
            guess[tooth] = sign * force / (2.0 * gear.stiffness * gear.pair.width * give)
    found = root(lack, guess[free], method="hybr", options={"xtol": 1e-13})
    if not np.abs(lack(found.x)).max() < 1e-6:
        raise MechanicsError(f"no equilibrium of the gears is found at place {place:g}")
    return model, spread(found.x)


def _in_series(gear: Gear, place: float) -> tuple[float, dict[int, float]]:
    """Lag of the driven wheel and force of each pair of teeth, each as springs in series: nearly at rest."""
    pair, law, tooth = gear.pair, gear.flank, gear.stiffness * gear.pair.width
    wanted = gear.torque / pair.wheels[0].base

    def forces(lag: float) -> dict[int, float]:
        found = {}
        for n in near(gear, place)[0]:
            at = place + n * pair.base_pitch
            depth, by_front, _ = overlap(at, at + lag, *pair.corners)
            if depth > 0.0:
                found[n] = by_front * _force(depth, tooth, law.stiffness, law.exponent)
        return found

    most = 2.0 * (wanted / tooth + (wanted / law.stiffness) ** (1.0 / law.exponent))
    lag = brentq(lambda lag: sum(forces(lag).values()) - wanted, -most, 0.0, xtol=1e-18)
    return float(lag), forces(lag)


def _force(depth: float, tooth: float, flank: float, exponent: float) -> float:
    """Force of a tooth's spring and a flank in series at an overlap."""
    most = min(tooth * depth, flank * depth**exponent)
    return float(brentq(lambda f: f / tooth + (f / flank) ** (1.0 / exponent) - depth, 0.0, most, xtol=1e-12))


def lag_of(model: Assembly, q: Floats, gear: Gear) -> float:
    """Transmission error of the driving wheel, rad: its angle less the ratio times that of the driven one."""
    one, other = (model.bodies.freedom(f"wheel {k}")[0] for k in (0, 1))
    return float(q[one] - gear.ratio * q[other])


def frequency(gear: Gear, place: float) -> float:
    """Lowest frequency of the gears about rest at a place, rad/s, from their mass matrix and torques."""
    model, q = at_rest(gear, place)
    n, factors = model.tree.n_q, model.start().factors
    # Far below what flanks give way, in angles.
    give = (gear.torque / gear.pair.wheels[0].base / gear.flank.stiffness) ** (1.0 / gear.flank.exponent)
    h = 0.01 * give / gear.pair.wheels[1].base
    stiffness = np.empty((n, n))
    for k in range(n):
        step = np.zeros(n)
        step[k] = h
        ends = [model.system.potential(q + sign * step, factors)[1] for sign in (-1.0, 1.0)]
        stiffness[:, k] = (ends[0] - ends[1]) / (2.0 * h)
    mass = multibody.mass_matrix(model.tree, multibody.pose(model.tree, q))
    squares = np.sort(np.linalg.eigvals(np.linalg.solve(mass, stiffness)).real)
    # The lowest of all is the wheels' common turning, with none.
    return float(np.sqrt(squares[1]))
