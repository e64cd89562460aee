"""``search``: the same bits however it is cut into pieces, what it writes, and what it refuses."""

import json
import os
import signal
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import protochain as pc
from protochain.searching import api, hopping
from protochain.searching.annealing import PILOTS, RUNGS, scheduled
from protochain.searching.hopping import ADAPTED, metropolis
from protochain.searching.ladder import geometric, length_of_widths
from protochain.searching.landscape import Landscape
from protochain.searching.minima import SAME_ENERGY
from protochain.searching.pieces import advance, read_piece, write_piece
from protochain.searching.settings import SearchSettings

SMALL = {"n_walkers": 2, "seed": 3}


@pytest.fixture(scope="module")
def peptide():
    structure = pc.from_sequence("AAA")
    return pc.build_chain(structure), pc.energy(structure, solvent="vacuum", threads=1)


@pytest.fixture(scope="module")
def whole(peptide):
    """A search by each method, in one go."""
    return {
        "hopping": pc.search(*peptide, "hopping", 1500, **SMALL),
        "annealing": pc.search(*peptide, "annealing", 1500, **SMALL),
        "tempering": pc.search(*peptide, "tempering", 12000, n_replicas=2, **SMALL),
    }


def same(one, other):
    """Whether two searches found the same bits."""
    return all(
        np.array_equal(a.minima, b.minima) and np.array_equal(a.samples, b.samples)
        for a, b in zip(one.findings, other.findings, strict=True)
    )


def options(method):
    return {"hopping": (1500, {}), "annealing": (1500, {}), "tempering": (12000, {"n_replicas": 2})}[method]


@pytest.mark.usefixtures("interruptible")
@pytest.mark.parametrize("method", ["hopping", "annealing", "tempering"])
def test_a_search_that_is_interrupted_and_resumed_finds_the_same_bits(
    method, peptide, whole, tmp_path, monkeypatch
):
    monkeypatch.setattr(api, "SECONDS", 0.0)  # a piece a step, so that one is interrupted on any machine
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


def test_a_search_in_processes_that_fail_finds_the_same_bits(peptide, whole, tmp_path, monkeypatch):
    failed, supervise = [], api.supervise

    def failing(job, folder, threads, limit):
        if len(failed) < 2:
            failed.append(job.walker)
            return job.lost([], "killed", "the process was ended by SIGKILL", 1.0)
        return supervise(job, folder, threads, limit)

    monkeypatch.setattr(api, "supervise", failing)
    found = pc.search(*peptide, "hopping", 1500, output=tmp_path, workers=2, **SMALL)
    assert len(failed) == 2 and same(found, whole["hopping"])
    assert not list(tmp_path.glob(".search-*"))


def test_a_process_that_fails_again_and_again_ends_the_search_and_keeps_what_there_is(
    peptide, tmp_path, monkeypatch
):
    monkeypatch.setattr(api, "supervise", lambda job, *_: job.lost([], "killed", "memory ran out", 1.0))
    with pytest.raises(pc.ProtochainError, match=r"walker [01]: memory ran out; .*resume=True"):
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


def test_the_size_of_turns_is_adapted_and_then_stays(peptide):
    landscape = Landscape.of(*peptide)
    method = api.method_of(SearchSettings(), 0)
    state, sizes = None, []
    while state is None or state.n_done < ADAPTED + 30:
        state, _ = method.begin(landscape) if state is None else method.step(landscape, state)
        sizes.append(state.size)
    assert len(set(sizes[:ADAPTED])) > 5 and len(set(sizes[ADAPTED:])) == 1


def test_a_run_that_finds_nothing_lower_begins_again_elsewhere(peptide, monkeypatch):
    monkeypatch.setattr(hopping, "PATIENCE", 8)
    landscape = Landscape.of(*peptide)
    method = api.method_of(SearchSettings(temperatures="1-600"), 0)
    before, _ = method.begin(landscape)
    ends = []
    for _ in range(60):
        state, found = method.step(landscape, before)
        assert state.low <= state.energy + SAME_ENERGY and state.n_since <= 8
        if before.n_since == 8:  # Wherever it leads.
            assert (state.low, state.n_since) == (found.minima[0, 1], 0)
            assert np.array_equal(state.q, found.minima[0, 2:]) and state.n_accepted == before.n_accepted + 1
            ends.append(state.energy)
        elif state.energy < before.low - SAME_ENERGY:
            assert (state.low, state.n_since) == (state.energy, 0)
        else:
            assert (state.low, state.n_since) == (before.low, before.n_since + 1)
        before = state
    assert len(ends) > 3 and np.ptp(ends) > SAME_ENERGY


def test_metropolis_accepts_as_boltzmann_says():
    random = np.random.default_rng(0)
    n, rise = 4000, 3.0
    share = sum(metropolis(rise, 300.0, random) for _ in range(n)) / n
    wanted = np.exp(-rise / (8.314462618e-3 * 300.0))
    assert abs(share - wanted) < 3.0 * np.sqrt(wanted * (1.0 - wanted) / n)
    assert metropolis(0.0, 300.0, random) and metropolis(-1.0, 0.0, random)
    assert not metropolis(1e-9, 0.0, random)


def test_coolings_fall_and_begin_again_at_the_top(peptide):
    landscape = Landscape.of(*peptide)
    method = api.method_of(SearchSettings(method="annealing", temperatures="250-900"), 0)
    state, found = method.begin(landscape)
    minima = 0
    for number in range(PILOTS * RUNGS):
        state, found = method.step(landscape, state)
        minima += len(found.minima)
        assert len(found.minima) == (number % RUNGS == RUNGS - 1)
        assert np.all(np.diff(state.temperatures) < 0.0)
        assert state.temperatures[[0, -1]].tolist() == [900.0, 250.0]
    assert minima == PILOTS and np.all(state.widths > 0.0)
    assert not np.allclose(state.temperatures, geometric(900.0, 250.0, RUNGS), rtol=1e-3)
    # Thrice as wide when cold: there the temperatures are closer, with the same lengths between them.
    ladder = geometric(900.0, 250.0, RUNGS)
    widths = np.interp(ladder, [250.0, 900.0], [12.0, 4.0])
    placed = scheduled(replace(state, temperatures=ladder, widths=widths)).temperatures
    lengths = length_of_widths(placed, np.interp(placed, ladder[::-1], widths[::-1]))
    assert np.ptp(lengths) < 0.3 * np.mean(lengths)
    assert np.sum(placed < 500.0) > np.sum(ladder < 500.0) + 5


def test_pieces_are_read_as_they_were_written(peptide, tmp_path):
    landscape = Landscape.of(*peptide)
    method = api.method_of(SearchSettings(method="tempering", n_replicas=2), 0)
    state, found = advance(landscape, method, None, 300, np.inf)
    write_piece(tmp_path / "a.npz", state, found, {"search": "tempering", "seed": 0})
    again, its = read_piece(tmp_path / "a.npz", method.state, {"search": "tempering", "seed": 0})
    for name, value in vars(state).items():
        assert np.array_equal(getattr(again, name), value) and type(getattr(again, name)) is type(value)
    assert np.array_equal(its.minima, found.minima)
    with pytest.raises(pc.ProtochainError, match="seed 0, not 1"):
        read_piece(tmp_path / "a.npz", method.state, {"search": "tempering", "seed": 1})
    (tmp_path / "a.npz").write_bytes((tmp_path / "a.npz").read_bytes()[:-200])
    with pytest.raises(pc.ProtochainError, match=r"is no checkpoint of a search; .*force"):
        read_piece(tmp_path / "a.npz", method.state, {"search": "tempering"})


def test_a_folder_has_tables_structures_and_a_page(whole, tmp_path):
    found = whole["tempering"]
    found.save(tmp_path)
    minima = pd.read_csv(tmp_path / "minima.csv")
    assert minima["energy_kj_mol"].to_numpy() == pytest.approx(found.energies[: len(minima)])
    assert minima.loc[0, "free_energy_kj_mol"] == 0.0 and minima["cluster"].min() == 1
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
    with pytest.raises(pc.ProtochainError, match="give the folder"):
        pc.search(*peptide, resume=True)
    with pytest.raises(pc.ProtochainError, match="holds no search to resume"):
        pc.search(*peptide, output=tmp_path, resume=True)
    pc.search(*peptide, "hopping", 200, output=tmp_path, n_walkers=1)
    with pytest.raises(pc.ProtochainError, match="holds a search; resume=True"):
        pc.search(*peptide, "hopping", 200, output=tmp_path, n_walkers=1)
    with pytest.raises(pc.ProtochainError, match="seed 0, not 1"):
        pc.search(*peptide, "hopping", 200, output=tmp_path, n_walkers=1, seed=1, resume=True)
    again = pc.search(*peptide, "hopping", 200, output=tmp_path, n_walkers=1, seed=1, force=True)
    assert again.settings.seed == 1
    first = tmp_path / "pieces" / "walker-0" / "000000.npz"
    first.rename(first.with_name("000001.npz"))
    with pytest.raises(pc.ProtochainError, match="the piece before it is missing"):
        pc.search(*peptide, "hopping", 200, output=tmp_path, n_walkers=1, seed=1, resume=True)


def test_only_one_chain_by_itself_is_searched():
    two = pc.load("structures/3i40.pdb")
    with pytest.raises(pc.ProtochainError, match="one chain"):
        pc.search(two, evaluations=10)
