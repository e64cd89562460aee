"""Mixed precision: far rows of tiles in single, beside the same energy in double."""

import pickle
import re

import numpy as np
import pytest
from fixtures.samples import load
from fixtures.tolerances import MIXED, MIXED_ENERGY

import protochain as pc
from protochain.core.errors import ProtochainError
from protochain.minimisers.verdict import judge_of

SOLVENTS = ("vacuum", "obc2", "gbn2")


def pair(structure, solvent="obc2", **more):
    """The energy in mixed and in double precision."""
    given = {"solvent": solvent, "engine": "native", "accuracy": "exact", **more}
    return (pc.energy(structure, precision=each, **given) for each in ("mixed", "double"))


def rms(forces):
    return np.sqrt((forces**2).sum(axis=1).mean())


def apart(mixed, double, x):
    """RMS difference of forces; largest of a term of the energy, relative to the sum of all sizes."""
    (parts, forces), (expected, its) = mixed.parts(x), double.parts(x)
    size = sum(abs(value) for value in expected.values())
    return rms(forces - its), max(abs(parts[kind] - expected[kind]) for kind in expected) / size


@pytest.mark.parametrize("solvent", SOLVENTS)
@pytest.mark.parametrize("name", ["1l2y.pdb", "1hel.pdb"])
def test_mixed_precision_is_right_to_what_single_rounds(name, solvent):
    s = load(name)
    mixed, double = pair(s, solvent)
    off, of_energy = apart(mixed, double, s.positions)
    assert 0.0 < off < MIXED and of_energy < MIXED_ENERGY
    (said,) = re.findall(r"mixed precision.*differ by (\S+) kJ/mol/nm RMS", mixed.reason)
    assert float(said) == pytest.approx(off, rel=0.06) and "differ" not in double.reason


@pytest.mark.parametrize("solvent", SOLVENTS)
def test_far_from_the_origin_nothing_is_lost(solvent):
    s = load("1hel.pdb")
    moved = s.with_positions(s.positions + np.array([1024.0, -512.0, 256.0]))
    mixed, double = pair(moved, solvent)
    off, of_energy = apart(mixed, double, moved.positions)
    assert off < MIXED and of_energy < MIXED_ENERGY


def test_two_clusters_far_apart_feel_each_other_as_in_double():
    s = load("1hel.pdb")
    mixed, double = pair(s)
    for far in (10.0, 1e3, 1e5):
        x = s.positions.copy()
        x[1000:] += [far, 0.0, 0.0]
        off, of_energy = apart(mixed, double, x)
        # The bond between them is stretched to thousands of nm: its force is not rounded, its place is.
        assert off < MIXED and of_energy < MIXED_ENERGY


def test_bits_are_those_of_one_thread_on_any_number():
    s = load("1hel.pdb")
    one, two = (pc.energy(s, precision="mixed", threads=n).parts(s.positions) for n in (1, 2))
    assert one[0] == two[0] and np.array_equal(one[1], two[1])


def test_rigid_groups_and_a_tree_keep_the_precision():
    s = load("1hel.pdb")
    mixed, double = pair(s)
    chain = pc.build_chain(s)
    given = chain.rigid_groups, s.positions
    off = rms(
        pc.pull_back(chain, pc.pose(chain, chain.q0), mixed.without_constants(*given)(s.positions)[1])[None]
        - pc.pull_back(chain, pc.pose(chain, chain.q0), double(s.positions)[1])[None]
    )
    assert mixed.without_constants(*given).mixed
    assert mixed.without_constants(*given).errors == mixed.errors != ()
    assert 0.0 < off < 10.0 * MIXED * np.sqrt(s.n_atoms)
    large = load("1ake.pdb.gz")
    tree = pc.energy(large, accuracy=2e-3, precision="mixed")
    assert tree.opening is not None and tree.mixed and tree.errors[0] <= 2e-3
    off = rms(tree(large.positions)[1] - tree.exact(large.positions)[1])
    assert off == pytest.approx(tree.errors[0], rel=1e-6)
    its = pc.energy(large, accuracy=2e-3).by_tree(tree.opening)(large.positions)[1]
    assert 0.0 < rms(tree(large.positions)[1] - its) < MIXED


@pytest.mark.parametrize("solvent", SOLVENTS)
def test_with_a_cutoff_all_is_in_double(solvent):
    s = load("1hel.pdb")
    mixed, double = pair(s, solvent, accuracy="auto", cutoff=1.2)
    assert mixed.parts(s.positions)[0] == double.parts(s.positions)[0]
    assert np.array_equal(mixed(s.positions)[1], double(s.positions)[1])


def test_what_judges_is_in_double():
    s = load("1l2y.pdb")
    mixed, double = pair(s)
    assert not mixed.is_exact and double.is_exact
    for its in (mixed.exact, mixed.reference):
        assert not its.mixed and np.array_equal(its(s.positions)[1], double(s.positions)[1])
    assert np.array_equal(mixed.born_radii(s.positions), double.born_radii(s.positions))
    again = pickle.loads(pickle.dumps(mixed))
    assert again.mixed and np.array_equal(again(s.positions)[1], mixed(s.positions)[1])


@pytest.mark.parametrize("method", ["cartesian", "hybrid"])
def test_minimisation_ends_where_double_precision_says(method):
    s = load("1l2y.pdb")
    mixed, double = pair(s)
    tolerance = 1e-4  # Less than single precision rounds: double has the last steps.
    done = pc.minimise(s, mixed, method, tolerance=tolerance)
    assert done.status.value == "converged"
    forces = double(done.structure.positions)[1]
    assert np.sqrt((forces**2).mean()) <= tolerance * (1.0 + 1e-6)
    assert "mixed" not in judge_of(mixed)


def test_relaxation_in_mixed_precision_is_judged_in_double():
    s = load("1l2y.pdb")
    done = pc.relax(s, precision="mixed")
    assert done.judge == pc.relax(s).judge and "mixed" in done.energy_function.reason
    (_, double) = pair(s)
    assert done.energy_end == pytest.approx(double(done.structure.positions)[0], rel=1e-9)


def test_what_cannot_be_mixed_is_said():
    s = load("1l2y.pdb")
    with pytest.raises(ProtochainError, match=r"precision 'half' is not known; choose from double, mixed"):
        pc.energy(s, precision="half")
    with pytest.raises(ProtochainError, match=r"precision=\"mixed\" is of the native engine"):
        pc.energy(s, engine="openmm", precision="mixed")


def test_a_run_goes_on_in_the_precision_in_which_it_began(tmp_path):
    s = load("ala10.pdb")
    mixed, double = pair(s, "vacuum")
    its = {"method": "lbfgs", "max_evaluations": 9}
    pc.minimise(s, double, **its, checkpoint=tmp_path / "run.npz")
    with pytest.raises(ProtochainError, match="double_precision True, not False"):
        pc.minimise(s, mixed, **its, resume=tmp_path / "run.npz")
    pc.simulate(s, double, n_steps=20, every=10, output=tmp_path / "run")
    with pytest.raises(ProtochainError, match="double_precision True, not False"):
        pc.simulate(s, mixed, n_steps=40, every=10, output=tmp_path / "run", resume=True)
