"""How far the muzzle moves, over the stiffness of deck and axle: the claim that soft axles keep it still.

Wang, Xiao, Ouyang (ASME DETC 1999) report that a soft axle with an equilibrator brings the motion of the
muzzle down to ten per cent. Their data were not found: here the claim is tried on the gun chosen.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pandas as pd

from bench.scenes.gun.parts import ELEVATION, Built, Gun, built

DECKS = (1e6, 1e7, 1e8, 1e9, 1e10)
"""N/m."""
AXLES = (1e5, 1e6, 1e7, 1e8, 1e9)
"""N m/rad."""
BLOW = 1e4
"""Impulse of the blow on the deck, N m s."""
EXIT, UNTIL = 0.01, 0.5
"""s: when a projectile has left the barrel, and the next shot."""
CLAIM = 0.1


def amplitudes(found: Built, until: float = UNTIL) -> tuple[float, float, float]:
    """Largest way of the muzzle across the bore until a projectile has left and to the end, and of elevation.

    In m, m and rad, from where it stood.
    """
    run = found.run(until)
    moved = np.abs(found.aside(run))
    early = run.time <= EXIT + 1e-9
    return float(np.max(moved[early, 0])), float(np.max(moved[:, 0])), float(np.max(moved[:, 1]))


def isolation(
    decks: tuple[float, ...] = DECKS, axles: tuple[float, ...] = AXLES, until: float = UNTIL
) -> pd.DataFrame:
    """Amplitudes of the muzzle by deck and axle, with and without equilibrator, in mm and mrad.

    ``share`` and ``share_early`` are relative to the stiffest axle on the same deck. Without couple the
    powder pushes through the centre of mass of what recoils. ``sag`` is how far the
    barrel hangs below its elevation before the shot.
    """
    rows = []
    for case, gun in (
        ("shot", Gun()), ("shot, no equilibrator", Gun(balanced=0.0)), ("shot, no couple", Gun(offset=0.0)),
        ("blow to the deck", Gun(charge=0.0, blow=BLOW)),
    ):  # fmt: skip
        for deck in decks:
            for axle in axles:
                found = built(replace(gun, deck=deck, axle=axle))
                sag = ELEVATION - found.muzzle_at(found.start)[2]
                rows.append((case, deck, axle, *(1e3 * np.array([*amplitudes(found, until), sag]))))
    names = ["case", "deck", "axle", "early_mm", "muzzle_mm", "muzzle_mrad", "sag_mrad"]
    table = pd.DataFrame(rows, columns=names)
    last = table.groupby(["case", "deck"])[["early_mm", "muzzle_mm"]].transform("last")
    table["share_early"] = table["early_mm"] / last["early_mm"]
    table["share"] = table["muzzle_mm"] / last["muzzle_mm"]
    return table


def claimed(table: pd.DataFrame) -> pd.DataFrame:
    """Least share that any axle reaches on each deck, and whether it is the ten per cent claimed."""
    rows = []
    for (case, deck), own in table.groupby(["case", "deck"], sort=False):
        for what in ("share_early", "share"):
            shares = own[what].to_numpy()
            least = float(np.min(shares))
            best = float(own["axle"].to_numpy()[np.argmin(shares)])
            when = "until the projectile has left" if what == "share_early" else "until the next shot"
            rows.append((case, deck, when, best, least, least <= CLAIM))
    return pd.DataFrame(rows, columns=["case", "deck", "when", "best_axle", "least_share", "ten_per_cent"])


def flexible(cells: int, pairs: tuple[tuple[float, float], ...], until: float = UNTIL) -> pd.DataFrame:
    """Amplitudes of the muzzle of a tube that bends, beside those of a rigid one."""
    rows = []
    for deck, axle in pairs:
        for n in (0, cells):
            found = amplitudes(built(Gun(deck=deck, axle=axle, cells=n)), until)
            rows.append((deck, axle, n, *(1e3 * np.array(found))))
    return pd.DataFrame(rows, columns=["deck", "axle", "cells", "early_mm", "muzzle_mm", "muzzle_mrad"])


def bursts(cells: int, shots: int = 3) -> pd.DataFrame:
    """Motion in a burst: deck, recoil, muzzle, and energies, with a stiff axle and a soft one."""
    return pd.concat(list(_bursts(cells, shots)), ignore_index=True)


def _bursts(cells: int, shots: int) -> Iterator[pd.DataFrame]:
    until = 0.5 * shots
    for label, gun in (
        ("stiff axle", Gun(deck=1e7, axle=1e9, shots=shots)),
        ("soft axle", Gun(deck=1e7, axle=1e6, shots=shots)),
        (f"stiff axle, {cells} cells", Gun(deck=1e7, axle=1e9, shots=shots, cells=cells)),
    ):
        found = built(gun)
        run = found.run(until, 1e-6, 2.5e-3)
        moved = found.aside(run)
        heave, roll, recoil = (
            run.q[:, found.model.bodies.freedom(hinge)[0]] for hinge in ("heave", "roll", "tube")
        )
        yield pd.DataFrame({
            "gun": label, "time": run.time, "heave_mm": 1e3 * (heave - heave[0]),
            "roll_mrad": 1e3 * (roll - roll[0]),
            "recoil_m": recoil[0] - recoil, "muzzle_mm": 1e3 * moved[:, 0], "muzzle_mrad": 1e3 * moved[:, 1],
            "kinetic_J": run.kinetic, "dissipation_J": run.dissipation,
        })  # fmt: skip
