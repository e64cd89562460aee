"""The study of KCM against dynamics: what a run records, what is resumed, what counts, what may be said."""

import dataclasses
import itertools

import numpy as np
import pandas as pd
import pytest
import scipy.stats
from fixtures.samples import ROOT

import protochain as pc
from bench.studies import kcm, kcm_cases, kcm_summary, lowest
from bench.studies.kcm_cases import LEFT, TRIALS, Case, measured
from bench.studies.kcm_statistics import holm, power, proteins_needed, sign_flip

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
    for each in (*kcm_summary.CONTRASTS, *kcm_summary.BODY_CONTRASTS):
        for name in (each.a, each.b):
            assert name in TRIALS and (each.is_control or f"{name}-half" in TRIALS)
    assert not any(trial.recipe.parts_overlaps for trial in TRIALS.values())
    for name, trial in TRIALS.items():
        if name.endswith("-half"):
            assert step_of(trial.recipe) == 0.5 * step_of(TRIALS[name.removesuffix("-half")].recipe)
        elif name.endswith("-nudged"):
            assert dataclasses.replace(trial, nudged=False) == TRIALS[name.removesuffix("-nudged")]
        elif trial.body:
            free = dataclasses.replace(trial, root="auto", body="")
            assert free == TRIALS[name.removesuffix(f"-{trial.body}")]
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


@pytest.mark.slow
def test_the_tables_of_the_pages_are_those_of_the_runs():
    """Contrasts of the results are recomputed from the runs."""
    runs = kcm.stored(RESULTS / "kcm_runs.csv")
    stored = pd.read_csv(RESULTS / "kcm_contrasts.csv")
    made = kcm_summary.contrasts(kcm_summary.compared(runs[runs["energy_kj_mol"].notna()]))
    pd.testing.assert_frame_equal(made.reset_index(drop=True), stored, check_dtype=False, rtol=1e-9)


def test_bodies_and_lowest_minima_of_the_pages_are_those_of_the_runs():
    runs, searches = kcm.stored(RESULTS / "kcm_runs.csv"), lowest.stored(RESULTS / "lowest.csv")
    minima = kcm_summary.lowest_known(runs, searches)
    made = {
        "bodies": kcm_summary.bodies(runs), "choices": kcm_summary.choices(runs), "minima": minima,
        "above": kcm_summary.above(runs, minima),
    }  # fmt: skip
    for name, table in made.items():
        stored = pd.read_csv(RESULTS / f"kcm_{name}.csv")
        pd.testing.assert_frame_equal(table.reset_index(drop=True), stored, check_dtype=False, rtol=1e-9)
    # No run in the same bodies and the same energy ends below a lowest known minimum.
    known = minima.set_index("protein")["lowest_kj_mol"]
    ends = kcm_summary._peptides(runs).groupby("protein")["energy_kj_mol"].min()
    assert (ends.reindex(known.index) >= known - 1e-6).all() and len(known) >= 10


@pytest.mark.parametrize("body", kcm_cases.BODIES)
@pytest.mark.parametrize(
    ("sequence", "planes"), [("YGGFM", (1, 2, 4)), ("AA", (1, 1, 1)), ("KPAPEW", (1, 3, 5))]
)
def test_a_fixed_body_is_a_peptide_plane_and_all_hinges_turn(sequence, planes, body):
    case = Case("peptide", sequence, False, "phi psi chi", "obc2", "extended", 0)
    free, fixed = kcm_cases.started(case, "free").chain, kcm_cases.started(case, "fixed", body).chain
    assert {hinge.name for hinge in fixed.hinges} == {hinge.name for hinge in free.hinges}
    assert fixed.n_v == fixed.n_hinges == free.n_v - 6
    # The plane of a number ends at the nitrogen of the next residue.
    number = planes[list(kcm_cases.BODIES).index(body)]
    s = fixed.structure
    root = {(int(s.atom_residue[k]) + 1, str(s.atom_name[k])) for k in np.flatnonzero(fixed.atom_body == 0)}
    assert {(number, "C"), (number, "O"), (number + 1, "N")} <= root and (number, "CA") not in root


def test_ends_are_counted_from_the_lowest_minimum_of_all_sources():
    """Of runs made up: a peptide that csa found lower, one that a run found lower, one without a search."""

    def run_of(protein, method, energy, finished=True, start="extended", seed=0):
        return {
            "protein": protein, "model": "phi psi chi", "energy": "obc2", "start": start, "seed": seed,
            "method": method, "residues": 5, "finished": finished, "energy_kj_mol": energy,
        }  # fmt: skip

    runs = pd.DataFrame(
        [
            run_of("a", "kcm-0.005", -10.0), run_of("a", "md-10", -20.0), run_of("a", "openmm", -99.0),
            run_of("b", "kcm-0.005", -10.0), run_of("b", "md-10", -15.0, finished=False),
            run_of("b", "lbfgs", -32.0, seed=1), run_of("c", "kcm-0.005", -5.0), run_of("c", "md-10", -5.0),
        ]
    )  # fmt: skip
    searches = pd.DataFrame(
        {"protein": ["a", "a", "b"], "evaluations": [10, 20, 30], "energy_kj_mol": [-20.03, -19.0, -31.0]}
    )
    minima = kcm_summary.lowest_known(runs, searches)
    assert list(minima["protein"]) == ["a", "b", "c"] and list(minima["csa_evaluations"]) == [30, 30, 0]
    assert list(minima["lowest_kj_mol"]) == [-20.03, -32.0, -5.0]
    assert list(minima["source"]) == ["csa", "lbfgs", "kcm-0.005"]
    above = kcm_summary.above(runs, minima).set_index("method")
    assert list(above.index) == ["kcm-0.005", "md-10"]
    assert above["above_kj_mol"]["kcm-0.005"] == pytest.approx((10.03 + 22.0 + 0.0) / 3)
    assert above.loc["md-10", ["peptides", "left_out", "lowest"]].tolist() == [2, 1, 2]
    # Two of two, and one of three: exact limits at 95 % from both sides.
    assert above["lowest_high"]["md-10"] == 1.0
    expected = scipy.stats.beta.ppf(0.975, 2, 2)
    assert above["lowest_high"]["kcm-0.005"] == pytest.approx(expected)


def test_a_conclusion_needs_an_adjusted_p():
    """Runs made up: of three contrasts one has an effect in every protein, one in a quarter, one in none."""
    rows = []
    for k in range(12):
        for method in ("kcm-metric", "kcm-stiffness", "md-10"):
            at = {"kcm-metric": 0.0, "kcm-stiffness": 90.0, "md-10": 90.0 * (k % 4 == 0)}[method]
            for end in ("", "-half", "-nudged"):
                rows.append(
                    {"protein": f"p{k}", "model": "phi psi chi", "energy": "obc2", "start": "extended",
                     "seed": 0, "method": method + end, "residues": 5, "finished": True, "energy_kj_mol": at,
                     "torsions_deg": f"{at}"}
                )  # fmt: skip
    table = kcm_summary.contrasts(kcm_summary.compared(pd.DataFrame(rows)))
    row = table[table["effect_p"].notna()].set_index("what")
    assert row["effect_p"]["stiffness and masses"] == pytest.approx(2.0**-11)
    assert row["effect_p"]["inertia, friction 10"] == pytest.approx(0.25)
    # Three effects and one difference of effects in this scope.
    assert list(row["effect_p_scope"]) == pytest.approx(list(holm(row["effect_p"])))
    assert row["effect_p_scope"]["inertia, friction 10"] == pytest.approx(0.25)
    said = {
        what: kcm_summary.sentence_of({**table[table["what"] == what].iloc[0]})
        for what in ("stiffness and masses", "inertia, friction 10")
    }
    assert "an effect (p 0.00049" in said["stiffness and masses"]
    needed = row["proteins_needed"]["inertia, friction 10"]
    assert (
        "not resolved (p 0.25" in said["inertia, friction 10"]
        and f"{needed:.0f} proteins" in said["inertia, friction 10"]
    )
    assert power([1.0] * 3 + [0.0] * 9, int(needed), 0.05) >= 0.8


# --- The tests themselves


def all_signs(values):
    """p by all choices of signs."""
    values = np.asarray(values)
    sums = [abs(np.dot(signs, values)) for signs in itertools.product((-1, 1), repeat=len(values))]
    return np.mean(np.array(sums) >= abs(values.sum()) - 1e-9)


def test_sign_flips_are_all_of_them():
    rng = np.random.default_rng(5)
    for k in range(60):
        n = int(rng.integers(1, 13))
        shares = rng.choice([0, 1, -1, 0.5, 1 / 3, -0.25, 2 / 3], n)
        values = shares if k % 2 else rng.normal(0.5, 1.0, n)
        assert sign_flip(values) == pytest.approx(all_signs(values), abs=1e-12)
    # The least p of n effects of one sign is 2^(1-n), and none is no evidence.
    assert sign_flip([0.2, 1.0, 3.0, 0.0]) == 0.25 and sign_flip(np.zeros(4)) == 1.0
    assert sign_flip(np.linspace(1.0, 2.0, 30)) == pytest.approx(2.0**-29)


def test_a_sign_flip_is_wilcoxon_of_ranks():
    """scipy's exact signed-rank test flips the signs of the ranks."""
    rng = np.random.default_rng(2)
    for n in (6, 11, 20):
        x = rng.normal(0.4, 1.0, n)
        ranks = np.sign(x) * scipy.stats.rankdata(np.abs(x))
        expected = scipy.stats.wilcoxon(x, mode="exact").pvalue
        assert sign_flip(ranks) == pytest.approx(expected, abs=1e-12)


def test_holm_is_that_of_his_paper():
    # By hand: 0.01 x 4, 0.02 x 3 = 0.06, 0.03 x 2 = 0.06, 0.04 x 1 < 0.06.
    assert holm([0.04, 0.01, np.nan, 0.03, 0.02]) == pytest.approx(
        [0.06, 0.04, np.nan, 0.06, 0.06], nan_ok=True
    )
    assert holm([0.5, 0.9]) == pytest.approx([1.0, 1.0]) and len(holm([])) == 0
    # Rejections at any level are those of the step-down procedure.
    rng = np.random.default_rng(4)
    for level in (0.01, 0.05, 0.2):
        p = rng.uniform(size=15) ** 3
        rejected = np.zeros(15, bool)
        for step, k in enumerate(np.argsort(p)):
            if p[k] > level / (15 - step):
                break
            rejected[k] = True
        assert ((holm(p) <= level) == rejected).all()


@pytest.mark.parametrize(("n", "level"), [(30, 0.05), (80, 0.05), (80, 0.005)])
def test_power_of_effects_of_one_size_is_binomial(n, level):
    """Of k effects of 1 among zeros p is 2^(1-k): k must reach 1 - log2(level)."""
    least = int(np.ceil(1.0 - np.log2(level)))
    expected = scipy.stats.binom.sf(least - 1, n, 0.1)
    # Four standard errors of the samples.
    assert power([1.0] + [0.0] * 9, n, level) == pytest.approx(expected, abs=4 * np.sqrt(0.25 / 1000))
    needed = proteins_needed([1.0] + [0.0] * 9, level)
    near = scipy.stats.binom.sf(least - 1, needed + np.array([-8, 8]), 0.1)
    assert near[0] < 0.8 < near[1]


def test_power_is_the_share_of_samples_that_the_test_rejects():
    effects = np.array([1.0, 1.0, 0.5, -1.0, 1 / 3, 0.0, 0.0, 0.25, -0.5, 1.0])
    rng = np.random.default_rng(8)
    samples = [rng.choice(effects, 16) for _ in range(800)]
    rejected = np.mean([sign_flip(x) <= 0.05 and x.sum() > 0.0 for x in samples])
    assert power(effects, 16, 0.05) == pytest.approx(rejected, abs=4 * np.sqrt(2 * 0.25 / 800))
    assert (
        np.isnan(proteins_needed([1.0, -1.0], 0.05))
        and proteins_needed([1.0] * 49 + [-1.0] * 48, 0.05) == np.inf
    )
    with pytest.raises(ValueError, match="multiples"):
        power([0.1234567, 0.3], 10, 0.05)


# --- The searches


def test_searches_are_added_and_not_repeated(tmp_path, monkeypatch):
    monkeypatch.setattr(kcm_cases, "PEPTIDES", {"gag": "GAG", "aya": "AYA"})
    monkeypatch.setattr(lowest, "EVALUATIONS", (150, 300))
    list(lowest.run(tmp_path))
    rows = lowest.stored(tmp_path / "lowest.csv")
    assert list(rows["protein"]) == ["gag", "aya"] * 2 and list(rows["max_evaluations"]) == [
        150,
        150,
        300,
        300,
    ]
    # A search is at or below the minimum next to its start.
    for row, case in zip(rows.to_dict("records"), lowest.peptides() * 2, strict=True):
        start = kcm_cases.started(case)
        assert row["protein"] == case.protein
        assert row["energy_kj_mol"] < kcm_cases.polish(start, start.chain.q0).end.energy + 1e-6
    path = tmp_path / "lowest.csv"
    path.write_text("".join(path.read_text().splitlines(keepends=True)[:-1]))
    assert len(list(lowest.run(tmp_path))) == 1
    again = lowest.stored(path)
    same = [name for name in rows if name != "seconds"]
    pd.testing.assert_frame_equal(again[same], rows[same])
