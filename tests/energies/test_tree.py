"""Far pairs by a tree: its expansions, its energy beside all pairs, its forces, and what it is chosen for."""

import functools
import pickle
import re
from itertools import combinations

import numpy as np
import openmm
import pytest
from fixtures.oracles import far_potential
from fixtures.refusals import expect_refusal
from fixtures.samples import load
from fixtures.tolerances import DIFFERENCE, ROUND_OFF

import protochain as pc
from protochain.core import defaults
from protochain.core.arrays import read_only
from protochain.core.errors import ProtochainError
from protochain.energies import NativeEnergy, OpenMMEnergy
from protochain.energies.native import engine, expansion
from protochain.energies.native.far import FAR_TERMS, Opening, openings
from protochain.energies.native.lanes import LANES
from protochain.energies.native.layout import CHUNKS, W
from protochain.energies.native.tree import FIRST, LEFT, SKIN, build_tree, screened_pairs
from protochain.minimisers.judging import CachedEnergy
from protochain.minimisers.minimise_settings import JUDGES

SAMPLE = "1ake.pdb.gz"
NEAR = Opening(0.5, 6)


@functools.cache
def energy(solvent="obc2", threads=2):
    return pc.energy(load(SAMPLE), solvent=solvent, engine="native", accuracy="exact", threads=threads)


@pytest.fixture(scope="module", autouse=True)
def forgotten():
    """Energies that tests of this file share are large."""
    yield
    energy.cache_clear()


def rms(forces):
    return np.sqrt((forces**2).sum(axis=1).mean())


@pytest.mark.parametrize("power", [1, 4, 6])
@pytest.mark.parametrize("order", [1, 4, 7])
@pytest.mark.parametrize("n_far", [1, LANES + 3])
def test_the_field_of_far_nodes_is_the_taylor_polynomial_of_their_pairs(power, order, n_far):
    random = np.random.default_rng(power + order)
    here, weight = random.normal(size=(W, 3)), random.normal(size=(n_far, W))
    there = random.normal([9.0, -4.0, 5.0], size=(n_far, W, 3))
    second = 0.3 if power == 4 else 0.0
    blocks = np.concatenate([here[None], there])
    atoms = np.ascontiguousarray(blocks.swapaxes(1, 2)).reshape(-1, 3 * W)
    # Leaves without parents: one in the first chunk, the others in the second.
    nodes = read_only([[k, k + 1, -1, -1, -1] for k in range(1 + n_far)], np.int64)
    roots = read_only([0, 1] + [1 + n_far] * (CHUNKS - 1), np.int64)
    centre = read_only(blocks.mean(axis=1))
    start, source = (
        read_only([0, n_far] + [n_far] * n_far, np.int64),
        read_only(1 + np.arange(n_far), np.int64),
    )
    monomials, *_ = tabled = tuple(read_only(each, np.int64) for each in expansion.tables(order))
    charges = np.zeros((1 + n_far, 1, W))
    charges[1:, 0] = weight
    moments, fields = np.zeros((2, 1 + n_far, 1, len(monomials)))
    kinds = read_only([[0, order]], np.int64)
    expansion.put_moments((0, CHUNKS), atoms, charges, kinds, nodes, roots, centre, tabled, moments)
    uses = read_only([[power, order, 0, 0]], np.int64), read_only([second])
    expansion.put_fields((0, CHUNKS), *uses, nodes, roots, centre, start, source, tabled, moments, fields)
    found = np.zeros(W)
    alone = read_only([0], np.int64)
    expansion.add_potential((0, CHUNKS), atoms[:1], 0, order, alone, centre, tabled, fields, found)
    expected = sum(
        far_potential(here, x, w, centre[0], c, power, order)
        + (second and second * far_potential(here, x, w, centre[0], c, power + 2, order))
        for x, w, c in zip(there, weight, centre[1:], strict=True)
    )
    assert np.abs(found - expected).max() < 1e3 * ROUND_OFF * np.abs(expected).max()


def test_a_tree_has_each_pair_of_blocks_once_near_or_far():
    x = load(SAMPLE).positions
    tree = build_tree(x, 0.6, 1.0)
    leaves = [range(first, end) for first, end in tree.nodes[:, FIRST:LEFT]]
    counts = np.zeros((max(map(max, leaves)) + 1,) * 2, int)
    for i, j in tree.near:
        counts[i, j] += 1
        counts[j, i] += i != j
    for node in range(len(leaves)):
        for other in tree.source[tree.start[node] : tree.start[node + 1]]:
            counts[np.ix_(leaves[node], leaves[other])] += 1
    assert (counts == 1).all() and len(tree.source) > 0
    assert sorted(tree.order) == list(range(len(x)))


def test_far_blocks_within_reach_of_an_atoms_born_radius_are_screened():
    """Whatever the radii: boxes of blocks, and of the nodes that hold them, only save time."""
    tree = build_tree(load(SAMPLE).positions, 0.6, 1.0)
    x, reach = load(SAMPLE).positions[tree.order], 0.1
    born = np.random.default_rng(1).lognormal(-1.0, 1.0, len(x))
    blocks = [slice(k, k + W) for k in range(0, len(x), W)]
    expected, near = {}, set(map(tuple, tree.near.tolist()))
    for i, j in combinations(range(len(blocks)), 2):
        its, at = x[blocks[j]], x[blocks[i]]
        gap = np.maximum(np.maximum(its.min(axis=0) - at, at - its.max(axis=0)) - SKIN, 0.0)
        felt = (gap**2).sum(axis=1) < 4.0 * reach * born[blocks[i]] * born[blocks[j]].max()
        if felt.any() and (i, j) not in near:
            expected[i, j] = np.flatnonzero(felt).tolist()
    pairs, rows = screened_pairs(tree, x, born, reach)
    found = [np.flatnonzero(row).tolist() for row in rows]
    assert dict(zip(map(tuple, pairs.tolist()), found, strict=True)) == expected
    assert 500 < len(expected) < 0.5 * len(blocks) * (len(blocks) - 1) / 2


@pytest.mark.parametrize("solvent", ["vacuum", "obc2", "gbn2"])
def test_energy_and_forces_approach_those_of_all_pairs(solvent):
    x, exact = load(SAMPLE).positions, energy(solvent)
    (parts, forces), errors = exact.parts(x), []
    for opening in (Opening(0.6, 4, 6.0), Opening(0.5, 6), Opening(0.4, 9, 12.0, 2)):
        found, its = exact.by_tree(opening).parts(x)
        errors.append(rms(its - forces))
        # Coulomb and generalised Born cancel far away: each is wrong by more than their sum.
        assert abs(sum(found.values()) - sum(parts.values())) < 1e3 * errors[-1]
    assert errors[0] > 3.0 * errors[1] > 30.0 * errors[2] and errors[2] < (
        0.01 if solvent == "vacuum" else 2e-4
    )


@pytest.mark.parametrize("solvent", ["vacuum", "obc2", "gbn2"])
def test_forces_are_the_gradient_of_the_energy_while_lists_hold(solvent):
    x, exact = load(SAMPLE).positions, energy(solvent)
    # Coarse, so that what the tree changes is much; without what it leaves, as GBn2's necks end in steps.
    tree = exact.by_tree(Opening(0.7, 2, 1.0))
    off, step = tree(x)[1] - exact(x)[1], 1e-6
    assert rms(off) > 0.03
    for seed in range(3):
        way = np.random.default_rng(seed).normal(size=x.shape)
        ahead, behind = (tree(at)[0] - exact(at)[0] for at in (x + step * way, x - step * way))
        slope = (ahead - behind) / (2.0 * step)
        assert abs(slope + (off * way).sum()) < 1e3 * DIFFERENCE * np.linalg.norm(off)


@pytest.mark.parametrize("solvent", ["vacuum", "obc2"])
def test_any_number_of_threads_gives_the_same_bits(solvent):
    x, alone = load(SAMPLE).positions, energy(solvent, 1).by_tree(NEAR)
    expected = [alone(x + 0.1 * k) for k in range(3)]
    for threads in (2, 3, 16):
        together = energy(solvent, threads).by_tree(NEAR)
        together.threads = threads
        for k in range(3):
            value, forces = together(x + 0.1 * k)
            assert value == expected[k][0] and np.array_equal(forces, expected[k][1])


def test_a_tree_survives_pickling_and_the_order_of_its_atoms_is_its_own():
    x, tree = load(SAMPLE).positions, energy().by_tree(NEAR)
    again = pickle.loads(pickle.dumps(tree))
    assert again.opening == NEAR and np.array_equal(again(x)[1], tree(x)[1])
    assert np.abs(tree.born_radii(x) - tree.exact.born_radii(x)).max() == 0.0
    assert tree.lists_at is not None


@pytest.mark.parametrize("solvent", ["vacuum", "obc2", "gbn2"])
def test_an_accuracy_is_kept_and_its_error_is_said(solvent):
    s, exact = load(SAMPLE), energy(solvent)
    for accuracy in (0.1, 0.5) if solvent == "vacuum" else (1e-3, 5e-3):
        e = pc.energy(s, solvent=solvent, engine="native", accuracy=accuracy)
        off = rms(e(s.positions)[1] - exact(s.positions)[1])
        (said,) = re.findall(r"differ by (\S+) kJ/mol/nm RMS", e.reason)
        assert 0.0 < off <= accuracy and float(said) == pytest.approx(off, rel=0.06)


def test_accuracy_is_chosen_by_size(monkeypatch):
    s = load(SAMPLE)
    assert "tree" not in pc.energy(s).reason
    monkeypatch.setattr(defaults, "TREE_FROM", s.n_atoms)
    assert "tree" in pc.energy(s).reason and pc.energy(s).errors[0] <= defaults.TREE_ACCURACY
    for given in ({"accuracy": "exact"}, {"cutoff": None}, {"cutoff": 1.0}, {"engine": "openmm"}):
        assert "tree" not in pc.energy(s, **given).reason
    for given in ({"cutoff": 1.0}, {"engine": "openmm"}):
        with pytest.raises(ProtochainError, match="accuracy"):
            pc.energy(s, accuracy=1e-3, **given)
    for bad in (0.0, -1.0, np.nan, "much", True):
        with expect_refusal("accuracy"):
            pc.energy(s, accuracy=bad)


def test_few_atoms_are_summed_one_by_one_with_a_word():
    small = load("1l2y.pdb")
    assert "one by one" in pc.energy(small, accuracy=1e-2).reason
    assert "one by one: no tree" in pc.energy(load(SAMPLE), accuracy=1e-9).reason


def test_all_pairs_judge_a_tree():
    x = load(SAMPLE).positions
    tree = energy().by_tree(Opening(0.6, 4, 6.0))
    for judge in JUDGES:
        known = CachedEnergy(tree, judge)
        value, _ = known.judge_at(x)
        assert value == pytest.approx(energy()(x)[0], rel=ROUND_OFF if judge == "auto" else 1e-8)
        assert abs(value - tree(x)[0]) > 1e-3 and ("native" in known.judge) is (judge == "auto")
    assert len(tree.errors) == 2 and "differ" in tree.reason


def test_the_sum_by_which_a_tree_was_chosen_judges_its_start(monkeypatch):
    x, exact = load(SAMPLE).positions, energy.__wrapped__()
    tree, asked, by_pairs = exact.to_accuracy(5e-3, x), [], NativeEnergy.__call__

    def noted(its, at):
        asked.append(its)
        return by_pairs(its, at)

    assert tree.opening is not None
    monkeypatch.setattr(NativeEnergy, "__call__", noted)
    known = CachedEnergy(tree)
    value, forces = known.judge_at(x, first=True)
    assert asked == []
    anew = energy()(x)
    assert value == anew[0] and np.array_equal(forces, anew[1])
    moved = x + np.random.default_rng(5).normal(0.0, 1e-3, x.shape)
    assert known.judge_at(moved)[0] == pytest.approx(energy()(moved)[0], rel=ROUND_OFF)
    assert tree.exact in asked
    by_reference, _ = CachedEnergy(tree, "reference").judge_at(x, first=True)
    assert by_reference != value == pytest.approx(by_reference, rel=1e-8)


def test_a_tree_that_does_not_keep_the_accuracy_is_not_taken(monkeypatch):
    x, exact, coarse = load(SAMPLE).positions, energy(), Opening(0.7, 2, 1.0)
    monkeypatch.setattr(engine, "openings", lambda accuracy, in_solvent: [coarse, NEAR])
    assert exact.to_accuracy(10.0, x).opening == coarse
    assert exact.to_accuracy(5e-3, x).opening == NEAR
    assert exact.to_accuracy(1e-7, x) is exact and "one by one" in exact.reason


def test_openings_cost_more_the_smaller_the_error():
    for in_solvent in (True, False):
        assert len(openings(1.0, in_solvent)) > len(openings(1e-3, in_solvent)) > 0
    assert openings(1e-12, True) == []
    y = np.linspace(0.0, 0.15**2, 50)[1:]
    series = sum(2 * k / (2 * k + 1) * y ** (k - 1) for k in range(1, 40))
    assert np.abs(FAR_TERMS[0] + FAR_TERMS[1] * y - series).max() < 1.2e-4


def particles(x, charges, radii=0.17):
    """Energy of particles with Lennard-Jones, charges and generalised Born, and nothing bonded."""
    n = len(x)
    built, pairs, solvent = openmm.System(), openmm.NonbondedForce(), openmm.GBSAOBCForce()
    for charge, radius in zip(np.broadcast_to(charges, n), np.broadcast_to(radii, n), strict=True):
        built.addParticle(12.0)
        pairs.addParticle(charge, 0.3, 0.2)
        solvent.addParticle(charge, radius, 0.8)
    built.addForce(pairs)
    built.addForce(solvent)
    return NativeEnergy(OpenMMEnergy(built, threads=1), 1)


N = 2100
RANDOM = np.random.default_rng(0)
GRID = 0.4 * np.stack(np.unravel_index(np.arange(N), (13, 13, 13)), axis=1) + 0.05 * RANDOM.random((N, 3))
ALIKE = RANDOM.normal(scale=0.4, size=N)
EXTREMES = {
    "all in a line": (0.3 * np.arange(N)[:, None] * [1.0, 0.0, 0.0], ALIKE, 0.17),
    "all in one point but two": (np.where(np.arange(N)[:, None] < N - 2, 0.0, GRID + 3.0), ALIKE, 0.17),
    "two clusters 1000 nm apart": (GRID + 1000.0 * (np.arange(N) % 3 == 0)[:, None], ALIKE, 0.17),
    "one charge": (GRID, np.eye(1, N)[0], 0.17),
    "no charge": (GRID, 0.0, 0.17),
    "net charge 1000": (GRID, 1000.0 / N, 0.17),
    "radii of 3 nm beside 0.1": (GRID, ALIKE, np.where(np.arange(N) % 100, 0.1, 3.0)),
}


@pytest.mark.parametrize("name", EXTREMES)
def test_extremes_are_right_to_the_accuracy_or_summed_one_by_one_with_a_word(name):
    x, charges, radii = EXTREMES[name]
    exact = particles(x, charges, radii)
    found = exact.to_accuracy(1e-3, x)
    off = rms(found(x)[1] - exact(x)[1])
    assert off <= 1e-3
    assert (found.opening is None) == ("one by one" in found.reason)
    assert found.opening is None or not np.isnan(found.errors[0])
