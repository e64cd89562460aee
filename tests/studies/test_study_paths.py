"""The study of paths: lengths, entropy and ends against plain computations."""

import itertools

import numpy as np
import pandas as pd
import pytest
from fixtures.samples import ROOT
from scipy.spatial.transform import Rotation

import protochain as pc
from bench.studies import kcm_cases, lowest, paths
from bench.studies.kcm_cases import LEFT, Case, measured

CASE = Case("gag", "GAG", False, "phi psi chi", "obc2", "extended", 0)
RESULTS = ROOT / "analysis" / "results"


@pytest.mark.parametrize("method", ["kcm-0.005", "entropy-mass-0.03", "md-10", "lbfgs"])
def test_a_path_ends_where_the_run_of_the_study_comes_near_its_minimum(method):
    row, run = paths.measured_path(CASE, method), measured(CASE, method)
    assert tuple(row) == paths.COLUMNS
    assert row["finished"] and run["finished"]
    assert row["energy_kj_mol"] == pytest.approx(run["energy_kj_mol"], abs=1e-6)
    assert row["evaluations"] == run["evaluations_to_left"]
    assert 0.0 < row["largest_step_nm"] <= row["path_nm"]


def test_the_length_is_the_sum_over_the_points():
    start = kcm_cases.started(CASE)
    path, points = paths.PathLength(start.chain), []

    def note(at, n):
        path.note(at, n)
        points.append((at.q, at.x))

    for _, n in kcm_cases.legs(start, start.chain.q0, kcm_cases.TRIALS["kcm-0.005"], 200, note):
        if n >= 200:
            break
    turns = [np.sqrt(np.mean((b - a) ** 2)) for (a, _), (b, _) in itertools.pairwise(points)]
    assert sum(path.turns) == pytest.approx(sum(turns), rel=1e-9)
    # The largest hinge turns by 0.005 rad in each step.
    largest = [np.abs(b - a).max() for (a, _), (b, _) in itertools.pairwise(points)]
    assert largest == pytest.approx([0.005] * len(largest), rel=1e-6)
    assert path.until(path.energies[50]) <= 50 and path.until(-1e9) == len(points) - 1


def test_rigid_motion_has_no_length_and_masses_weigh_movements():
    draw = np.random.default_rng(5)
    x, masses = draw.normal(size=(20, 3)), draw.uniform(1.0, 16.0, 20)
    turned = x @ Rotation.from_rotvec([0.3, -1.0, 0.7]).as_matrix().T + [1.0, 2.0, 3.0]
    assert paths.movement(turned, x, masses) == pytest.approx(0.0, abs=1e-7)
    moved = x + 0.1 * draw.normal(size=x.shape)
    weights = masses / masses.sum()
    a, b = (points - weights @ points for points in (x, moved))
    rotation, _ = Rotation.align_vectors(a, b, weights=weights)
    expected = np.sqrt(np.sum(weights * np.sum((rotation.apply(b) - a) ** 2, axis=1)))
    assert paths.movement(moved, x, masses) == pytest.approx(expected, rel=1e-9)


def test_the_entropy_loss_is_that_of_differences_of_the_torques():
    start = kcm_cases.started(CASE)
    end = kcm_cases.polish(start, start.chain.q0)
    n, step = end.chain.n_v, 1e-4
    q, energy = end.q, start.energy

    def torque(change):
        at = pc.pose(end.chain, q + change)
        return pc.pull_back(end.chain, at, energy(at.x)[1])

    hessian = np.array([(torque(-step * row) - torque(step * row)) / (2.0 * step) for row in np.eye(n)])
    sign, log_det = np.linalg.slogdet(0.5 * (hessian + hessian.T))
    kt = 8.31446261815324e-3 * 300.0
    free, vibrating = n * np.log(2.0 * np.pi), 0.5 * (n * np.log(2.0 * np.pi * np.e * kt) - log_det)
    assert sign > 0
    assert paths.entropy_loss(end, energy) == pytest.approx(8.31446261815324 * (free - vibrating), rel=1e-5)


def test_a_study_goes_on_where_it_was_stopped(tmp_path, monkeypatch):
    monkeypatch.setattr(paths, "METHODS", ("kcm-stiffness", "lbfgs"))
    monkeypatch.setattr(paths, "peptides", lambda: [CASE])
    monkeypatch.setattr(paths, "SHOWN", "gag")
    assert list(paths.run(tmp_path, minutes=0.0)) == []
    first = [table["method"].iloc[0] for table in paths.run(tmp_path)]
    assert first == ["kcm-stiffness", "lbfgs"] and list(paths.run(tmp_path)) == []
    points = pd.read_csv(tmp_path / "path_points.csv")
    assert set(points["method"]) == set(first)
    assert (points.groupby("method")["path_nm"].diff().dropna() >= 0.0).all()
    with pytest.raises(pc.ProtochainError, match="1l2y: not among the inputs"):
        list(paths.run(tmp_path, [tmp_path / "other.pdb"]))


def test_paths_of_the_pages_end_near_the_minima_of_the_runs():
    rows = lowest.stored(RESULTS / "kcm_paths.csv", paths.COLUMNS)
    runs = pd.read_csv(RESULTS / "kcm_runs.csv", converters={"protein": str})
    is_one = (runs["energy"] == "obc2") & (runs["model"] == "phi psi chi") & (runs["seed"] == 0)
    runs = runs[is_one & (runs["start"] == "extended")].set_index(["protein", "method"])
    extended = rows[rows["start"] == "extended"].set_index(["protein", "method"])
    both = extended.join(runs.add_suffix("_run"), how="inner")
    both = both[both["finished"] & both["finished_run"]]
    assert len(both) > 200
    assert (both["evaluations"] == both["evaluations_to_left_run"]).mean() > 0.95
    # Runs of md at low friction are chaotic: another processor may end elsewhere.
    calm = both[~both.index.get_level_values("method").isin(["md-0.1", "md-1"])]
    assert (np.abs(calm["energy_kj_mol"] - calm["energy_kj_mol_run"]) < LEFT).mean() > 0.95
