"""The study of KCM against dynamics: what a run records, what is resumed, what counts, what may be said."""

import dataclasses
import re

import mdtraj
import numpy as np
import pandas as pd
import pytest
from fixtures.samples import ROOT

import protochain as pc
from bench.__main__ import main
from bench.studies import kcm, kcm_cases, kcm_plots, kcm_summary
from bench.studies.kcm_cases import LEFT, METHODS, TRIALS, Case, measured
from protochain.structure.superpose import rmsd_angstrom

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


def test_what_moves_masses_has_a_free_root_unless_it_is_the_contrast():
    """The root alone changes where masses move, and nothing where torques do."""
    case = Case("rgds", "RGDS", False, "phi psi chi", "obc2", "extended", 0)
    rows = {name: measured(case, name, 4000) for name in ("kcm-metric", "kcm-metric-fixed", "kcm-0.005")}
    assert {name: row["root"] for name, row in rows.items()} == {
        "kcm-metric": "free", "kcm-metric-fixed": "fixed", "kcm-0.005": "auto",
    }  # fmt: skip
    assert rows["kcm-metric-fixed"]["energy_kj_mol"] - rows["kcm-metric"]["energy_kj_mol"] > 5.0
    s = pc.from_sequence("RGDS")
    e = pc.energy(s, threads=1)
    ends = {
        (method, root): pc.minimise(pc.build_chain(s, root=root), e, method, tolerance=0.1, curvature=False)
        for method in ("kcm-metric", "kcm-stiffness") for root in ("auto", "free", "fixed")
    }  # fmt: skip
    moved = {key: solution.end.energy for key, solution in ends.items()}
    assert moved["kcm-metric", "auto"] == moved["kcm-metric", "free"] < moved["kcm-metric", "fixed"] - 5.0
    assert ends["kcm-metric", "auto"].record()["root"] == "free"
    assert ends["kcm-stiffness", "auto"].chain.root == "auto"
    assert moved["kcm-stiffness", "auto"] == moved["kcm-stiffness", "fixed"]


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


@pytest.mark.parametrize("sequence", ["FDG", "AYE"])
def test_torsions_are_those_of_mdtraj_and_know_groups_that_half_a_turn_exchanges(sequence):
    s = pc.from_sequence(sequence)
    chain = pc.build_chain(s)
    r = pc.minimise(chain, pc.energy(s, solvent="vacuum", threads=1), "lbfgs", max_evaluations=3)
    found = kcm_cases.torsions(r)
    t = pc.to_mdtraj(r)
    atoms = np.array([hinge.atoms for hinge in chain.hinges])
    true = np.rad2deg(mdtraj.compute_dihedrals(t, atoms, periodic=False)[0])
    halves = {("PHE", "chi2"), ("TYR", "chi2"), ("ASP", "chi2"), ("GLU", "chi3")}
    last = s.residue_number[-1]
    twice = [
        (h.residue_name, h.kind) in halves or (h.kind == "psi" and h.residue_number == last)
        for h in chain.hinges
    ]
    apart = found - np.where(twice, 2.0, 1.0) * true
    assert np.abs((apart + 180.0) % 360.0 - 180.0).max() < 0.01 and sum(twice) == 3


@pytest.mark.parametrize("method", ["kcm-adaptive", "md-1"])
def test_legs_are_one_run(method):
    """A run in legs visits the points of a run without them."""
    start = kcm_cases._started(CASE).of(TRIALS[method].recipe)

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


def test_a_run_that_is_still_on_its_way_is_not_finished():
    row = measured(CASE, "md-100", 50)
    assert row["status"] == "budget" and not row["finished"] and row["left_kj_mol"] > LEFT
    short, long = (measured(CASE, "md-10", n) for n in (100, 8000))
    assert not short["finished"] and long["finished"] and long["evaluations"] < 8000


def test_a_chain_at_speed_has_its_kinetic_energy_left():
    start = kcm_cases._started(CASE).of(TRIALS["md-1"].recipe)
    ((ending, _),) = kcm_cases.legs(start, start.chain.q0, TRIALS["md-1"], 100, lambda at, n: None)
    state = ending.last.state
    kinetic = kcm_cases._kinetic(start.chain, state)
    mass = pc.mass_matrix(start.chain, pc.pose(start.chain, state.at.q))
    assert kinetic == pytest.approx(0.5 * state.velocity @ mass @ state.velocity, rel=1e-10) and kinetic > 0
    assert kinetic + state.at.energy < start.judgement.energy


def test_a_fixed_angle_that_circles_is_given_up_and_not_finished():
    wide = dataclasses.replace(TRIALS["kcm-0.005"], recipe=pc.kcm(0.3))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(kcm_cases, "TRIALS", {**TRIALS, "wide": wide})
        row = measured(CASE, "wide", 50_000)
    assert row["status"] == "circling" and not row["finished"] and row["evaluations"] < 50_000


def test_the_energy_of_the_papers_has_no_dihedral_terms():
    of = {name: dataclasses.replace(CASE, energy=name) for name in ("vacuum", "nonbonded")}
    parts = {name: kcm_cases._started(case) for name, case in of.items()}
    x = parts["vacuum"].chain.structure.positions
    whole, less = (parts[name].energy.parts(x)[0] for name in of)
    assert less["torsions"] == less["impropers"] == 0.0 != whole["torsions"]
    assert less["nonbonded"] == whole["nonbonded"]
    assert measured(of["nonbonded"], "openmm", 10)["status"].startswith("refused")


def test_all_methods_have_one_start_which_depends_on_the_seed_alone():
    rows = [measured(CASE, method, 3) for method in ("kcm-sign", "md-1", "lbfgs")]
    first = rows[0]["energy_start_kj_mol"]
    assert [row["energy_start_kj_mol"] for row in rows] == pytest.approx([first] * 3, rel=1e-12)
    other = measured(dataclasses.replace(CASE, seed=2), "lbfgs", 3)
    assert other["energy_start_kj_mol"] != rows[0]["energy_start_kj_mol"]


def test_a_file_starts_deposited_and_if_small_perturbed_and_extended():
    path = ROOT / "structures" / "5awl.pdb"
    chosen = kcm_cases.proteins((path,))[-1:]
    found = [case for case, _ in kcm_cases.cases(chosen, ("phi psi",), ("vacuum",), 2)]
    assert [(case.start, case.seed) for case in found] == [
        ("deposited", 0), ("extended", 0), ("perturbed", 1), ("perturbed", 2), ("extended", 1),
        ("extended", 2),
    ]  # fmt: skip
    native = kcm_cases._native(found[0])
    deposited, extended, perturbed = (kcm_cases._started(case).chain.structure for case in found[:3])
    apart = [
        rmsd_angstrom(each.positions[each.alpha_carbons], native) for each in (deposited, perturbed, extended)
    ]
    assert apart[0] < 0.01 and 0.05 < apart[1] < 5.0 < apart[2]
    assert extended.n_residues == 10


def test_first_starts_come_first_and_what_would_not_end_is_left_out():
    chosen = kcm_cases.proteins(tuple(ROOT / "structures" / name for name in ("5awl.pdb", "1ubq.pdb")))
    found = kcm_cases.cases(chosen, kcm_cases.MODELS, tuple(kcm_cases.ENERGIES), 2)
    first = [place for place, (case, _) in enumerate(found) if not case.seed and case.model == "phi psi chi"]
    again = [place for place, (case, _) in enumerate(found) if case.seed and case.start == "extended"]
    assert max(first) < min(again)
    methods = {(case.protein, case.energy): set(given) for case, given in found}
    assert methods["rgds", "obc2"] == set(METHODS)
    assert {name for name in METHODS if name not in methods["5awl", "obc2"]} == {
        *(f"md-{f}{end}" for f in ("0.1", "100") for end in ("", "-half", "-nudged"))
    }
    assert {"kcm-metric-fixed", "md-10-half"} < methods["1ubq", "obc2"] < methods["5awl", "obc2"]
    assert "kcm-0.005" not in methods["1ubq", "obc2"] and "md-1" not in methods["1ubq", "obc2"]
    assert "md-1" in methods["rgds", "nonbonded"] and ("5awl", "nonbonded") not in methods


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


def test_tables_of_runs_are_inputs(small, tmp_path):
    """What follows from runs is made anew of them alone, wherever they lie, and they stay as they are."""
    list(kcm.run(tmp_path / "first", **small))
    tables = [tmp_path / "first" / name for name in ("runs.csv", "traces.csv")]
    before = [table.read_bytes() for table in tables]
    list(kcm.run(tmp_path / "second", tables, minutes=0.0, **small))
    for name in ("contrasts.csv", "cost.csv", "traces.csv", "runs.csv", "summary.md"):
        assert (tmp_path / "second" / name).read_bytes() == (tmp_path / "first" / name).read_bytes()
    assert [table.read_bytes() for table in tables] == before


def test_a_refused_run_is_recorded_and_left_out(small, tmp_path, monkeypatch):
    def refused(start, run):
        raise pc.ProtochainError("no")

    monkeypatch.setattr(kcm_cases, "minimise_from", refused)
    assert measured(CASE, "lbfgs", 3)["status"] == "refused: no"
    shown = list(kcm.run(tmp_path, **small))
    assert len(shown) == 12 and len(kcm.stored(tmp_path / "runs.csv")) == 12


def test_no_run_starts_after_its_minutes(small, tmp_path):
    assert list(kcm.run(tmp_path, minutes=0.0, **small)) == [] and not (tmp_path / "runs.csv").exists()
    tasks = list(kcm.planned((), **small))
    assert list(kcm._rows(tasks, 1, -np.inf)) == []


@pytest.mark.slow
def test_processes_find_what_one_does(small):
    tasks = list(kcm.planned((), **small))[: 2 * len(FEW)]

    def plain(rows):
        kept = [{name: value for name, value in row.items() if name != "seconds"} for row in rows]
        return sorted(map(str, kept))

    assert plain(kcm._rows(tasks, 2, np.inf)) == plain(kcm._rows(tasks, 1, np.inf))


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
    assert {case.protein for case, _, _ in tasks} == {"met-enkephalin", "rgds"}
    assert len(tasks) == 2 * len(METHODS) and {most for _, _, most in tasks} == {kcm.QUICK["evaluations"]}


def test_the_command_passes_options_to_the_study_that_has_them(tmp_path, capsys, monkeypatch):
    given = {}

    def run(output, inputs, *, quick=False, minutes=60.0, jobs=1):
        given.update(quick=quick, minutes=minutes, jobs=jobs)
        return iter([])

    monkeypatch.setattr(kcm, "run", run)
    assert main(["kcm", "--quick", "--jobs", "2", "-o", str(tmp_path)]) == 0
    assert given == {"quick": True, "minutes": 60.0, "jobs": 2}
    assert main(["stability", "--minutes", "3", "-o", str(tmp_path)]) == 2
    assert "minutes" in capsys.readouterr().err


# --- The summary, of runs made up


def made_up(places, unfinished=(), energies=None):
    """Runs of methods whose minima are told by numbers, a protein a row: equal numbers are one minimum."""
    shapes = np.random.default_rng(0).uniform(-180.0, 180.0, size=(10, 8))
    rows = []
    for k, ends in enumerate(places):
        for m, (method, place) in enumerate(ends.items()):
            energy = -10.0 * place if energies is None else energies[method]
            row = dict.fromkeys(kcm_cases.COLUMNS, 0.0)
            row |= {
                "protein": f"p{k}", "model": "phi psi chi", "energy": "obc2", "start": "extended", "seed": 0,
                "method": method, "max_evaluations": 9, "status": "finished", "evaluations": 9,
                "seconds": 0.9, "finished": (k, method) not in unfinished, "energy_kj_mol": energy,
                "torsions_deg": " ".join(f"{each:.1f}" for each in shapes[place] + 360.0 * (m % 2)),
            }  # fmt: skip
            rows.append(row | {f"energy_at_{n}": energy for n in kcm_cases.AT})
    return pd.DataFrame(rows, columns=list(kcm_cases.COLUMNS))


def ends(kcm_end, metric, dynamics, control=None):
    """Ends of all methods of the question; those of controls are the same, or as given."""
    found = {
        "kcm-0.005": kcm_end, "kcm-adaptive": kcm_end, "kcm-metric": metric, "md-1": dynamics,
        "md-10": dynamics, "md-100": metric,
    }  # fmt: skip
    kinds = kcm_cases.CONTROLS.values()
    return found | {
        f"{name}-{kind}": place if control is None else control
        for name, place in found.items() for kind in kinds
    }  # fmt: skip


def table_of(runs):
    return kcm_summary.contrasts(kcm_summary.compared(runs))


def contrasts_of(runs):
    table = table_of(runs)
    return table[table["scope"] == "OBC2"].set_index("what")


def test_a_contrast_counts_finished_pairs_alone():
    """However an unfinished run ends, the contrasts are the same, but for what was left out."""
    whole = [ends(1, 2, 2)] * 3 + [ends(1, 1, 1)] * 2
    unfinished = {(0, "md-10"), (3, "kcm-metric"), (4, "md-1")}
    others = [{"md-10": 5}, {}, {}, {"kcm-metric": 6}, {"md-1": 7}]
    tables = [
        table_of(made_up(places, unfinished))
        for places in (whole, [each | other for each, other in zip(whole, others, strict=True)])
    ]
    for column in tables[0]:
        pd.testing.assert_series_equal(tables[0][column], tables[1][column], check_dtype=False)
    own = contrasts_of(made_up(whole, unfinished))
    of = own.loc["inertia, friction 10"]
    assert (of["starts"], of["pairs"], of["left_out"], of["proteins"]) == (5, 3, 2, 3) and of["same"] == 1.0
    assert own.loc["KCM and dynamics, friction 10", "same"] == 0.5


def test_only_what_exceeds_the_controls_is_an_effect():
    """With controls that never agree, ends that never agree show nothing."""
    random = contrasts_of(made_up([ends(1, 2, 3, control=4)] * 6)).loc["metric of masses"]
    assert (random["same"], random["baseline"], random["effect"]) == (0.0, 0.0, 0.0)
    assert random["effect_low"] < 0.0 < random["effect_high"]
    clear = contrasts_of(made_up([ends(1, 2, 3)] * 6)).loc["metric of masses"]
    assert (clear["same"], clear["baseline"], clear["effect"]) == (0.0, 1.0, 1.0) and clear[
        "effect_low"
    ] > 0.0


def test_of_the_controls_the_worst_counts():
    """Controls that agree do not hide one that does not."""
    others = [ends(1, 2, 3) | {"kcm-metric-half": 4 + k % 2 * -2} for k in range(6)]
    row = contrasts_of(made_up(others)).loc["metric of masses"]
    assert (row["control"], row["baseline"], row["effect"]) == ("half the step of kcm-metric", 0.5, 0.5)
    assert (row["same_pairs"], row["pairs"]) == (0, 6)


def test_energies_and_sizes_are_not_pooled():
    runs = made_up([ends(1, 2, 3)] * 3 + [ends(1, 1, 1)] * 3)
    runs.loc[runs["protein"].isin(["p3", "p4", "p5"]), "energy"] = "vacuum"
    table = table_of(runs).set_index(["scope", "what"])
    assert (
        table["same"]["OBC2", "metric of masses"] == 0.0
        and table["same"]["vacuum", "metric of masses"] == 1.0
    )
    runs.loc[runs["protein"] == "p0", "residues"] = 30
    assert table_of(runs).set_index(["scope", "what"])["pairs"]["OBC2", "metric of masses"] == 2


def test_one_minimum_needs_both_the_place_and_the_energy():
    def same(places, energies):
        return kcm_summary.compared(made_up([places], energies=energies))["same"].item()

    one = {"kcm-adaptive": 1, "kcm-metric": 1}
    assert not same(one, {"kcm-adaptive": 0.0, "kcm-metric": 0.5})
    assert same(one, {"kcm-adaptive": 0.0, "kcm-metric": 0.09})
    assert not same(one | {"kcm-metric": 2}, {"kcm-adaptive": 0.0, "kcm-metric": 0.0})


def test_intervals_resample_proteins_and_not_their_starts():
    runs = made_up([ends(1, 2, 2)] * 3 + [ends(1, 1, 1)] * 3)
    more = pd.concat([runs, runs.assign(seed=2), runs.assign(seed=1)])
    once, often = (contrasts_of(each).loc["metric of masses"] for each in (runs, more))
    assert often["pairs"] == 3 * once["pairs"] and often["proteins"] == once["proteins"] == 6
    for name in ("same", "same_low", "same_high", "effect", "effect_low", "effect_high", "proteins_needed"):
        assert once[name] == often[name]
    # Of shares of 1 and 0 in equal numbers the standard deviation is known.
    assert once["proteins_needed"] == np.ceil((1.96 * np.sqrt(0.3) / 0.5) ** 2)


@pytest.mark.parametrize(
    ("places", "metric", "inertia", "more"),
    [
        ([(1, 2, 2)] * 8, "an effect", "open", "the metric does more"),
        ([(1, 1, 2)] * 8, "open", "an effect", "inertia does more"),
        ([(1, 2, 2), (1, 1, 2)] * 4, "an effect", "an effect", "open"),
    ],
)
def test_words_say_what_the_rows_carry(places, metric, inertia, more):
    runs = made_up([ends(*each) for each in places])
    table = table_of(runs)
    rows = contrasts_of(runs)
    for what, verdict in (("metric of masses", metric), ("inertia, friction 1", inertia)):
        assert f", {verdict}" in kcm_summary.sentence_of({"what": what, **rows.loc[what]})
    last = "metric less inertia, friction 1"
    assert more in kcm_summary.sentence_of({"what": last, **rows.loc[last]})
    said = list(kcm_summary.words(runs, table))
    assert "these 8 proteins" in said[0]
    assert_said(said[1:], table)


def assert_said(sentences, contrasts):
    """Assert that every number of a sentence is one of its row."""
    rows = contrasts[contrasts["scope"].isin(list(kcm_summary.SCOPES)[:2])].to_dict("records")
    worded = [(row, sentence) for row in rows if (sentence := kcm_summary.sentence_of(row))]
    assert [sentence for _, sentence in worded] == list(sentences)
    for row, sentence in worded:
        known = {
            f"{row[name]:.0f}" for name in ("starts", "pairs", "left_out", "same_pairs", "proteins_needed")
        }
        known |= {f"{100 * row['same_pairs'] / row['pairs']:.0f}"} if row["pairs"] else set()
        names = [f"{name}{end}" for name in ("same", "baseline", "effect") for end in ("", "_low", "_high")]
        known |= {f"{100 * row[name]:.0f}" for name in names if pd.notna(row[name])}
        said = re.sub(r"`[^`]*`|\([^)]*friction[^)]*\)|friction of [\d.]*|[a-z]+-[\d.]+", "", sentence)
        said = said.replace(row["scope"], "")
        assert set(re.findall(r"-?\d[\d.]*\d|-?\d", said)) <= known, sentence


def test_few_proteins_carry_no_answer():
    runs = made_up([ends(1, 2, 2)] * (kcm_summary.FEW - 1))
    said = list(kcm_summary.words(runs, table_of(runs)))
    assert said[1:] and all("too few proteins" in sentence for sentence in said[1:])


def test_minima_lie_so_far_from_deposited_structures():
    runs = made_up([{"kcm-0.005": 1, "openmm": 2}] * 3)
    assert kcm_summary.deposited(runs).empty
    runs["start"] = ["deposited"] * 4 + ["extended"] * 2
    runs["rmsd_start_angstrom"] = [1.0, 0.5, 3.0, 0.7, 9.0, 9.0]
    table = kcm_summary.deposited(runs).set_index("method")
    assert table["starts"].tolist() == [2, 2]
    assert table["median_angstrom"].tolist() == pytest.approx([2.0, 0.6])


def test_equal_cost_counts_only_starts_that_all_methods_ran_from():
    runs = made_up([{"kcm-0.005": 1, "lbfgs": 2}] * 3 + [{"kcm-0.005": 1}])
    runs["energy_at_5"] = 0.0
    table = kcm_summary.cost(runs).set_index("method")
    assert table["starts"].tolist() == [3, 3]
    assert table["at_100"].tolist() == table["minimum_kj_mol"].tolist() == [10.0, 0.0]
    # Nine evaluations took 0.9 s: in 0.1 s it had made one, in 1 s all.
    assert table["at_100_ms"].tolist() == [10.0, 0.0] and table["at_1000_ms"].tolist() == [20.0, 20.0]


def test_the_figure_is_drawn_without_traces():
    assert len(kcm_plots.plot(kcm_summary.tables(made_up([ends(1, 2, 2)] * 4)), None).axes) == 3


def test_the_tables_of_the_pages_are_those_of_the_runs():
    """Contrasts of the results are recomputed from the runs, and their words said again."""
    runs = kcm.stored(RESULTS / "kcm_runs.csv")
    stored = pd.read_csv(RESULTS / "kcm_contrasts.csv")
    made = table_of(runs[runs["energy_kj_mol"].notna()])
    pd.testing.assert_frame_equal(made.reset_index(drop=True), stored, check_dtype=False, rtol=1e-9)
    assert_said(list(kcm_summary.words(runs, stored))[1:], stored)


def test_percentages_of_the_page_are_those_of_other_code():
    """Raw and by protein, from the columns of the runs alone."""
    runs = pd.read_csv(RESULTS / "kcm_runs.csv", converters={"protein": str})
    runs = runs[
        (runs["energy"] == "obc2") & (runs["model"] == "phi psi chi") & (runs["residues"] <= kcm_cases.SMALL)
    ]
    stored = pd.read_csv(RESULTS / "kcm_contrasts.csv")
    stored = stored[stored["scope"] == "OBC2"].set_index("what")
    keys = ["protein", "start", "seed"]
    by = {method: own.set_index(keys) for method, own in runs.groupby("method")}
    contrasts = {
        "KCM and dynamics, friction 1": ("kcm-0.005", "md-1"),
        "metric of masses": ("kcm-adaptive", "kcm-metric"),
        "inertia, friction 10": ("kcm-metric", "md-10"),
        "root, without inertia": ("kcm-metric", "kcm-metric-fixed"),
        "half the step of md-1": ("md-1", "md-1-half"),
    }  # fmt: skip
    for what, (a, b) in contrasts.items():
        pairs = by[a].merge(by[b], left_index=True, right_index=True, suffixes=("_a", "_b"))
        pairs = pairs[pairs["finished_a"].astype(bool) & pairs["finished_b"].astype(bool)]
        same = pd.Series(index=pairs.index, dtype=float)
        for place, row in pairs.iterrows():
            x, y = (np.array(row[f"torsions_deg_{end}"].split(), dtype=float) for end in "ab")
            apart = np.rad2deg(np.abs(np.angle(np.exp(1j * np.deg2rad(x - y))))).max()
            rise = row["energy_kj_mol_b"] - row["energy_kj_mol_a"]
            same[place] = float(apart < 10.0 and abs(rise) < 0.1)
        assert (len(same), same.sum()) == (stored["pairs"][what], stored["same_pairs"][what])
        assert same.groupby("protein").mean().mean() == pytest.approx(stored["same"][what], abs=1e-12)
