"""What people do next with what they have: frames in memory, other energies, methods of their own, lists."""

from importlib.metadata import version

import numpy as np
import pytest
from fixtures.command_line import run
from fixtures.samples import STRUCTURES, chain, load

import protochain as pc
from protochain.minimisers import Descent, Direction, Euclidean, Fixed
from protochain.structure.formats.frames import open_frames


@pytest.fixture(scope="module")
def simulated():
    c = chain("ala10.pdb")
    return pc.simulate(c, pc.energy(c.structure, solvent="vacuum", threads=1), n_steps=30, every=10, seed=1)


def test_the_version_is_told():
    assert pc.__version__ == version("protochain")
    with pytest.raises(AttributeError):
        _ = pc.no_such_name


def test_a_simulation_has_its_frames(simulated, tmp_path):
    m = simulated
    assert m.frames.shape == (len(m.trace), 103, 3) == (4, 103, 3)
    assert np.allclose(m.frames[-1], m.x, atol=1e-6)
    in_nm, in_angstrom = m.to_mdtraj().xyz, m.to_mdanalysis().trajectory
    assert np.array_equal(in_nm, m.frames)
    assert len(in_angstrom) == 4 and np.allclose(in_angstrom[2].positions, 10.0 * m.frames[2], atol=1e-4)
    assert len(pc.to_mdanalysis(m).trajectory) == 1
    c = chain("ala10.pdb")
    e = pc.energy(c.structure, solvent="vacuum", threads=1)
    written = pc.simulate(c, e, n_steps=30, every=10, seed=1, output=tmp_path / "run")
    assert written.stored_frames == () and np.allclose(written.frames, m.frames, atol=1e-5)


@pytest.mark.parametrize(
    ("asked", "chosen"),
    [("0,2,5", [0, 2, 5]), ([5, 0], [5, 0]), ("0:4:2,-1", [0, 2, 5]), ("2", [2]), ("1:3", [1, 2])],
)
def test_frames_are_chosen_by_lists(asked, chosen):
    x = np.arange(6.0)[:, None, None] * np.ones((6, 2, 3))
    some = open_frames(x, asked)
    assert [frame.index for frame in some] == chosen and len(some) == len(chosen)
    assert [frame.x[0, 0] for frame in some] == chosen
    assert [frame.index for frame in some.without_first(1)] == chosen[1:]


@pytest.mark.parametrize("asked", ["0,9", "0,,2", "0,x", [], "7"])
def test_frames_that_are_not_there_are_refused(asked):
    with pytest.raises(pc.ProtochainError, match="frames"):
        open_frames(np.zeros((6, 2, 3)), asked)


def test_a_command_takes_a_list_of_frames(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    s = load("ala10.pdb")
    pc.save([s] * 4, "models.pdb")
    given = ["validate", "models.pdb", "--frames", "0,3", "--csv", "v.csv", "--workers", 1]
    assert run(*given) == 0
    lines = (tmp_path / "v.csv").read_text().splitlines()
    assert [line.split(",")[0] for line in lines[1:]] == ["0", "3"]


def test_models_that_overlap_are_to_be_relaxed_first(tmp_path, capsys):
    s = load("3i40.pdb")
    x, of_b = np.array(s.positions), s.residue_chain[s.atom_residue] == "B"
    assert run("score", STRUCTURES / "3i40.pdb") == 0 and "Relax first" not in capsys.readouterr().err
    x[of_b] += 0.5 * (x[~of_b].mean(axis=0) - x[of_b].mean(axis=0))
    pc.save(s.with_positions(x), tmp_path / "crowd.pdb")
    assert run("score", tmp_path / "crowd.pdb") == 3
    assert "Relax first, with --relax" in capsys.readouterr().err


def test_an_energy_of_ase_is_one_of_ours():
    """There and back: a calculator of our own energy gives it, and its forces."""
    pytest.importorskip("ase")
    s = load("ala10.pdb")
    own = pc.energy(s, solvent="vacuum", threads=1)
    for given in (pc.to_ase(s, own), pc.to_ase(s, own).calc):
        e = pc.energy_from(given, s)
        (value, forces), (expected, pull) = e(s.positions), own(s.positions)
        assert value == pytest.approx(expected, rel=1e-9) and np.allclose(forces, pull, rtol=1e-6, atol=1e-6)
    assert e.name.endswith("EnergyCalculator")
    r, other = (pc.minimise(chain("ala10.pdb"), each, "lbfgs", max_evaluations=8) for each in (e, own))
    assert r.start.energy == pytest.approx(other.start.energy, rel=1e-9)
    assert r.end.energy < r.start.energy


def test_xtb_gives_forces_of_its_energy():
    ase = pytest.importorskip("tblite.ase")
    s = pc.from_sequence("GG")
    e = pc.energy_from(ase.TBLite(method="GFN2-xTB", verbosity=0), s)
    forces, ends = e(s.positions)[1], []
    for step in (1e-4, -1e-4):
        x = s.positions.copy()
        x[4, 1] += step
        ends.append(e(x)[0])
    assert -(ends[0] - ends[1]) / 2e-4 == pytest.approx(forces[4, 1], rel=1e-3, abs=1.0)


class Short(Direction):
    def propose(self, problem, at, solve, memory):
        yield np.zeros(3), memory


class Nothing(Direction):
    pass


class Bare:
    refresh_every = 1


class WithBareMetric(Direction):
    metric = Bare()

    def propose(self, problem, at, solve, memory):
        yield at.torque, memory


def slope(x):
    return 0.0, np.zeros_like(x)


@pytest.mark.parametrize(
    ("made", "said"),
    [
        (
            lambda: Descent(Short(), Fixed(0.1)),
            r"direction Short: propose yields shape \(3,\), not .*\(19,\)",
        ),
        (lambda: Descent(Short, Fixed(0.1)), r"direction Short: is a class; give an object, as Short\(\)"),
        (
            lambda: Descent(Nothing(), Fixed(0.1)),
            "direction Nothing: has no propose; a Direction has propose",
        ),
        (
            lambda: Descent(WithBareMetric(), Fixed(0.1)),
            "metric Bare: has no at; a Metric has at",
        ),
        (lambda: Descent(Short(), Euclidean()), "rule Euclidean: has no init, step; a Rule has"),
        (lambda: Descent(Short(), Fixed), "rule Fixed: is a class"),
        (lambda: Bare, "method Bare: is a class"),
        (lambda: Bare(), "give a name, or an object with init and step"),
    ],
)
def test_a_method_of_ones_own_that_lacks_something_is_refused_by_name(made, said):
    with pytest.raises(pc.ProtochainError, match=said):
        pc.minimise(chain("ala10.pdb"), method=made())


@pytest.mark.parametrize(
    ("given", "said"), [(Bare, "energy Bare: is a class"), (Bare(), "give pc.energy"), (3, "give pc.energy")]
)
def test_an_energy_that_is_none_is_refused(given, said):
    with pytest.raises(pc.ProtochainError, match=said):
        pc.minimise(chain("ala10.pdb"), given)


def test_a_calculator_that_is_none_is_refused():
    pytest.importorskip("ase")
    with pytest.raises(pc.ProtochainError, match="give a calculator of ASE"):
        pc.energy_from(slope, load("ala10.pdb"))
