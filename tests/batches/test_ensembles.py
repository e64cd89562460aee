"""Clusters and fluctuations of ensembles, against other programs and closed forms."""

import itertools

import mdtraj
import numpy as np
import pandas as pd
import pytest
from fixtures.command_line import refusal, run
from fixtures.samples import STRUCTURES, load
from scipy.spatial.transform import Rotation

import protochain as pc
from protochain.batches.ensembles import cluster_distances, fluctuations, rmsds
from protochain.structure import ca_rmsd


@pytest.fixture(scope="module")
def three():
    """Of ubiquitin: itself, turned; nearly itself; and with its tail elsewhere, twice."""
    s = load("1ubq.pdb")
    rng = np.random.default_rng(3)
    tail = np.flatnonzero(s.atom_residue >= 60)
    x = np.array([s.positions] * 5)
    x[0] = Rotation.from_rotvec([1.0, 2.0, 0.5]).apply(x[0]) + 3.0
    x[1] += rng.normal(0.0, 0.002, x[1].shape)
    x[3:, tail] += [0.5, 0.0, 0.3]
    x[4] += rng.normal(0.0, 0.002, x[4].shape)
    return s, x


def test_distances_are_those_of_one_pair_after_the_other(three):
    s, x = three
    alpha = s.alpha_carbons
    found = 10.0 * rmsds([each[alpha] for each in x])
    for i, j in itertools.combinations(range(len(x)), 2):
        assert found[i, j] == found[j, i] == pytest.approx(ca_rmsd(s, x[i], x[j]), abs=1e-5)
    mirrored = x[0][alpha] * [1.0, 1.0, -1.0]
    pair = rmsds([x[0][alpha], mirrored])[0, 1]
    frames = mdtraj.Trajectory(np.array([x[0][alpha], mirrored]), pc.to_mdtraj(s).topology.subset(alpha))
    assert pair == pytest.approx(float(mdtraj.rmsd(frames, frames)[1]), abs=1e-4) and pair > 0.1


def test_frames_that_are_alike_are_one_cluster_with_its_middle(three):
    s, x = three
    found = pc.cluster_frames(s, x)
    assert found.table["cluster"].tolist() == [1, 1, 1, 2, 2]
    assert found.table["frame"].tolist() == [0, 1, 2, 3, 4] and found.table["medoid"].sum() == 2
    for k, medoid in enumerate(found.medoids, 1):
        own = found.table.index[found.table["cluster"] == k]
        sums = [sum(ca_rmsd(s, x[i], x[j]) for j in own) for i in own]
        (middle,) = found.table.index[found.table["medoid"] & (found.table["cluster"] == k)]
        assert sums[own.tolist().index(middle)] == pytest.approx(min(sums), abs=1e-5)
        assert np.allclose(medoid.positions, x[middle], atol=1e-6)
        assert found.table["distance_to_medoid"][own[-1]] == pytest.approx(
            ca_rmsd(s, x[own[-1]], x[middle]), abs=1e-4
        )
    assert pc.cluster_frames(s, x, "1:4", within=1e-3).table["frame"].tolist() == [1, 2, 3]
    assert len(pc.cluster_frames(s, x, within=50.0).medoids) == 1


def test_torsions_part_what_they_differ_by():
    """Of one psi of ten by 90 degrees: 90 / sqrt(number of phi and psi)."""
    c = pc.build_chain(pc.from_sequence("AAAAA"), "phi,psi")
    x = np.array([pc.pose(c, c.set({"psi A:3": angle})).x for angle in (-30.0, 60.0)])
    found = pc.cluster_frames(c.structure, x, by="torsions", within=40.0).table
    n = int(c.structure.dihedrals()[["phi", "psi"]].notna().sum().sum())
    assert found["cluster"].tolist() == [1, 1]
    assert found["distance_to_medoid"].max() == pytest.approx(90.0 / np.sqrt(n), abs=1e-3)
    assert pc.cluster_frames(c.structure, x, by="torsions", within=5.0).table["cluster"].tolist() == [1, 2]


def test_fluctuations_are_those_about_the_mean(three):
    """Of points that swing by +-d along one axis, most of them at rest, d; by mdtraj of a protein."""
    s, x = three
    still = np.random.default_rng(0).normal(size=(500, 3))
    swinging = np.array([still, still])
    swinging[:, 0] += [[0.01, 0.0, 0.0], [-0.01, 0.0, 0.0]]
    found = fluctuations([*swinging])
    assert found[0] == pytest.approx(0.1, rel=0.01) and found[1:].max() < 1e-3
    frames = pc.to_mdtraj(s, x).atom_slice(s.alpha_carbons)
    frames.superpose(frames[0])
    mean = frames[0]
    for _ in range(5):
        mean.xyz = frames.superpose(mean).xyz.mean(axis=0, keepdims=True)
    theirs = 10.0 * np.sqrt(np.mean(np.sum((frames.xyz - mean.xyz) ** 2, axis=2), axis=0))
    assert pc.cluster_frames(s, x).fluctuations["ca_fluctuation_angstrom"].to_numpy() == pytest.approx(
        theirs, abs=2e-3
    )


def test_one_frame_is_a_cluster():
    labels, middle = cluster_distances(np.zeros((1, 1)), 1.0)
    assert labels.tolist() == [1] and middle.tolist() == [0]


def test_the_command_writes_medoids_and_tables(three, tmp_path, monkeypatch, capsys):
    x = three[1]
    monkeypatch.chdir(tmp_path)
    np.savez("f.npz", positions=x, unit="nm")
    np.savez("g.npz", positions=x[[0, 0, 0, 0, 0]], unit="nm")
    given = [STRUCTURES / "1ubq.pdb", "--trajectory", "f.npz"]
    assert run("ensemble", *given, "--after", "g.npz", "--csv", "c.csv", "--residues", "r.csv") == 0
    assert "5 frames" in capsys.readouterr().out
    assert pd.read_csv("c.csv")["cluster"].tolist() == [1, 1, 1, 2, 2]
    table = pd.read_csv("r.csv")
    assert len(table) == 76 and table["ca_fluctuation_angstrom"].max() > 1.0
    assert table["ca_fluctuation_after_angstrom"].max() < 1e-4
    assert len(mdtraj.load("1ubq.medoids.pdb")) == 2
    assert "torsions" in refusal("ensemble", *given, "--by", "beauty")
    assert "within" in refusal("ensemble", *given, "--within", "-1")


@pytest.mark.parametrize("seed", range(3))
def test_a_medoid_is_the_frame_nearest_to_all_others_of_its_cluster_wherever_it_is(seed):
    x = np.random.default_rng(seed).permutation([0.0, 1.0, 1.3, 2.2, 9.0, 9.6, 9.7])
    labels, medoids = cluster_distances(np.abs(x[:, None] - x), 4.0)
    assert {frozenset(x[labels == 1]), frozenset(x[labels == 2])} == {
        frozenset([0.0, 1.0, 1.3, 2.2]), frozenset([9.0, 9.6, 9.7])
    }  # fmt: skip
    assert x[medoids[0]] in (1.0, 1.3) and x[medoids[1]] == 9.6
