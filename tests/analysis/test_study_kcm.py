"""The study of KCM against dynamics: what a run records, what is resumed, and what the summary may say."""

import dataclasses
import time

import numpy as np
import pandas as pd
import pytest
from fixtures.samples import ROOT
from scipy.stats import binomtest

import protochain as pc
from protochain.analysis.studies import kcm, kcm_cases, kcm_summary
from protochain.analysis.studies.kcm_cases import METHODS, Case, measured
from protochain.cli import app
from protochain.structure.superpose import rmsd_angstrom

CASE = Case("gag", "GAG", False, "phi psi", "vacuum", "extended", 1)
FEW = ("kcm-0.01", "kcm-metric", "lbfgs")


@pytest.fixture
def small(monkeypatch):
    """Two peptides, one start beside the unperturbed one, three methods."""
    monkeypatch.setattr(kcm_cases, "PEPTIDES", {"gag": "GAG", "aya": "AYA"})
    monkeypatch.setattr(kcm, "METHODS", {name: METHODS[name] for name in FEW})
    return {"starts": 1, "evaluations": 60}


def test_the_methods_are_those_of_the_question_and_none_parts_overlaps():
    assert [name for name in METHODS if name.startswith("kcm-0")] == [
        "kcm-0.0005", "kcm-0.005", "kcm-0.01", "kcm-0.05"
    ]  # fmt: skip
    assert {f"kcm-{name}" for name in ("proportional", "sign", "adaptive", "metric", "stiffness")} < set(
        METHODS
    )
    assert {"md-1", "md-10", "md-100", "md-cooled", "lbfgs", "openmm"} < set(METHODS)
    assert not any(recipe.parts_overlaps for recipe in METHODS.values())
    assert [METHODS[f"md-{f}"].runs[0].method.friction for f in (1, 10, 100)] == [1, 10, 100]
    cooled = METHODS["md-cooled"].runs
    assert [each.method.temperature for each in cooled] == [300.0, 0.0] and METHODS["md-cooled"].draws_random
    assert set().union(*kcm_summary.PAIRS.values()) < set(METHODS)


@pytest.mark.parametrize("method", ["kcm-0.01", "md-10", "openmm"])
def test_a_run_records_its_end_raw_and_polished(method):
    row = measured(CASE, method, 40)
    assert set(row) == set(kcm_cases.COLUMNS)
    assert row["evaluations"] <= 40 and row["energy_kj_mol"] < row["energy_start_kj_mol"]
    assert row["polished_energy_kj_mol"] <= row["energy_kj_mol"] + 1e-9
    assert row["polish_status"] == "converged" and row["polished_torque_max_kj_mol_rad"] <= kcm_cases.POLISH
    assert row["lowest_eigenvalue_kj_mol_rad2"] > 0
    # The largest by the judge, the RMS by the engine: of torques in one frame they bound each other.
    size = row["torque_max_kj_mol_rad"] / row["torque_rms_kj_mol_rad"]
    assert 1.0 - 1e-3 <= size <= np.sqrt(row["hinges"] + 6)
    lowest = [row[f"energy_at_{n}"] for n in kcm_cases.AT]
    assert (np.diff(lowest) <= 0).all()
    if method != "openmm":
        assert lowest[0] == pytest.approx(row["energy_start_kj_mol"], abs=1e-6)
        assert lowest[-1] == pytest.approx(row["energy_kj_mol"], abs=1e-6)
    start = kcm_cases._started(CASE).chain.structure
    alphas = np.array(row["alphas_pm"].split(), dtype=float).reshape(-1, 3) / 1000.0
    reference = start.positions[start.alpha_carbons]
    assert rmsd_angstrom(alphas, reference) == pytest.approx(row["rmsd_start_angstrom"], abs=0.02)


def test_all_methods_have_one_start_which_depends_on_the_seed_alone():
    rows = [measured(CASE, method, 3) for method in ("kcm-sign", "md-1", "lbfgs")]
    assert len({row["energy_start_kj_mol"] for row in rows}) == 1
    other = measured(dataclasses.replace(CASE, seed=2), "lbfgs", 3)
    assert other["energy_start_kj_mol"] != rows[0]["energy_start_kj_mol"]


def test_a_file_starts_deposited_perturbed_and_if_small_extended():
    path = ROOT / "structures" / "1l2y.pdb"
    chosen = kcm_cases.proteins((path,))[-1:]
    found = kcm_cases.cases(chosen, ("phi psi",), ("vacuum",), 3)
    assert [(case.start, case.seed) for case in found] == [
        ("deposited", 0), ("extended", 0), ("perturbed", 1), ("extended", 1), ("perturbed", 2),
        ("extended", 2), ("perturbed", 3), ("extended", 3),
    ]  # fmt: skip
    native = kcm_cases._native(found[0])
    deposited, extended, perturbed = (kcm_cases._started(case).chain.structure for case in found[:3])
    apart = [
        rmsd_angstrom(each.positions[each.alpha_carbons], native) for each in (deposited, perturbed, extended)
    ]
    assert apart[0] < 0.01 and 0.05 < apart[1] < 5.0 < apart[2]
    assert extended.n_residues == 20


def test_large_proteins_begin_before_small_ones_are_done():
    chosen = kcm_cases.proteins((ROOT / "structures" / "1vii.pdb",))
    found = kcm_cases.cases(chosen, ("phi psi",), ("vacuum",), 20)
    order = [case.protein for case in found]
    assert order[0] == "met-enkephalin" and order[-1] == "1vii"
    assert order.index("1vii") < len(order) - order[::-1].index("met-enkephalin")


def test_it_goes_on_where_it_stopped(small, tmp_path, monkeypatch):
    path = tmp_path / "runs.csv"
    tasks = list(kcm.planned((), starts=1, evaluations=60))
    assert len(tasks) == 2 * 2 * 2 * 2 * len(FEW)
    # Only some of the models, for the time it takes.
    monkeypatch.setattr(kcm, "MODELS", ("phi psi",))
    monkeypatch.setattr(kcm, "SOLVENTS", ("vacuum",))
    tables = list(kcm.run(tmp_path, **small))
    runs = kcm.stored(path)
    assert len(runs) == 2 * 2 * len(FEW) and "12 of 12 runs planned" in tables[-1]["summary"][0]
    written = {"shares.csv": (tmp_path / "shares.csv").read_bytes()}

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
    assert len(ran) == 1 and (tmp_path / "shares.csv").read_bytes() == written["shares.csv"]

    # What is there counts as what it is: other settings are other runs.
    *_, said = kcm.run(tmp_path, minutes=0.0, starts=1, evaluations=61)
    assert "0 of 12 runs planned, and 12 others" in said["summary"][0] and len(ran) == 1


def test_a_refused_run_is_recorded_and_left_out(small, tmp_path, monkeypatch):
    monkeypatch.setattr(kcm, "MODELS", ("phi psi",))
    monkeypatch.setattr(kcm, "SOLVENTS", ("vacuum",))

    def refused(start, run):
        raise pc.ProtochainError("no")

    monkeypatch.setattr(kcm_cases, "minimise_from", refused)
    assert measured(CASE, "lbfgs", 3)["status"] == "refused: no"
    shown = list(kcm.run(tmp_path, **small))
    assert len(shown) == 12 and len(kcm.stored(tmp_path / "runs.csv")) == 12


def test_no_run_starts_after_its_minutes(small, tmp_path):
    assert list(kcm.run(tmp_path, minutes=0.0, **small)) == [] and not (tmp_path / "runs.csv").exists()
    tasks = list(kcm.planned((), **small))
    assert list(kcm._rows(tasks, 1, time.monotonic() - 1)) == []


@pytest.mark.slow
def test_processes_find_what_one_does(small):
    tasks = list(kcm.planned((), **small))[: 2 * len(FEW)]
    until = time.monotonic() + 600

    def plain(rows):
        kept = [{name: value for name, value in row.items() if name != "seconds"} for row in rows]
        return sorted(map(str, kept))

    assert plain(kcm._rows(tasks, 2, until)) == plain(kcm._rows(tasks, 1, until))


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        ({"minutes": -1.0}, "minutes -1"),
        ({"minutes": np.nan}, "minutes nan"),
        ({"jobs": 0}, "jobs 0: give at least 1"),
        ({"starts": -1}, "starts -1"),
        ({"evaluations": 0}, "evaluations 0"),
    ],
)
def test_settings_that_make_no_sense_are_refused(tmp_path, settings, text):
    with pytest.raises(pc.ProtochainError, match=text):
        next(kcm.run(tmp_path, **settings))


def test_another_table_is_refused(tmp_path):
    (tmp_path / "runs.csv").write_text("a,b\n1,2\n")
    with pytest.raises(pc.ProtochainError, match=r"runs\.csv: is no table of this study"):
        next(kcm.run(tmp_path, minutes=0.0))
    with pytest.raises(pc.ProtochainError, match="1l2y: two proteins of this name"):
        next(kcm.planned([ROOT / "structures" / "1l2y.pdb"] * 2))


def test_a_name_that_looks_like_a_number_is_a_name(tmp_path):
    row = dict.fromkeys(kcm_cases.COLUMNS, 0.0) | {"protein": "1e10", "seed": 3, "max_evaluations": 60}
    kcm.append(tmp_path / "runs.csv", row)
    assert kcm._keys(kcm.stored(tmp_path / "runs.csv")) == {("1e10", 0.0, 0.0, 0.0, 3, 0.0, 60)}


def test_quick_is_two_peptides(tmp_path):
    tasks = list(kcm.planned((), quick=True))
    assert {case.protein for case, _, _ in tasks} == {"met-enkephalin", "ala10"}
    assert len(tasks) == 2 * 2 * len(METHODS) and {most for _, _, most in tasks} == {1500}


def test_the_command_passes_options_to_the_study_that_has_them(tmp_path, capsys, monkeypatch):
    given = {}

    def run(output, inputs, *, quick=False, minutes=60.0, jobs=1):
        given.update(quick=quick, minutes=minutes, jobs=jobs)
        return iter([])

    monkeypatch.setattr(kcm, "run", run)
    assert app(["bench", "kcm", "--quick", "--jobs", "2", "-o", str(tmp_path)], standalone_mode=False) == 0
    assert given == {"quick": True, "minutes": 60.0, "jobs": 2}
    with pytest.raises(pc.ProtochainError, match="minutes: study 'stability' has no such option"):
        app(["bench", "stability", "--minutes", "3", "-o", str(tmp_path)], standalone_mode=False)


# --- The summary, of runs made up


def made_up(places, energies=None, left=0.0):
    """Runs of methods whose ends are told by numbers, from each start: equal numbers are one minimum."""
    random = np.random.default_rng(0)
    shapes = random.normal(scale=0.3, size=(10, 8, 3))
    turns = np.linalg.qr(random.normal(size=(40, 3, 3)))[0]
    turns *= np.linalg.det(turns)[:, None, None]
    rows = []
    for seed, ends in enumerate(places):
        for k, (method, place) in enumerate(ends.items()):
            x = shapes[place] @ turns[(seed + 7 * k) % 40] + k
            energy = -10.0 * place if energies is None else energies[method]
            row = dict.fromkeys(kcm_cases.COLUMNS, 0.0)
            row |= {
                "protein": "a", "model": "phi psi", "solvent": "obc2", "start": "extended", "seed": seed,
                "method": method, "max_evaluations": 9, "status": "converged", "evaluations": 9,
                "energy_kj_mol": energy + left, "polished_energy_kj_mol": energy,
                "alphas_pm": " ".join(map(str, np.rint(1000 * x).astype(int).ravel())),
            }  # fmt: skip
            row |= {"polished_alphas_pm": row["alphas_pm"]} | {f"energy_at_{n}": energy for n in kcm_cases.AT}
            rows.append(row)
    return pd.DataFrame(rows, columns=list(kcm_cases.COLUMNS))


def ends(kcm_end, metric, dynamics):
    """Ends of all methods that the answer needs."""
    return {
        "kcm-0.005": kcm_end, "kcm-0.01": kcm_end, "kcm-adaptive": kcm_end, "kcm-metric": metric,
        "md-1": dynamics, "md-10": dynamics, "md-100": metric,
    }  # fmt: skip


def contrasts_of(runs):
    table = kcm_summary.contrasts(kcm_summary.compared(runs))
    return table[table["start"] == "all"].set_index("what"), next(iter(kcm_summary.answers(table)))


def test_shares_count_starts_that_end_in_one_minimum_however_turned():
    runs = made_up([{"kcm-0.01": 1, "md-10": 1, "lbfgs": 2}] * 3 + [{"kcm-0.01": 1, "md-10": 3, "lbfgs": 2}])
    pairs = kcm_summary.compared(runs)
    table = kcm_summary.shares(pairs)
    pooled = table[table["start"] == "all"].set_index(["a", "b"])
    assert pooled["polished_share"].to_dict() == {
        ("kcm-0.01", "md-10"): 0.75, ("kcm-0.01", "lbfgs"): 0.0, ("md-10", "lbfgs"): 0.0,
    }  # fmt: skip
    both = pooled.loc[("kcm-0.01", "md-10")]
    assert both["b_above_a_kj_mol"] == pytest.approx(-5.0) and both["starts"] == 4
    assert 0.0 < both["polished_share_low"] < 0.75 < both["polished_share_high"] == 1.0
    # Where all agree the bootstrap knows no spread: the exact binomial interval.
    none = pooled.loc[("kcm-0.01", "lbfgs")]
    exact = binomtest(0, 4).proportion_ci(0.95, "exact")
    assert (none["polished_share_low"], none["polished_share_high"]) == pytest.approx((0.0, exact.high))


def test_kinds_of_start_are_told_apart():
    near = made_up([ends(1, 1, 1)] * 2).assign(start="deposited")
    far = made_up([ends(1, 2, 3)] * 3).assign(start="extended")
    table = kcm_summary.contrasts(kcm_summary.compared(pd.concat([near, far])))
    found = table[(table["model"] == "all") & (table["what"] == "KCM and dynamics")].set_index("start")
    assert found["starts"].to_dict() == {"all": 5, "deposited": 2, "extended": 3}
    assert found["value"].to_dict() == {"all": 0.4, "deposited": 1.0, "extended": 0.0}


def test_one_minimum_needs_both_the_place_and_the_energy():
    same = {"kcm-0.01": 1, "md-10": 1}
    far = kcm_summary.compared(made_up([same], {"kcm-0.01": 0.0, "md-10": 0.5}))
    assert not far["polished_same"].item() and far["same"].item()
    near = kcm_summary.compared(made_up([same], {"kcm-0.01": 0.0, "md-10": 0.09}))
    assert near["polished_same"].item()
    other = kcm_summary.compared(made_up([{"kcm-0.01": 1, "md-10": 2}], {"kcm-0.01": 0.0, "md-10": 0.0}))
    assert not other["polished_same"].item() and not other["same"].item()


def test_runs_of_one_start_in_several_models_count_as_one():
    runs = made_up([{"kcm-0.01": 1, "md-10": 1 + (k % 2)} for k in range(4)])
    twice = pd.concat([runs, runs.assign(model="phi psi chi")])
    once, both = (
        kcm_summary.shares(kcm_summary.compared(each)).iloc[0][["polished_share_low", "polished_share_high"]]
        for each in (runs, twice)
    )
    assert list(once) == list(both)


@pytest.mark.parametrize(
    ("places", "said"),
    [
        ([(1, 2, 2)] * 8, ("less than half", "more often", "the metric does more")),
        ([(1, 1, 2)] * 8, ("less than half", "more often", "inertia does more")),
        (
            [(1, 1, 1)] * 8,
            ("more than half", "these starts leave it open", "at 1: these starts leave it open"),
        ),
        ([(1, 2, 2), (1, 1, 2)] * 4, ("less than half", "more often", "at 1: these starts leave it open")),
    ],
)
def test_the_answer_says_what_the_numbers_carry(places, said):
    table, answer = contrasts_of(made_up([ends(*each) for each in places]))
    assert table["starts"].iloc[0] == 8
    for words in said:
        assert words in answer, answer
    assert answer.startswith("All together, 8 starts. ")
    share = np.mean([end[0] == end[2] for end in places])
    assert table.loc["KCM and dynamics", "value"] == share and f"from {share:.0%} (" in answer
    metric = np.mean([end[0] == end[1] for end in places]) - np.mean([end[1] == end[2] for end in places])
    assert table.loc["metric, less friction 1", "value"] == pytest.approx(metric)


def test_few_starts_carry_no_answer_and_a_start_short_of_a_method_does_not_count():
    _, answer = contrasts_of(made_up([ends(1, 2, 2)] * 4))
    assert answer == "All together: 4 starts are too few for an answer."
    short = {name: place for name, place in ends(1, 2, 2).items() if name != "md-1"}
    table, _ = contrasts_of(made_up([ends(1, 2, 2)] * 6 + [short]))
    assert set(table["starts"]) == {6}


def test_the_summary_names_methods_that_did_not_arrive():
    (said,) = kcm_summary.unfinished(made_up([{"kcm-0.05": 1, "lbfgs": 1}], left=2.5))
    assert "kcm-0.05 2.5, lbfgs 2.5" in said
    assert not list(kcm_summary.unfinished(made_up([{"kcm-0.05": 1}], left=0.5)))


def test_minima_lie_so_far_from_deposited_structures():
    runs = made_up([{"kcm-0.05": 1, "openmm": 2}] * 3)
    assert kcm_summary.deposited(runs).empty
    runs["start"] = ["deposited"] * 4 + ["extended"] * 2
    runs["polished_rmsd_start_angstrom"] = [1.0, 9.0, 3.0, 9.0, 9.0, 9.0]
    # OpenMM's ends are as they are: the polish is in torsions.
    runs["rmsd_start_angstrom"] = [8.0, 0.5, 8.0, 0.7, 8.0, 8.0]
    table = kcm_summary.deposited(runs).set_index("method")
    assert table["starts"].tolist() == [2, 2]
    assert table["median_angstrom"].tolist() == pytest.approx([2.0, 0.6])
    assert table["largest_angstrom"].tolist() == [3.0, 0.7]


def test_equal_cost_counts_only_starts_that_all_methods_ran_from():
    runs = made_up([{"kcm-0.05": 1, "lbfgs": 2}] * 3 + [{"kcm-0.05": 1}])
    table = kcm_summary.cost(runs).set_index("method")
    assert table["starts"].tolist() == [3, 3]
    assert table["at_100"].tolist() == pytest.approx([10.0, 0.0])
    assert table["polished_above_kj_mol"].tolist() == pytest.approx([10.0, 0.0])
