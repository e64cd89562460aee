"""The compliance method: its limit cycle, what cures it, and what each of its kin needs.

    python analysis/benchmarks/compliance.py [evaluations] [starts] [angles] [-o DIR] [--quick]

1. ``evaluations``: those to a largest torque of 1 kJ/mol/rad on the samples, against scipy's L-BFGS-B on the
   same problem.
2. ``starts``: Met-enkephalin from random dihedrals: where KCM with a fixed step ends, by the step; and with
   every other setting.
3. ``angles``: extended Met-enkephalin by KCM with three fixed angles: torque and energy left in the cycle at
   the end, beside what one freedom of the largest curvature predicts, and steps to 1 kJ/mol.
"""

import argparse

import made
import numpy as np
import pandas as pd
from made import SAMPLES
from scipy.optimize import minimize

import protochain as pc
from protochain.minimisers import (
    KCM,
    RECIPES,
    BudgetSpentError,
    Descent,
    Fixed,
    Problem,
    Stop,
    Torsions,
    near_terms,
    run,
    separate_overlaps,
)  # fmt: skip

NAMES = ("ala10", "1l2y", "1vii")
METHODS = ("kcm-adaptive", "kcm-metric", "kcm-stiffness", "newton", "lbfgs")
MOST = 4000
STEPS = (0.1, 0.05, 0.02, 0.01, 0.005, 0.002)
STARTS = 6
BUDGET = 2000
ANGLES = (0.05, 0.01, 0.0005)
CYCLE = 50
"""Last points of a run with a fixed angle, whose medians are what it leaves."""


def random_starts(structure: pc.Structure, number: int) -> list[pc.Chain]:
    """Chains at random dihedrals, their overlaps parted."""
    base = pc.build_chain(structure, "phi psi chi omega rotors")
    chains = []
    for k in range(number):
        q = base.q0.copy()
        turns = [hinge.kind != "omega" for hinge in base.hinges]
        q[base.tree.q_start[base.hinge_body[turns]]] = np.random.default_rng(k).uniform(
            -np.pi, np.pi, sum(turns)
        )
        chain = pc.build_chain(structure.with_positions(pc.pose(base, q).x), base.opened)
        chains.append(pc.build_chain(separate_overlaps(chain).structure, base.opened))
    return chains


def problem_of(chain: pc.Chain, energy, budget: int) -> Problem:
    """A chain's energy with what is constant left out, and the metric that `minimise` has."""
    at = pc.pose(chain, chain.q0).x
    return Problem(
        Torsions(chain, near_terms(energy)), energy.without_constants(chain.rigid_groups, at), budget
    )


def enkephalin(options: argparse.Namespace) -> pd.DataFrame:
    """Where each setting ends from random starts, a row for each start."""
    starts, most = (1, 100) if options.quick else (STARTS, BUDGET)
    structure = pc.from_sequence("YGGFM")
    energy = pc.energy(structure, threads=1)
    settings = {f"kcm, {step:g} rad": Descent(KCM(), Fixed(step)) for step in STEPS}
    # Of md and anneal the first run alone would say nothing of the method.
    alone = [n for n, r in RECIPES.items() if r.keeps_geometry and n not in ("kcm", "md", "anneal")]
    settings |= {name: RECIPES[name].runs[0].method for name in alone}
    rows = []
    for k, chain in enumerate(random_starts(structure, starts)):
        for name, method in settings.items():
            moves = name in RECIPES and RECIPES[name].moves_masses
            own = pc.build_chain(chain, root="free") if moves else chain
            problem = problem_of(own, energy, most)
            points = []
            ending = run(problem, method, own.q0, 1e-3, most, points.append)
            residuals = np.array([point.residual for point in points])
            met = np.flatnonzero(residuals <= 1.0)
            circling = residuals[-50:] if ending.stop is Stop.BUDGET else residuals[-1:]
            rows.append(
                {
                    "start": k, "setting": name, "stop": ending.stop.name,
                    "torque_end_kj_mol_rad": np.median(circling),
                    "energy_end_kj_mol": problem.best.energy,
                    "evaluations": problem.n_evaluations, "met_1": bool(len(met)),
                }
            )  # fmt: skip
    return pd.DataFrame(rows)


def dense_hessian(problem: Problem, at) -> np.ndarray:
    """Hessian (n_v, n_v) by central differences of torques."""
    rows = []
    for turn in 1e-5 * np.eye(len(at.torque)):
        before, after = (problem.evaluate(problem.move(at.q, side * turn)) for side in (-1.0, 1.0))
        rows.append((before.torque - after.torque) / 2e-5)
    return 0.5 * (np.array(rows) + np.transpose(rows))


def angles(options: argparse.Namespace) -> pd.DataFrame:
    """What KCM with a fixed angle leaves in extended Met-enkephalin, and how soon it is near."""
    structure = pc.from_sequence("YGGFM")
    chain, energy = pc.build_chain(structure), pc.energy(structure, threads=1)
    rows = []
    for angle in ANGLES[: 1 if options.quick else None]:
        problem, points = problem_of(chain, energy, 10_000), []
        run(problem, pc.kcm(angle).runs[0].method, chain.q0, 1e-9, 500, points.append)
        polish = problem_of(chain, energy, 10_000)
        low = run(polish, RECIPES["lbfgs"].runs[0].method, problem.best.q, 1e-6, 500, lambda at: None)
        end = low.last.state.at
        eigenvalues = np.linalg.eigvalsh(dense_hessian(polish, end))
        heights = np.array([point.energy for point in points]) - end.energy
        rows.append(
            {
                "angle_rad": angle,
                "evaluations": problem.n_evaluations,
                "torque_left_kj_mol_rad": np.median([point.residual for point in points[-CYCLE:]]),
                "energy_left_kj_mol": np.median(heights[-CYCLE:]),
                "predicted_kj_mol": eigenvalues[-1] * (angle / 2) ** 2 / 2,
                "steps_to_1_kj_mol": int(np.argmax(heights <= 1.0)) if (heights <= 1.0).any() else np.nan,
                "softest_kj_mol_rad2": eigenvalues[0],
                "stiffest_kj_mol_rad2": eigenvalues[-1],
            }
        )
    return pd.DataFrame(rows)


def scipy_evaluations(problem: Problem, q: np.ndarray) -> float:
    """Count what L-BFGS-B needs; it begins again, a little aside, where its line search breaks off."""
    need = []

    def value_and_gradient(turn):
        at = problem.evaluate(q + turn)
        if at.residual <= 1.0:
            need.append(problem.n_evaluations)
            raise BudgetSpentError
        return at.energy, -at.torque

    limits = {"maxcor": 20, "ftol": 0.0, "gtol": 0.5, "maxiter": 20_000, "maxfun": 20_000}
    try:
        for attempt in range(20):
            aside = np.random.default_rng(attempt).normal(scale=1e-4, size=len(q))
            minimize(value_and_gradient, aside, jac=True, method="L-BFGS-B", options=limits)
    except BudgetSpentError:
        pass
    return need[0] if need else np.inf


def evaluations(options: argparse.Namespace) -> pd.DataFrame:
    """What every torsion method needs to 1 kJ/mol/rad on the samples; infinite if more than allowed."""
    rows = []
    for name in NAMES[: 1 if options.quick else None]:
        structure = pc.load(SAMPLES / f"{name}.pdb")
        chain, energy = pc.build_chain(structure), pc.energy(structure, threads=1)
        # Free roots turn on a group of their own, which scipy does not know.
        plain = chain.n_q == chain.n_v
        needs = scipy_evaluations(problem_of(chain, energy, MOST), chain.q0) if plain else np.nan
        row: dict[str, object] = {"structure": name, "hinges": chain.n_hinges, "L-BFGS-B": needs}
        for method in METHODS:
            problem = problem_of(chain, energy, MOST)
            end = run(problem, RECIPES[method].runs[0].method, chain.q0, 1.0, MOST, lambda at: None)
            row[method] = problem.n_evaluations if end.last.state.at.residual <= 1.0 else np.inf
        rows.append(row)
    return pd.DataFrame(rows)


STUDIES = {"evaluations": evaluations, "starts": enkephalin, "angles": angles}


def parser() -> argparse.ArgumentParser:
    return made.parser(__doc__, STUDIES)


def main() -> None:
    options = parser().parse_args()
    samples = [f"{each}.pdb" for each in NAMES]
    made.study(options, STUDIES, "compliance", lambda n, _: samples if n == "evaluations" else ["YGGFM"])


if __name__ == "__main__":
    main()
