"""``search``: the same bits however it is cut into pieces, what it writes, and what it refuses."""

import json
import os
import signal
from concurrent.futures import Future
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from fixtures.refusals import expect_refusal

import protochain as pc
from protochain.batches import cluster
from protochain.chains.restraint_list import Restraints
from protochain.core.storage import temporary_stem
from protochain.searching import csa, search_chain
from protochain.searching.folder import COLOURS, draw_minima
from protochain.searching.hopping import N_ADAPTIVE, metropolis
from protochain.searching.landscape import DescentEnd, Landscape
from protochain.searching.minima import Symmetry
from protochain.searching.search_settings import SearchSettings
from protochain.searching.walker_steps import Finding, PieceEnd, advance, read_piece, write_piece

SMALL = {"n_walkers": 2, "seed": 3}


@pytest.fixture(scope="module")
def peptide():
    structure = pc.from_sequence("AAA")
    return pc.build_chain(structure), pc.energy(structure, solvent="vacuum", threads=1)


@pytest.fixture(scope="module")
def whole(peptide):
    """A search by each method, in one go."""
    return {
        "csa": pc.search(*peptide, "csa", 900, **SMALL),
        "hopping": pc.search(*peptide, "hopping", 1500, **SMALL),
        "tempering": pc.search(*peptide, "tempering", 6000, n_replicas=2, pilot=20, **SMALL),
    }


def same(one, other):
    """Whether two searches found the same bits."""
    return all(
        np.array_equal(a.minima, b.minima) and np.array_equal(a.samples, b.samples)
        for a, b in zip(one.findings, other.findings, strict=True)
    )


def options(method):
    if method == "tempering":
        return 6000, {"n_replicas": 2, "pilot": 20}
    return 900 if method == "csa" else 1500, {}


@pytest.mark.usefixtures("interruptible")
@pytest.mark.parametrize("method", ["csa", "hopping", "tempering"])
def test_a_search_that_is_interrupted_and_resumed_finds_the_same_bits(
    method, peptide, whole, tmp_path, monkeypatch
):
    monkeypatch.setattr(
        search_chain, "SECONDS", 0.0
    )  # a piece a step, so that one is interrupted on any machine
    evaluations, more = options(method)
    calls = []

    def watch(progress):
        calls.append(progress)
        if len(calls) == 3:
            os.kill(os.getpid(), signal.SIGINT)

    first = pc.search(*peptide, method, evaluations, output=tmp_path, watch=watch, **SMALL, **more)
    assert first.interrupted and 0 < first.n_evaluations < whole[method].n_evaluations
    assert calls[-1].evaluations == first.n_evaluations and calls[-1].lowest == first.energy
    then = pc.search(*peptide, method, evaluations, output=tmp_path, resume=True, **SMALL, **more)
    assert not then.interrupted and then.n_evaluations == whole[method].n_evaluations
    assert same(then, whole[method])


@pytest.mark.usefixtures("worker_processes")
def test_a_search_in_processes_that_fail_finds_the_same_bits(peptide, whole, tmp_path, monkeypatch):
    failed, supervise = [], cluster.supervise

    def failing(job, threads, limit):
        if len(failed) < 2:
            failed.append(job.walker)
            return job.lost([], "killed", "the process was ended by SIGKILL", 1.0)
        return supervise(job, threads, limit)

    monkeypatch.setattr(cluster, "supervise", failing)
    found = pc.search(*peptide, "hopping", 1500, output=tmp_path, workers=2, **SMALL)
    assert len(failed) == 2 and same(found, whole["hopping"])
    assert not list(tmp_path.glob(".protochain-*"))


def test_a_process_that_fails_again_and_again_ends_the_search_and_keeps_what_there_is(
    peptide, tmp_path, monkeypatch
):
    monkeypatch.setattr(cluster, "supervise", lambda job, *_: job.lost([], "killed", "memory ran out", 1.0))
    with expect_refusal("resume", match=r"walker [01]: memory"):
        pc.search(*peptide, "hopping", 1500, output=tmp_path, workers=1, **SMALL)


def test_more_evaluations_go_on_where_fewer_ended(peptide, whole, tmp_path):
    pc.search(*peptide, "hopping", 400, output=tmp_path, **SMALL)
    assert same(pc.search(*peptide, "hopping", 1500, output=tmp_path, resume=True, **SMALL), whole["hopping"])


def test_other_seeds_and_walkers_find_other_things(peptide, whole):
    other = pc.search(*peptide, "hopping", 1500, n_walkers=2, seed=4)
    assert not same(other, whole["hopping"])
    one, two = whole["hopping"].findings
    assert not np.array_equal(one.minima[:5], two.minima[:5])


def test_minima_are_minima_with_their_energies(peptide, whole):
    chain, energy = whole["hopping"].chain, peptide[1]
    for found in whole.values():
        assert np.all(np.diff(found.energies) >= 0.0) and found.energy == found.energies[0]
        for q, value in zip(found.q[:3], found.energies[:3], strict=True):
            at = pc.pose(chain, q)
            own, forces = energy(at.x)
            assert own == pytest.approx(value, abs=1e-6)
            assert np.max(np.abs(pc.pull_back(chain, at, forces))) < 0.11
    structure = whole["hopping"].structure(2)
    assert energy(structure.positions)[0] == pytest.approx(whole["hopping"].energies[1], abs=1e-6)


def test_rows_of_minima_name_the_descents_that_found_them(whole):
    for found in whole.values():
        assert found.minima["walker"].nunique() == 2 and found.minima["minimum"].iloc[0] == 1
        for row in found.minima.itertuples():
            descents = found.findings[row.walker].minima
            assert [row.evaluations_of_walker, row.energy_kj_mol] in descents[:, :2].tolist()
        record = found.record()
        assert record["steps"] == sum(state.n_done for state in found.states) < record["evaluations"]
        assert record["evaluations"] == sum(state.n_evaluations for state in found.states)
    # Some hops are accepted, and some are not.
    assert 0.0 < whole["hopping"].record()["acceptance"] < 1.0


@pytest.mark.parametrize("method", ["hopping", "tempering"])
def test_a_restraint_holds_all_minima_and_samples_and_is_in_their_energies(method, peptide, tmp_path):
    line = "dihedral phi@A:2 50 70 4000"
    more = {**SMALL, "n_replicas": 2, "pilot": 3} if method == "tempering" else SMALL
    given = {"restraints": [line], "output": tmp_path / "s", **more}
    found = pc.search(*peptide, method, options(method)[0] // 2, **given)
    held = Restraints.of(found.chain.structure, [line])
    for q, value in zip(found.q[:4], found.energies[:4], strict=True):
        x = pc.pose(found.chain, q).x
        assert value == pytest.approx(peptide[1](x)[0] + held(x)[0], abs=1e-6)
        assert 45.0 < np.degrees(held.values(x)[0]) < 75.0
    for each in found.findings:
        for row in each.samples[-3:].reshape(-1, found.chain.n_hinges + 1):
            x = pc.pose(found.chain, row[1:]).x
            assert row[0] == pytest.approx(peptide[1](x)[0] + held(x)[0], abs=1e-6)
            assert 30.0 < np.degrees(held.values(x)[0]) < 90.0
    assert found.minima["free_energy_kj_mol"].isna().all()
    assert json.loads((tmp_path / "s" / "summary.json").read_text())["restraint"] == [line]
    with expect_refusal("restraint"):
        pc.search(*peptide, method, 9000, resume=True, **{**given, "restraints": ()})


def test_the_judge_of_single_precision_counts_restraints_as_well(peptide):
    chain, energy = peptide
    line = "dihedral phi@A:2 100 100 50"
    rough = pc.energy(chain.structure, solvent=energy.solvent, engine="openmm")
    landscape = Landscape.of(chain, rough, [line])
    end = landscape.minimise(np.zeros(landscape.chain.n_hinges))
    x = landscape.positions(end.q)
    held = Restraints.of(chain.structure, [line])(x)[0]
    assert held > 0.1 and end.energy == pytest.approx(rough.reference(x)[0] + held, abs=1e-2)
    swept = landscape.sweep(end.q, 300.0, 0.002, 2, seed=1)
    x = landscape.positions(swept.q)
    held = Restraints.of(chain.structure, [line])(x)[0]
    assert held > 0.1 and swept.energies[-1] == pytest.approx(rough.reference(x)[0] + held, abs=5e-2)


def test_the_size_of_turns_is_adapted_and_then_stays(peptide):
    landscape = Landscape.of(*peptide)
    method = search_chain.method_of(SearchSettings(method="hopping"), 0)
    state, sizes = None, []
    while state is None or state.n_done < N_ADAPTIVE + 30:
        state, _ = method.begin(landscape) if state is None else method.step(landscape, state)
        sizes.append(state.size)
    assert len(set(sizes[:N_ADAPTIVE])) > 5 and len(set(sizes[N_ADAPTIVE:])) == 1


FULL_TURNS = Symmetry(np.full(2, 2.0 * np.pi), np.zeros((0, 2), dtype=np.int64))
"""Two torsions of groups without symmetry."""


def bank(q, energies, **more):
    """A bank of these minima, tried twice each, in which all nearer than 1 rad is near."""
    q = np.array(q)
    its = {
        "tried": np.full(len(q), 2.0), "random": q, "room": len(q), "mean": 2.0, "width": csa.WIDE,
        "n_rounds": 0, "n_done": 9, "n_accepted": 0, "n_evaluations": 0,
    }  # fmt: skip
    return csa.Bank(q, np.array(energies), **(its | more))


@pytest.mark.parametrize(
    ("q", "energy", "energies", "tried"),
    [
        ([0.3, 0.3], -2.0, [-2.0, 5.0, 1.0], [0.0, 2.0, 2.0]),  # near the first, and lower
        ([0.3, 2.0 * np.pi - 0.3], -0.1, [-0.1, 5.0, 1.0], [2.0, 2.0, 2.0]),  # the same minimum, once more
        ([0.3, 0.3], 0.5, [0.0, 5.0, 1.0], [2.0, 2.0, 2.0]),  # near the first, and higher
        ([0.7, 0.7], 4.9, [0.0, 4.9, 1.0], [2.0, 0.0, 2.0]),  # near none, and lower than the highest
        ([0.7, 0.7], 5.1, [0.0, 5.0, 1.0], [2.0, 2.0, 2.0]),
    ],
)
def test_a_minimum_displaces_a_higher_one_near_it_or_the_highest(q, energy, energies, tried):
    before = bank([[0.0, 0.0], [2.0, 2.0], [-2.0, 2.0]], [0.0, 5.0, 1.0])
    after = csa.add_minimum(before, DescentEnd(np.array(q), energy, 7), FULL_TURNS)
    assert after.energies.tolist() == energies and after.tried.tolist() == tried
    assert after.n_accepted == (energies != before.energies.tolist())
    assert csa.NARROW < after.width < before.width


def test_random_minima_set_what_is_near_and_join_again_after_some_rounds():
    few = bank(np.zeros((csa.BANK - 1, 2)), np.arange(csa.BANK - 1.0), room=csa.BANK, width=csa.NARROW)
    full = csa.add_random(few, DescentEnd(np.array([1.0, -1.0]), 3.0, 7), FULL_TURNS)
    # Of n (n - 1) / 2 pairs, n - 1 are 2 apart.
    assert (full.mean, full.width) == (pytest.approx(4.0 / csa.BANK), csa.WIDE)
    tried = replace(full, tried=np.full(csa.BANK, float(csa.TRIALS)))
    first = csa.next_round(tried)
    assert (first.n_rounds, first.room, len(first.q)) == (1, csa.BANK, csa.BANK) and not first.tried.any()
    second = csa.next_round(replace(tried, n_rounds=csa.ROUNDS - 1))
    assert (second.room, len(second.q)) == (2 * csa.BANK, csa.BANK)
    double = bank(np.zeros((2 * csa.BANK, 2)), -np.arange(2.0 * csa.BANK), tried=np.full(2 * csa.BANK, 20.0))
    third = csa.next_round(replace(double, n_rounds=2 * csa.ROUNDS - 1))
    assert third.energies.tolist() == sorted(double.energies)[: csa.BANK] and third.room == 2 * csa.BANK


def test_a_bank_fills_with_random_minima_and_gets_lower(peptide, monkeypatch):
    monkeypatch.setattr(csa, "BANK", 6)
    landscape = Landscape.of(*peptide)
    method = search_chain.method_of(SearchSettings(method="csa"), 0)
    state, found = method.begin(landscape)
    state = replace(state, room=csa.BANK)
    for _ in range(csa.BANK - 1):
        state, _ = method.step(landscape, state)
    full, lowest = state, [found.minima[0, 1]]
    assert len(full.q) == csa.BANK and full.mean > 0.5 and full.n_done == csa.BANK
    for _ in range(40):
        after, found = method.step(landscape, state)
        assert np.sum(after.tried) <= np.sum(state.tried) + 1.0 and after.energy <= state.energy
        lowest.append(found.minima[0, 1])
        state = after
    assert state.energies.max() < full.energies.max() and state.energy <= min(lowest) + 1e-9


def test_metropolis_accepts_as_boltzmann_says():
    random = np.random.default_rng(0)
    n, rise = 4000, 3.0
    share = sum(metropolis(rise, 300.0, random) for _ in range(n)) / n
    wanted = np.exp(-rise / (8.314462618e-3 * 300.0))
    assert abs(share - wanted) < 3.0 * np.sqrt(wanted * (1.0 - wanted) / n)
    assert metropolis(0.0, 300.0, random) and metropolis(-1.0, 0.0, random)
    assert not metropolis(1e-9, 0.0, random)


def test_pieces_are_read_as_they_were_written(peptide, tmp_path):
    landscape = Landscape.of(*peptide)
    method = search_chain.method_of(SearchSettings(method="tempering", n_replicas=2), 0)
    state, found = advance(landscape, method, None, 300, np.inf)
    write_piece(tmp_path / "a.npz", state, found, {"search": "tempering", "seed": 0})
    again, its = read_piece(tmp_path / "a.npz", method.state, {"search": "tempering", "seed": 0})
    for name, value in vars(state).items():
        assert np.array_equal(getattr(again, name), value) and type(getattr(again, name)) is type(value)
    assert np.array_equal(its.minima, found.minima)
    with expect_refusal("seed", match="0, not 1"):
        read_piece(tmp_path / "a.npz", method.state, {"search": "tempering", "seed": 1})
    (tmp_path / "a.npz").write_bytes((tmp_path / "a.npz").read_bytes()[:-200])
    with expect_refusal("force", match="a search"):
        read_piece(tmp_path / "a.npz", method.state, {"search": "tempering"})


def test_a_folder_has_tables_structures_and_a_page(whole, tmp_path):
    found = whole["tempering"]
    found.save(tmp_path)
    minima = pd.read_csv(tmp_path / "minima.csv")
    assert minima["energy_kj_mol"].to_numpy() == pytest.approx(found.energies[: len(minima)])
    assert minima.loc[0, "free_energy_kj_mol"] == 0.0 and minima["cluster"].min() == 1
    assert "no populations" not in found.agreement
    populations = pd.read_csv(tmp_path / "populations.csv")
    assert populations["temperature_k"].tolist() == [300.0, 600.0]
    assert np.all(np.diff(populations["energy_kj_mol"]) > 0.0)
    shares = pd.read_csv(tmp_path / "conformers.csv").groupby("temperature_k")["share"].sum()
    assert shares.to_numpy() == pytest.approx(1.0)
    record = json.loads((tmp_path / "summary.json").read_text())
    assert record["energy_lowest_kj_mol"] == found.energy and record["evaluations"] == found.n_evaluations
    assert record["round_trips"] == sum(state.n_trips for state in found.states)
    page = (tmp_path / "report.html").read_text()
    assert "minimum 1" in page and f"{found.energy:.2f}" in page
    end = pc.load(tmp_path / "minima" / "minimum-001.pdb")
    assert pc.ca_rmsd(end, end.positions, found.structure(1).positions) < 0.01
    assert repr(found).startswith("<Search of AAA by tempering")


def test_a_search_that_ends_after_its_pilot_reports_missing_populations(peptide, tmp_path):
    found = pc.search(*peptide, "tempering", 900, n_replicas=2, pilot=20, **SMALL)
    assert "no populations" in found.agreement
    found.save(tmp_path)
    assert not (tmp_path / "populations.csv").exists()
    assert "no populations" in (tmp_path / "report.html").read_text()


REFUSED = {
    "temperatures": ("600-300", (300.0,), "hot", (0.0, 300.0), 300.0),
    "method": ("guessing",),
    "evaluations": (0, 1.5),
    "hours": (0.0, -1.0),
    "n_walkers": (0, 10**9),
    "n_replicas": (1, 10**9),
    "seed": (-1,),
    "workers": (0,),
}


@pytest.mark.parametrize(("name", "value"), [(name, value) for name, its in REFUSED.items() for value in its])
def test_settings_that_make_no_sense_are_refused(name, value, peptide):
    with pytest.raises(pc.ProtochainError, match=name):
        pc.search(*peptide, **{"evaluations": 10, name: value})


def test_folders_are_neither_replaced_nor_continued_by_mistake(peptide, tmp_path):
    with expect_refusal("resume", match="give the folder"):
        pc.search(*peptide, resume=True)
    with expect_refusal("resume", match="to resume"):
        pc.search(*peptide, output=tmp_path, resume=True)
    pc.search(*peptide, "hopping", 200, output=tmp_path, n_walkers=1)
    with expect_refusal("resume", "force", match="contains a search"):
        pc.search(*peptide, "hopping", 200, output=tmp_path, n_walkers=1)
    with expect_refusal("seed", match="0, not 1"):
        pc.search(*peptide, "hopping", 200, output=tmp_path, n_walkers=1, seed=1, resume=True)
    again = pc.search(*peptide, "hopping", 200, output=tmp_path, n_walkers=1, seed=1, force=True)
    assert again.settings.seed == 1
    first = tmp_path / "pieces" / "walker-0" / "000000.npz"
    first.rename(first.with_name("000001.npz"))
    with expect_refusal("force", match="is missing"):
        pc.search(*peptide, "hopping", 200, output=tmp_path, n_walkers=1, seed=1, resume=True)


def test_only_one_chain_by_itself_is_searched():
    two = pc.load("structures/3i40.pdb")
    with expect_refusal("chains", "keep", match='chains="A"'):
        pc.search(two, evaluations=10)


def test_numbers_of_minima_are_those_found(whole):
    found = whole["hopping"]
    for number in (0, -1, len(found.q) + 1, 1.5):
        with pytest.raises(pc.ProtochainError, match="number"):
            found.structure(number)


def test_energies_of_a_caller_are_searched_or_refused(peptide):
    chain, energy = peptide
    with expect_refusal("energy", "workers"):
        pc.search(chain, lambda x: energy(x), "hopping", 60, n_walkers=1, workers=1)
    with pytest.raises(pc.ProtochainError, match="no descent ended at a finite energy"):
        pc.search(chain, lambda x: (np.nan, np.nan * x), "hopping", 60, n_walkers=1)


def test_a_dipeptide_has_no_residue_between_others(tmp_path):
    found = pc.search(
        pc.from_sequence("AG"), method="tempering", evaluations=3000, n_walkers=1, n_replicas=2, pilot=20
    )
    found.save(tmp_path)
    assert set(found.minima["conformer"]) == {""} and found.minima["helix_share"].isna().all()
    assert found.conformers["share"].tolist() == [1.0, 1.0]


@pytest.mark.parametrize("workers", [None, 1])
def test_however_short_the_time_a_walk_begins(workers, peptide):
    found = pc.search(*peptide, "hopping", hours=1e-12, workers=workers, **SMALL)
    assert not found.interrupted and sum(state is not None for state in found.states) == 1
    assert len(found.minima) >= 1


@pytest.mark.parametrize("lost", [4, 5])
def test_a_search_outlives_lost_pieces_in_a_row_but_not_the_same_for_ever(lost, tmp_path):
    """Of two walkers, one whose process ends so often before its piece is done."""
    handed, ends, found = [], [], []
    walks = SimpleNamespace(states=[None, None], have_begun=True, wants=lambda walker, _: walker not in found)

    class Pieces:
        def __len__(self):
            return len(handed)

        def submit(self, piece):
            handed.append(piece)

        def wait_for_next(self, _):
            piece, future = handed.pop(0), Future()
            ends.append(piece.walker)
            is_lost = piece.walker == 1 and ends.count(1) <= lost
            future.set_result([PieceEnd(piece.walker, None, None if is_lost else Finding.empty(1), "killed")])
            return piece, future

    def search():
        return search_chain._submit_pieces(
            walks, tmp_path, Pieces(), 1.0, lambda: 9.0, lambda walker, *_: found.append(walker), ()
        )

    if lost == 4:
        assert not search()
    else:
        with expect_refusal("resume", match="walker 1: killed"):
            search()
    assert ends.count(1) == 5 and found == [0, 1][: 6 - lost]


def test_what_a_killed_search_has_left_is_removed(peptide, tmp_path):
    left = tmp_path / f"{temporary_stem()}.part"
    left.mkdir()
    (left / "task.pickle").write_bytes(b"")
    pc.search(*peptide, "hopping", 100, output=tmp_path, workers=1, n_walkers=1)
    assert not list(tmp_path.glob(".protochain-*"))


def test_populations_are_of_walks_whose_pilot_is_over(whole):
    found = whole["tempering"]
    pilot, nothing = search_chain.method_of(found.settings, 0).begin(found.landscape)
    for state in (None, pilot):
        late = replace(found, states=(state, found.states[1]), findings=(nothing, found.findings[1]))
        assert np.array_equal(late.temperatures, found.states[1].temperatures)
        expected = found.states[1].odds / found.states[1].n_counted
        assert late.populations["exchanges"][0] == pytest.approx(expected[0])
        assert [*late.populations][-3:] == ["exchanges", "slope", "slope_error"]
    with_three = replace(pilot, temperatures=np.array([300.0, 400.0]))
    late = replace(found, states=(with_three, found.states[1]), findings=(nothing, found.findings[1]))
    assert late.populations["temperature_k"].tolist() == [300.0, 600.0]


def test_energies_of_minima_are_in_double_precision():
    structure = pc.from_sequence("KEKEKE")
    double = pc.energy(structure, threads=1)
    energy = pc.energy(structure, engine="openmm", threads=1)
    found = pc.search(structure, energy, "hopping", 400, n_walkers=1)
    positions = [pc.pose(found.chain, q).x for q in found.q]
    assert [double.reference(x)[0] for x in positions] == pytest.approx(found.energies, rel=1e-9)
    assert [energy(x)[0] for x in positions] != pytest.approx(found.energies, rel=1e-9)


def test_a_search_goes_on_in_the_precision_in_which_it_began(peptide, tmp_path):
    chain = peptide[0]
    single = pc.energy(chain.structure, solvent="vacuum", engine="openmm", threads=1)
    pc.search(chain, single, "hopping", 100, output=tmp_path, n_walkers=1)
    with expect_refusal("double_precision", match="not True"):
        pc.search(chain, single.reference, "hopping", 200, output=tmp_path, n_walkers=1, resume=True)


@pytest.mark.parametrize("n", [1, 5, 40])
def test_each_minimum_is_drawn_once_in_the_look_of_its_cluster_or_of_the_others(n):
    table = pd.DataFrame({
        "cluster": 1 + np.arange(n) % 20, "ca_rmsd_to_lowest_angstrom": np.arange(n) * 1.0,
        "above_lowest_kj_mol": np.arange(n) * 2.0,
    })  # fmt: skip
    walk = np.array([[1.0, 9.0], [4.0, 11.0], [6.0, 5.0]])
    left, right = draw_minima(table, [walk], 5.0).axes
    shown = np.concatenate([np.asarray(each.get_offsets()) for each in left.collections])
    assert sorted(shown[:, 0].tolist()) == np.arange(n).tolist() and np.all(shown[:, 1] == 2.0 * shown[:, 0])
    keys = [each.get_label() for each in left.collections]
    assert keys == [f"{k}" for k in range(1, min(n, len(COLOURS)) + 1)] + ["others"] * (n > len(COLOURS))
    (line,) = right.lines
    assert line.get_ydata().tolist() == [4.0, 4.0, 0.0] and line.get_xdata().tolist() == [1.0, 4.0, 6.0]
