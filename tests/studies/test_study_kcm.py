"""The study of KCM against dynamics: what a run records, what is resumed, what counts, what may be said."""

import dataclasses

import mdtraj
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


def test_the_tables_of_the_pages_are_those_of_the_runs():
    """Contrasts of the results are recomputed from the runs."""
    runs = kcm.stored(RESULTS / "kcm_runs.csv")
    stored = pd.read_csv(RESULTS / "kcm_contrasts.csv")
    made = table_of(runs[runs["energy_kj_mol"].notna()])
    pd.testing.assert_frame_equal(made.reset_index(drop=True), stored, check_dtype=False, rtol=1e-9)
