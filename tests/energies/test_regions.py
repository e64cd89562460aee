"""Energies of a region: what cannot change is computed once, and nothing else is left out."""

from itertools import product

import numpy as np
import pytest
from fixtures.samples import load
from fixtures.tolerances import LEFT_OUT, NATIVE_ENERGY, ROUND_OFF_NM

import protochain as pc
from protochain.energies.native.evaluate import written_blocks
from protochain.energies.native.evaluation import Evaluation, Workspace
from protochain.energies.native.layout import W
from protochain.energies.native.neighbours import SKIN, block_groups, make_lists, partners
from protochain.mechanics import multibody

SETTINGS = {
    "vacuum": {"solvent": "vacuum"},
    "OBC2": {"solvent": "obc2"},
    "GBn2": {"solvent": "gbn2"},
    "cutoff": {"solvent": "obc2", "cutoff": 1.0},
}


def turned(x, angle):
    """All positions turned about a slanting axis: boxes around blocks change their size."""
    axis = np.array([1.0, 2.0, 3.0]) / np.sqrt(14.0)
    return x + np.sin(angle) * np.cross(axis, x) + (1.0 - np.cos(angle)) * np.cross(axis, np.cross(axis, x))


def same(less, whole, chain, x):
    """The two energies and their torques at positions that the chain can take."""
    at = pc.pose(chain, x)
    (own, f), (every, g) = less(at.x), whole(at.x)
    assert own == pytest.approx(every, rel=NATIVE_ENERGY)
    tau, by_every = pc.pull_back(chain, at, f), pc.pull_back(chain, at, g)
    assert np.linalg.norm(tau - by_every) < LEFT_OUT * np.linalg.norm(g)


@pytest.mark.parametrize(
    ("name", "move"), [*product(SETTINGS, ["resid 20"]), ("OBC2", "resid 30:39 and not backbone")]
)
def test_turning_a_region_gives_the_energy_of_all(move, name):
    s = load("1ubq.pdb")
    c = pc.build_chain(s, move=move)
    whole = pc.energy(s, **SETTINGS[name])
    less = whole.without_constants(c.rigid_groups, s.positions)
    lists = less._lists
    # Two bodies, of which one turns against the other; or the root, and side chains.
    assert len(lists.changing) < 0.75 * len(lists.tiles)
    rng = np.random.default_rng(1)
    for _ in range(3):
        same(less, whole, c, multibody.integrate(c.tree, c.q0, rng.normal(scale=0.3, size=c.n_v)))
    assert less._lists is not lists


@pytest.mark.parametrize("name", SETTINGS)
def test_atoms_that_move_alone_have_the_forces_of_all(name):
    s = load("1ubq.pdb")
    moving = pc.build_chain(s, move="resid 20").moving
    whole = pc.energy(s, **SETTINGS[name])
    less = whole.without_constants(np.where(moving, -1, 0)[:, None], s.positions)
    assert len(less._lists.changing) < 0.2 * len(less._lists.tiles)
    rng, x = np.random.default_rng(2), s.positions.copy()
    for angle in (0.0, 0.8, 1.9):
        x[moving] += rng.normal(scale=0.03, size=(moving.sum(), 3))
        at = turned(x, angle)
        (own, f), (every, g) = less(at), whole(at)
        assert own == pytest.approx(every, rel=NATIVE_ENERGY)
        assert np.linalg.norm(f[moving] - g[moving]) < LEFT_OUT * np.linalg.norm(g[moving])


def test_a_block_belongs_to_a_group_if_all_its_atoms_do():
    groups = np.full((3 * W + 5, 2), -1)
    groups[:, 0] = 7
    assert block_groups(groups).tolist() == [7, 7, 7, 7]
    groups[W, 0], groups[2 * W + 3] = -1, (4, 7)
    assert block_groups(groups).tolist() == [7, -1, 7, 7]
    groups[-5:, 0], groups[-1] = 2, (5, 2)
    assert block_groups(groups).tolist() == [7, -1, 7, 2]
    groups[-1] = (5, 3)
    assert block_groups(groups).tolist() == [7, -1, 7, -1]
    assert block_groups(np.full((W, 1), -1)).tolist() == [-1]


def test_tiles_within_one_group_do_not_change_and_all_others_may():
    x = np.zeros((4 * W, 3))
    x[:, 0] = 0.3 * (np.arange(4 * W) // W)
    none = partners(np.zeros((0, 2), np.int64), 4 * W)
    of_block = np.array([3, -1, 3, 0])
    groups = np.repeat(of_block, W)[:, None]
    found = make_lists(x, 0.2, np.full(4, 0.25), 0.2, 5.0, none, groups, of_block)
    every = [(i, j) for i in range(4) for j in range(i, 4)]
    assert [tuple(tile) for tile in found.tiles.tolist()] == every
    changing = [tile for tile in every if tile not in ((0, 0), (0, 2), (2, 2), (3, 3))]
    assert [tuple(tile) for tile in found.changing.tolist()] == changing
    near = [abs(i - j) * 0.3 < 0.25 + SKIN for i, j in changing]
    assert found.is_near.tolist() == near


@pytest.mark.parametrize("method", ["hybrid", "cartesian"])
def test_a_run_of_a_region_starts_and_ends_at_the_energies_of_all(method):
    s = load("1ubq.pdb")
    c = pc.build_chain(s, move="resid 20")
    energy = pc.energy(s)
    r = pc.minimise(c, energy, method)
    assert r.status == "converged"
    assert r.trace["energy_kj_mol"].iloc[0] == pytest.approx(energy(s.positions)[0], rel=NATIVE_ENERGY)
    assert r.trace["energy_kj_mol"].iloc[-1] == pytest.approx(energy(r.x)[0], rel=NATIVE_ENERGY)
    # In torsions, hinges of the residue turn what is behind it.
    off = np.abs(r.x - s.positions)[~c.moving].max()
    assert off < ROUND_OFF_NM if method == "cartesian" else off > 0.001


@pytest.mark.parametrize("name", SETTINGS)
@pytest.mark.parametrize("move", ["resid 20", "all"])
def test_chunks_write_only_to_the_blocks_that_are_cleared_and_added(name, move):
    s = load("1ubq.pdb")
    c = pc.build_chain(s, move=move)
    less = pc.energy(s, **SETTINGS[name]).without_constants(c.rigid_groups, s.positions)
    evaluation = Evaluation(less._layout, less._lists, less._constants[1], Workspace(less._layout), threads=1)
    marked = written_blocks(less._layout, less._lists)
    evaluation.workspace.sums[:] = 7.0
    parts, forces = evaluation(s.positions)
    assert (evaluation.workspace.sums[~marked] == 7.0).all()
    # What is marked is written to, but for tiles and pairs of the lists' margin.
    assert ((evaluation.workspace.sums[marked] == 0.0).all(axis=1)).sum() < 0.2 * marked.size
    value, expected = less(s.positions)
    assert np.array_equal(forces, expected) and sum(parts.values()) + less._constants[0] == value
    if name == "vacuum":
        assert marked.mean() < (0.7 if move == "resid 20" else 1.0)
