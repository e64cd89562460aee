"""The study of KCM against dynamics: what a run records, what is resumed, what counts, what may be said."""

import dataclasses

import numpy as np
import pandas as pd
import pytest
from fixtures.samples import ROOT

import protochain as pc
from bench.studies import kcm, kcm_cases, kcm_summary
from bench.studies.kcm_cases import LEFT, TRIALS, Case, measured

CASE = Case("gag", "GAG", False, "phi psi", "vacuum", "extended", 1)
FEW = ("kcm-adaptive", "kcm-metric", "lbfgs")
RESULTS = ROOT / "analysis" / "results"


@pytest.fixture
def small(monkeypatch):
    """Two peptides, one start beside the unperturbed one, three methods, one model and energy."""
    monkeypatch.setattr(kcm_cases, "PEPTIDES", {"gag": "GAG", "aya": "AYA"})
    monkeypatch.setattr(kcm_cases, "METHODS", FEW)
    monkeypatch.setattr(kcm_cases, "CONTROLS", {})
    monkeypatch.setattr(kcm, "MODELS", ("phi psi chi",))
    monkeypatch.setattr(kcm, "ENERGIES", ("obc2",))
    monkeypatch.setattr(kcm, "TRACED", 50)
    return {"starts": 1, "evaluations": 60}


# --- Runs


def step_of(recipe):
    (run,) = recipe.runs
    method = run.method
    if hasattr(method, "time_step"):
        return method.time_step
    return method.direction.safety if hasattr(method.direction, "safety") else method.rule.length


def test_every_contrast_is_of_methods_that_run_with_controls_of_their_own_and_none_resolves_clashes():
    for each in kcm_summary.CONTRASTS:
        for name in (each.a, each.b):
            assert name in TRIALS and (each.is_control or f"{name}-half" in TRIALS)
    assert not any(trial.recipe.parts_overlaps for trial in TRIALS.values())
    for name, trial in TRIALS.items():
        if name.endswith("-half"):
            assert step_of(trial.recipe) == 0.5 * step_of(TRIALS[name.removesuffix("-half")].recipe)
        elif name.endswith("-nudged"):
            assert dataclasses.replace(trial, nudged=False) == TRIALS[name.removesuffix("-nudged")]
        elif name.endswith("-fixed"):
            assert dataclasses.replace(trial, root="auto") == TRIALS[name.removesuffix("-fixed")]


@pytest.mark.parametrize("method", ["kcm-0.005", "md-10", "openmm"])
def test_a_run_records_its_end_and_the_minimum_below(method):
    row = measured(CASE, method, 3000)
    assert set(row) == set(kcm_cases.COLUMNS)
    assert row["energy_kj_mol"] <= row["end_kj_mol"] + 1e-9 and row["finished"]
    assert row["left_kj_mol"] >= row["end_kj_mol"] - row["energy_kj_mol"] - 1e-9
    assert row["polish_status"] == "converged" and row["torque_max_kj_mol_rad"] <= kcm_cases.POLISH
    assert row["lowest_eigenvalue_kj_mol_rad2"] > 0
    lowest = np.array([row[f"energy_at_{n}"] for n in kcm_cases.AT])
    assert (np.diff(lowest) <= 0).all()
    if method != "openmm":
        assert lowest[0] == pytest.approx(row["energy_start_kj_mol"], abs=1e-6)
        near = np.array(kcm_cases.AT) >= row["evaluations_to_left"]
        assert (lowest[near] <= row["energy_kj_mol"] + LEFT).all()
    assert len(row["torsions_deg"].split()) == row["hinges"]


@pytest.mark.parametrize("method", ["kcm-adaptive", "md-1"])
def test_legs_are_one_run(method):
    """A run in legs visits the points of a run without them."""
    start = kcm_cases.started(CASE).of(TRIALS[method].recipe)

    def visited(first):
        points = []
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(kcm_cases, "FIRST", first)
            start.warm(TRIALS[method].recipe)
            for _ in kcm_cases.legs(
                start, start.chain.q0, TRIALS[method], 200, lambda at, n: points.append((n, at.energy))
            ):
                pass
        return dict(points)

    assert visited(13) == visited(200)


def test_a_fixed_angle_that_circles_is_given_up_and_not_finished():
    wide = dataclasses.replace(TRIALS["kcm-0.005"], recipe=pc.kcm(0.3))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(kcm_cases, "TRIALS", {**TRIALS, "wide": wide})
        row = measured(CASE, "wide", 50_000)
    assert row["status"] == "circling" and not row["finished"] and row["evaluations"] < 50_000


def test_it_goes_on_where_it_stopped(small, tmp_path, monkeypatch):
    path = tmp_path / "runs.csv"
    tables = list(kcm.run(tmp_path, **small))
    runs = kcm.stored(path)
    assert len(runs) == 2 * 2 * len(FEW) and "12 of 12 runs planned" in tables[-1]["summary"][0]
    written = (tmp_path / "contrasts.csv").read_bytes()
    assert {"cost.csv", "deposited.csv", "kcm.png", "traces.csv"} < {each.name for each in tmp_path.iterdir()}

    # The last line was cut off when the machine stopped: that run alone is made again.
    path.write_text(path.read_text()[:-30])
    ran = []
    monkeypatch.setattr(kcm, "measured", lambda *task: ran.append(task) or measured(*task))
    assert not ran and len(kcm.stored(path)) == 11
    list(kcm.run(tmp_path, **small))
    assert [(task[0].protein, task[1]) for task in ran] == [(runs["protein"].iloc[-1], FEW[-1])]
    again = kcm.stored(path)
    differ = [name for name in runs if name != "seconds" and not runs[name].equals(again[name])]
    assert not differ
    assert len(ran) == 1 and (tmp_path / "contrasts.csv").read_bytes() == written

    # What is there counts as what it is: other settings are other runs.
    *_, said = kcm.run(tmp_path, minutes=0.0, starts=1, evaluations=61)
    assert "0 of 12 runs planned, and 12 others" in said["summary"][0] and len(ran) == 1


# --- The summary, of runs made up


def test_the_tables_of_the_pages_are_those_of_the_runs():
    """Contrasts of the results are recomputed from the runs."""
    runs = kcm.stored(RESULTS / "kcm_runs.csv")
    stored = pd.read_csv(RESULTS / "kcm_contrasts.csv")
    made = kcm_summary.contrasts(kcm_summary.compared(runs[runs["energy_kj_mol"].notna()]))
    pd.testing.assert_frame_equal(made.reset_index(drop=True), stored, check_dtype=False, rtol=1e-9)
