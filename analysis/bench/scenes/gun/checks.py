"""What the gun is held against: other coordinates, modes in closed form, a fixed deck, energy."""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np
import pandas as pd

from bench.cases import Found, Point, check, tried, vanishes
from bench.fits import exponent, order
from bench.scenes.gun import search, study
from bench.scenes.gun.oracle import Planar
from bench.scenes.gun.parts import Gun, built
from protochain.core.arrays import Floats
from protochain.mechanics.motion import DormandPrince, ImplicitMidpoint, Integrator, RungeKutta4
from protochain.mechanisms import Rosenbrock, frequencies, state_matrix

FIXED = "no deck"
MODES = "modal superposition, eigh"
EXACT = "equations in absolute angles, DOP853"
FLOATING = Gun()
UNITS = ("x, m", "z, m", "elevation, rad")


def against_equations(quick: bool) -> Iterator[Found]:
    """Muzzle in large motion against equations of another kind."""
    cases: tuple[tuple[str, Gun, float], ...] = (
        ("rigid, two shots", Gun(deck=1e7, axle=1e6, shots=2), 0.1 if quick else 0.7),
        ("rigid, soft, no equilibrator", Gun(deck=1e6, axle=1e5, balanced=0.0), 0.1 if quick else 0.5),
        ("rigid, another equilibrator and damper", Gun(deck=1e7, axle=1e5, balanced=1.5, ratio=1.0), 0.1),
        ("rigid, a blow to the deck", Gun(deck=1e7, axle=1e5, charge=0.0, blow=1e4), 0.1),
        ("4 cells", Gun(cells=4), 0.02 if quick else 0.1),
        *(() if quick else (("8 cells, soft", Gun(deck=1e6, axle=1e5, cells=8), 0.05),)),
    )
    for label, gun, until in cases:
        found, planar = built(gun), Planar(gun)
        off = np.max(np.abs(found.muzzle_at(found.start) - planar.muzzle(planar.standing)))
        yield vanishes(f"muzzle before the shot, {label}", off, 1e-9, "scipy's root")
        end = found.end(DormandPrince(1e-11), 0.01, until)
        for value, oracle, unit in zip(end, planar.moved(np.array([until]))[0], UNITS, strict=True):
            yield check(f"muzzle after {until:g} s, {label}: {unit}", value, oracle, 2e-8, EXACT, "absolute")


def against_modes(cells: int, charges: tuple[float, ...] = (1e-2, 3e-3, 1e-3)) -> Iterator[Found]:
    """Small motions, without dampers, against the sum of modes."""
    times, errors = np.array([0.01, 0.03, 0.06, 0.1]), []
    for charge in charges:
        gun = replace(FLOATING, damped=0.0, charge=charge, cells=cells)
        found = built(gun)
        w, moved = Planar(gun).modes(times)
        first = found.muzzle_at(found.start)
        ends = np.array([found.end(DormandPrince(1e-13), 0.01, t) for t in times]) - first
        errors.append(np.max(np.abs(ends - moved), axis=0) / np.max(np.abs(moved), axis=0))
    label = f"{cells} cells" if cells else "rigid barrel"
    w_found = frequencies(found.model, found.start)
    yield vanishes(
        f"frequencies, {label}: largest relative error", np.max(np.abs(w_found / w - 1.0)), 1e-8, MODES,
    )  # fmt: skip
    for error, unit in zip(errors[-1], UNITS, strict=True):
        name = f"muzzle by a thousandth of the charge, {label}: {unit.split(',')[0]}, relative error"
        yield vanishes(name, error, 5e-3, MODES)
    order = exponent(charges, np.array(errors)[:, 2])
    yield check(f"order of that error in the charge, {label}", order, 1.0, 0.02, "small motions", "absolute")


def against_fixed_deck() -> tuple[pd.DataFrame, list[Found]]:
    """Muzzle on ever stiffer decks against that without a deck: the error falls as 1/k_d."""
    until = 0.03
    fixed = built(Gun(deck=np.inf)).end(DormandPrince(1e-12), 0.005, until)
    decks = (1e9, 1e10, 1e11, 1e12, 1e13)
    rows = []
    for deck in decks:
        off = built(Gun(deck=deck)).end(DormandPrince(1e-12), 0.005, until) - fixed
        rows.append((deck, float(np.linalg.norm(off[:2])), float(abs(off[2]))))
    table = pd.DataFrame(rows, columns=["deck", "place", "elevation"])
    found = [
        check(
            f"exponent of the error in k_d from 1e11, {what}", exponent(table["deck"][2:], table[what][2:]),
            -1.0, 0.05, FIXED, "absolute",
        )
        for what in ("place", "elevation")
    ]  # fmt: skip
    return table, found


def energies(quick: bool) -> Iterator[Found]:
    """Energy with and without dampers; without, the gun is released from where it does not stand."""
    for cells in (0,) if quick else (0, 4):
        still = built(Gun(deck=1e7, damped=0.0, charge=0.0, cells=cells, axle=1e6))
        q = still.start.q.copy()
        q[:4] += 0.01, 0.01, 0.02, -0.3
        start = still.model.system.at(q, np.zeros(still.model.tree.n_v))
        run = still.model.simulate(0.1 if quick else 0.3, 0.01, DormandPrince(1e-11), start=start)
        label = f"{cells} cells" if cells else "rigid barrel"
        error = run.audit().energy
        yield vanishes(f"energy, released without dampers, {label}", error, 1e-8, "the start")
        shot = built(Gun(cells=cells)).run(0.05 if quick else 0.3, 1e-10, 0.01).audit().energy
        yield vanishes(f"energy that is no work, one shot, {label}", shot, 1e-8, "work")


def of_search(table: pd.DataFrame) -> Iterator[Found]:
    """Largest way of the muzzle with the best axle that the search found, by the other equations."""
    times = np.linspace(0.0, study.EXIT, 6)[1:]
    early = table[table["when"] == search.EARLY].to_dict("records")
    for (case, gun), best in zip(search.CASES, early, strict=True):
        planar = Planar(
            replace(gun, deck=search.DECK, axle=best["axle"], ratio=best["ratio"], balanced=best["balanced"])
        )
        x, z, elevation = planar.muzzle(planar.standing)
        moved = planar.moved(times)
        aside = (moved[:, 1] - z) * np.cos(elevation) - (moved[:, 0] - x) * np.sin(elevation)
        name = f"muzzle until the projectile has left, best of the search, {case}: mm"
        # The search's runs have a tolerance of 1e-6, which is 2e-3 of a tenth of a millimetre.
        yield check(name, best["muzzle_mm"], 1e3 * float(np.max(np.abs(aside))), 5e-3, EXACT)


def by_cells(numbers: tuple[int, ...]) -> tuple[pd.DataFrame, list[Found]]:
    """Droop of the muzzle, and frequency of the tube's second bending, by ever more cells."""
    rows = []
    for cells in numbers:
        gun = built(Gun(cells=cells, damped=0.0))
        w = frequencies(gun.model, gun.start)
        # Below it are those of slide, deck and axle, and the first bending.
        rows.append((cells, gun.muzzle_at(gun.start)[2], w[4]))
    table = pd.DataFrame(rows, columns=["cells", "elevation", "frequency"])
    found = []
    for what in ("elevation", "frequency"):
        name = "order of the error in cells, {}, {} and {}: {}".format(*numbers[-3:], what)
        found.append(check(name, order(*table[what].tail(3)), 2.0, 0.15, "1/n^2", "absolute"))
    return table, found


def work(quick: bool) -> list[Point]:
    """Error of the muzzle's place after a twentieth of a second, by integrators and their steps."""
    until, rows = 0.05, []
    guns = [("", Gun(cells=4 if quick else 8))]
    if not quick:
        guns.append((", tube 300 times as stiff", Gun(cells=4, bending=300.0)))
    for label, gun in guns:
        found = built(gun)
        exact = Planar(gun).moved(np.array([until]))[0]
        longest = 2.5 / np.max(np.abs(np.linalg.eigvals(state_matrix(found.model, found.start))))
        most = 2 if quick else 5
        explicit = [(f"{share:g} of the longest", share * longest) for share in (1.0, 0.5, 0.25)]
        implicit = [(f"{1e3 * h:g} ms", h) for h in (2e-3, 1e-3, 5e-4, 2.5e-4, 1.25e-4)]
        settings: list[tuple[str, Integrator, str, float]] = [
            *(("Kutta", RungeKutta4(), *each) for each in explicit[:most]),
            *(("Dormand-Prince", DormandPrince(t), f"{t:g}", 0.01) for t in (1e-5, 1e-7, 1e-9)[:most]),
            *(("midpoint", ImplicitMidpoint(), *each) for each in implicit[:most]),
            *(("Rosenbrock", Rosenbrock(t), f"{t:g}", 2e-3) for t in (1e-3, 1e-5, 1e-7)[:most]),
        ]  # fmt: skip
        for method, integrator, setting, h in settings:
            end = partial(found.end, integrator, h, until)
            rows.append(tried(method + label, setting, end, partial(_apart, exact)))
    return rows


def _apart(a: Floats, b: Floats) -> float:
    return float(np.linalg.norm(a[:2] - b[:2]))
