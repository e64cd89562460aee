"""Many starts: which chains are minimised, what is kept, and what is said of all together."""

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from fixtures.molecules import crowded
from fixtures.samples import chain, energy, load

import protochain as pc
from protochain.chains.chain import pose
from protochain.chains.contacts import overlaps
from protochain.chains.frame import Frame
from protochain.minimisers import Starts, Status, starts
from protochain.minimisers.spaces import Torsions
from protochain.minimisers.starts import _superpose_on_start, perturb_dihedrals, separate_overlaps


@dataclass
class Made:
    """A solution as the starts see it."""

    energy: float
    x: np.ndarray
    start_energy: float = 0.0
    n_evaluations: int = 10
    seconds: float = 1.5
    status: Status = Status.CONVERGED
    frame: Any = None
    ca_rmsd_as_filed_angstrom: float = 0.0
    ca_rmsd_angstrom: float = 0.0
    frames: Any = ()

    @property
    def start(self):
        return SimpleNamespace(energy=self.start_energy)

    @property
    def end(self):
        return SimpleNamespace(energy=self.energy)


def breathed(share):
    """Positions with the C-alpha atoms moved apart, and their RMSD in angstrom."""
    s = load("ala10.pdb")
    alpha = s.alpha_carbons
    middle = s.positions[alpha] - s.positions[alpha].mean(axis=0)
    x = s.positions.copy()
    x[alpha] += share * middle
    return x, 10.0 * share * np.sqrt(np.mean(np.sum(middle**2, axis=1)))


def made():
    c, ends = chain("ala10.pdb"), (-10.0, -12.0, -11.0, -12.0, -11.5)
    solutions = []
    for k, end in enumerate(ends):
        status = Status.BUDGET if k == 2 else Status.CONVERGED
        x = breathed(0.01 * k)[0] + [1.0, 2.0, 3.0]
        solutions.append(Made(end, x, 100.0 + k, 10 + k, 1.0 + k, status, Frame(c.structure), 5.0 + k))
    return Starts(c, tuple(solutions))


@pytest.mark.parametrize("status", [Status.INVERTED, Status.ISOMERISED])
def test_the_best_is_the_first_of_lowest_energy(status):
    found = made()
    assert found.best is found.solutions[1]
    solutions = [replace(s, status=status) if s.energy == -12.0 else s for s in found.solutions]
    assert replace(found, solutions=tuple(solutions)).best is solutions[4]
    inverted = tuple(replace(s, status=status) for s in solutions)
    assert replace(found, solutions=inverted).best is inverted[1]


def test_the_records_of_all_starts():
    found = made()
    rows = found.records()
    rmsds = [row.pop("ca_rmsd_angstrom") for row in rows]
    assert rmsds == pytest.approx([breathed(0.01 * k)[1] for k in range(5)], abs=1e-6)
    assert rows[2] == {
        "start": 2, "energy_start_kj_mol": 102.0, "energy_end_reference_kj_mol": -11.0, "evaluations": 12,
        "seconds": 3.0, "status": "budget",
    }  # fmt: skip
    assert [row["start"] for row in rows] == list(range(5)) and type(rows[0]["status"]) is str
    assert found.table.to_dict("records") == found.records() and len(found.table) == 5


def test_the_summary_has_quartiles_and_the_number_near_the_lowest():
    # In order: -12, -12, -11.5, -11, -10. At -11 it is 1 kJ/mol above the lowest, and not within.
    assert made().summary() == {
        "n_starts": 5, "energy_lowest_kj_mol": -12.0, "energy_first_quartile_kj_mol": -12.0,
        "energy_median_kj_mol": -11.5, "energy_third_quartile_kj_mol": -11.0, "energy_highest_kj_mol": -10.0,
        "n_within_1_kj_mol_of_lowest": 3,
    }  # fmt: skip
    assert repr(made()) == "<5 starts: -12.00, median -11.50, highest -10.00 kJ/mol>"


def test_entries_over_all_starts_are_sums_and_those_of_the_best():
    found = made()
    assert found.overall() == {
        "energy_start_kj_mol": 100.0, "ca_rmsd_angstrom": found.records()[1]["ca_rmsd_angstrom"],
        "ca_rmsd_as_filed_angstrom": 6.0, "evaluations": 60, "seconds": 15.0,
        "starts_summary": found.summary(), "starts": found.records(),
    }  # fmt: skip


@pytest.fixture
def given(monkeypatch):
    """Minimisations that end as told, and what they were given."""
    ends, calls = [], []

    def minimise(start, energy, method, *, seed, **settings):
        calls.append((start, energy, method, seed, settings))
        return Made(*ends[len(calls) - 1])

    monkeypatch.setattr(starts, "minimise", minimise)
    monkeypatch.setattr(starts, "_superpose_on_start", lambda solution, chain: replace(solution, frame=chain))
    monkeypatch.setattr(
        starts, "perturb_dihedrals", lambda here, spread, random: (here, spread, random.normal())
    )
    return SimpleNamespace(ends=ends, calls=calls)


def test_independent_starts_are_perturbed_from_the_first_by_streams_of_their_own(given):
    given.ends += [(-1.0, None), (-3.0, None), (-2.0, None)]
    c, e, seen = chain("ala10.pdb"), energy("ala10.pdb"), []
    found = pc.explore(c, e, "kcm", 3, seed=7, spread=0.3, each=lambda *a: seen.append(a), tolerance=2.0)
    drawn = [np.random.default_rng([7, k]).normal() for k in range(3)]
    assert [call[0] for call in given.calls] == [c, (c, 0.3, drawn[1]), (c, 0.3, drawn[2])]
    assert all(call[1:] == (e, "kcm", 7, {"tolerance": 2.0}) for call in given.calls)
    assert seen == list(enumerate(found.solutions)) and found.chain is c
    assert [s.energy for s in found.solutions] == [-1.0, -3.0, -2.0]
    # Each is brought home to the chain given.
    assert all(solution.frame is c for solution in found.solutions)


def test_an_interrupt_leaves_out_the_starts_that_follow(given):
    given.ends += [(-1.0, None), (-3.0, None, 0.0, 1, 1.0, Status.INTERRUPTED)]
    found = pc.explore(chain("ala10.pdb"), energy("ala10.pdb"), n_starts=5)
    assert len(found.solutions) == len(given.calls) == 2
    assert given.calls[0][2:4] == ("cartesian", 0) and given.calls[1][0][1] == 0.2


def test_a_solution_from_a_perturbed_start_is_superposed_on_the_structure_given():
    c = chain("ala10.pdb")
    s, (x, size) = c.structure, breathed(0.02)
    turn = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    away = s.with_positions(s.positions @ turn + [1.0, 2.0, 3.0])
    frames = np.array([away.positions, x @ turn + [1.0, 2.0, 3.0]], dtype=np.float32)
    gone = Made(-1.0, x @ turn + [1.0, 2.0, 3.0], frame=Frame(away), frames=frames)
    home = _superpose_on_start(gone, c)
    assert home.x == pytest.approx(x, abs=1e-12) and home.frame.start is s and home.energy == -1.0
    assert home.ca_rmsd_angstrom == pytest.approx(size, abs=1e-9)
    assert home.frames == pytest.approx(np.array([s.positions, x]), abs=1e-6)
    assert home.frames.dtype == np.float32 and not home.frames.flags.writeable
    # What is held stays where it is; what started from the structure given is at home.
    held = _superpose_on_start(replace(gone, frame=Frame(away, "a fixed root")), c)
    assert held.x is gone.x and np.array_equal(held.frames, frames)
    assert held.ca_rmsd_angstrom == pytest.approx(size, abs=1e-9)
    assert held.frame.start is s and held.frame.held_by == "a fixed root"
    first = Made(-1.0, gone.x, frame=Frame(s))
    assert _superpose_on_start(first, c) is first


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"n_starts": 0}, "n_starts 0: give at least 1"),
        ({"seed": -1}, "seed -1: give 0 or more"),
        ({"spread": 0.0}, "spread 0 rad: give an angle above 0"),
        ({"spread": np.inf}, "spread inf rad: give an angle above 0"),
        ({"restraints": 3.0}, "restraints and max_rmsd refer to each start's own structure; use one start"),
        ({"max_rmsd": 3.0}, "restraints and max_rmsd refer to each start's own structure; use one start"),
    ],
)
def test_settings_that_make_no_sense_are_refused(options, said):
    with pytest.raises(pc.ProtochainError) as refusal:
        pc.explore(None, **options)
    assert str(refusal.value) == said


def test_a_perturbation_turns_every_dihedral_and_no_angle():
    c = pc.build_chain(load("ala10.pdb"), "phi psi angles", "free")
    moved = perturb_dihedrals(c, 1e-3, np.random.default_rng(3))
    dihedral = c.hinge_body[[not hinge.is_angle for hinge in c.hinges]]
    q = c.q0.copy()
    q[c.tree.q_start[dihedral]] += np.random.default_rng(3).normal(scale=1e-3, size=len(dihedral))
    # Nothing overlaps, and soft repulsion moves little else.
    assert 0 < len(dihedral) < c.n_hinges and np.abs(moved.q0 - q).max() < 2e-4
    assert moved.structure.positions == pytest.approx(pose(c, moved.q0).x, abs=1e-12)
    assert moved.tree is c.tree


def test_parting_moves_the_same_bodies_until_nothing_overlaps():
    c = crowded()
    assert overlaps(c.structure, c.structure.positions)
    moved = separate_overlaps(c)
    assert not overlaps(c.structure, moved.structure.positions) and moved.tree is c.tree
    assert Torsions(moved).start(moved.structure.positions) is moved.q0
