"""Impacts with friction by Newton, Poisson and Stronge; one point, several, loops.

After Lidstrom (2015), of which the outline is known. What it treats, and where it is:

=======================================  ==============================================================
impulses on trees of rigid bodies        ``impacts.impact``: any tree, with and without loops
laws of restitution, Coulomb's friction  one point, or several, together or in turn
two rods whose tip strikes a floor       ``systems.rods``: of Kane and Levinson, *Dynamics* (1985)
dissipation of each impact               ``Impact.dissipation``: never negative by Poisson's and Stronge's
uniqueness                               starts that must agree; a priori: ``impacts.friction_bound``
impulses that are given                  ``impact(external=)``
impulse stress                           ``impacts.impulse_stress``: its mean in each rigid body
bodies that bend                         ``impact`` of a ``impacts.Bending``
=======================================  ==============================================================

Left out: waves in bodies, since instantaneous impulses move all of a body at once; and Cauchy's impulse
tensor as a field. Momentum and impulses settle its divergence and its mean; of rigid bodies the rest is open,
in bodies that bend shapes give displacements of sections, not stress within them, and rows of loops do not
say where in a body their joints bear.
"""

from collections.abc import Iterator

import numpy as np

from bench.cases import Found, Scene, left_out
from bench.scenes.impact import bounces, checks
from bench.scenes.impact.extremes import extremes
from bench.scenes.impact.paths import path_checks, traces, work
from bench.scenes.impact.study import random_impacts
from bench.scenes.impact.systems import chain
from protochain.core.arrays import Floats
from protochain.mechanics.multibody import mass_matrix, point_rows, row_matrix
from protochain.mechanics.multibody.articulated import articulate
from protochain.mechanisms.impacts import impact

IMPACTS, FEW = 100_000, 2000
"""Random impacts; of the quick scene."""


def run(quick: bool = False) -> Scene:
    """Run the scene; quick: fewer random impacts, short chains: some seconds."""
    gains = random_impacts(FEW if quick else IMPACTS, 0)
    bounced, end = bounces.bounce(bounces.ball(), ends=True)
    found = (
        *checks.known(), *bounces.bounce_checks(bounced, end), *path_checks(),
        *checks.random_checks(20 if quick else 200), *checks.gain_checks(gains),
    )  # fmt: skip
    return Scene(
        "impact", "impacts with friction: impulses on trees, with and without loops", found,
        tuple(work(quick)), tuple(extremes(quick)), tuple(_left_out(100 if quick else 1000)),
        {"gains": gains, "bounces": bounced, "paths": traces(), "cradles": checks.cradle_table()},
        "error of the velocities after",
    )  # fmt: skip


def _left_out(n: int) -> Iterator[Found]:
    """What an impact of a chain does without."""
    factors, qd, wall = chain(n)
    tree, frames = factors.tree, factors.frames

    def known() -> Floats:
        return impact(factors, qd, [wall]).qd

    def anew() -> Floats:
        return impact(articulate(tree, frames), qd, [wall]).qd

    def dense() -> Floats:
        rows = point_rows(frames, wall.bodies, np.stack([wall.point, wall.point]))
        g = row_matrix(tree, frames, rows)
        change = np.linalg.solve(mass_matrix(tree, frames), g.T @ impact(factors, qd, [wall]).impulse[0])
        return np.asarray(qd + change)

    yield left_out(f"factors of {n} bodies, which the motion has already", anew, known, 0.0, 20)
    yield left_out(f"the mass matrix of {n} bodies, as a matrix", dense, known, 1e-9)
