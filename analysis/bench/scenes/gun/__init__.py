"""A gun on a deck: recoil, a tube that bends, and if a soft axle keeps its muzzle still.

After Wang, Xiao, Ouyang (ASME DETC 1999), whose data were not found: those of ``parts`` are chosen. What is
known of it from others, and where it is:

=============================================  ===========================================================
deck, mount, cradle on an axle, recoil         ``parts``: the deck heaves and rolls; recuperator and brake
equilibrator                                   ``parts``: a spring hooked to mount and cradle
barrel that bends                              ``parts``: rigid, or of finite segments
blow to the deck, shot, bursts                 ``study``
a soft axle leaves ten per cent at the muzzle  ``search``: of a blow; of a shot, till it is out
=============================================  ===========================================================

Left out: motions of the deck out of the plane of fire, and the projectile, whose push is a pulse.
"""

from bench.cases import Scene
from bench.scenes.gun import checks, study
from bench.scenes.gun.extremes import limits, without
from bench.scenes.gun.search import searched


def run(quick: bool = False) -> Scene:
    """Run the scene; quick: two decks, two axles and short motions: some seconds."""
    decks, convergence = checks.against_fixed_deck()
    cells, order = checks.by_cells((2, 4, 8) if quick else (4, 8, 16))
    isolation = study.isolation((1e6, 1e9), (1e6, 1e9), 0.2) if quick else study.isolation()
    bending = (
        study.flexible(2, ((1e7, 1e9),), 0.05) if quick
        else study.flexible(8, ((1e6, 1e6), (1e6, 1e9), (1e10, 1e6), (1e10, 1e9)))
    )  # fmt: skip
    search = searched((2, 2, 2), 8, 0.05) if quick else searched()
    found = (
        *checks.against_equations(quick), *checks.against_modes(0), *checks.against_modes(2 if quick else 4),
        *convergence, *order, *checks.energies(quick), *checks.of_search(search),
    )  # fmt: skip
    return Scene(
        "gun", "a gun on a deck: where its muzzle is 0.05 s after a shot", found, checks.work(quick),
        tuple(limits(quick)), tuple(without(quick)),
        {
            "isolation": isolation, "claim": study.claimed(isolation), "search": search,
            "flexible": bending, "decks": decks, "cells": cells,
            "bursts": study.bursts(2 if quick else 8, 1 if quick else 3),
        },
        "error of the muzzle, m",
    )  # fmt: skip
