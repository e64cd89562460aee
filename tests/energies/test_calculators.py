"""Energies by name: the region, its terms, units, total charge and refusals."""

import pickle
import sys
from types import ModuleType

import numpy as np
import pytest
from fixtures.command_line import refusal_as_said
from fixtures.refusals import expect_refusal
from fixtures.samples import STRUCTURES
from fixtures.tolerances import BY_DIFFERENCES, SUM_OF_TERMS

import protochain as pc
from protochain.energies import calculators, requested
from protochain.energies.calculators import CALCULATORS, Calculator
from protochain.ligands.energy import terms

ase = pytest.importorskip("ase")
ase_calculators = pytest.importorskip("ase.calculators.calculator")
LennardJones = pytest.importorskip("ase.calculators.lj").LennardJones

EV = 96.48533212331
"""kJ/mol, from the exact charge and Avogadro's number."""


@pytest.fixture(scope="module")
def complexed():
    """A peptide with nicotine, charged +1, beside it."""
    return pc.load(STRUCTURES / "5awl.pdb", ligands=[STRUCTURES / "1P2Y_NCT.sdf"])


@pytest.fixture(scope="module")
def peptide():
    return pc.from_sequence("GAK")


def named(monkeypatch, build, largest=500, is_neutral=False):
    """Make ``test`` the name of a calculator of a module of this name."""
    monkeypatch.setitem(sys.modules, "of_test", ModuleType("of_test"))
    of_test = Calculator("of_test", "xtb", lambda module, charge: build(charge), largest, is_neutral)
    monkeypatch.setitem(CALCULATORS, "test", of_test)


class OfMolecule(ase_calculators.Calculator):
    """Energy of a ligand by its force field, by slow sums over all pairs, and no forces."""

    implemented_properties = ("energy", "forces")

    def __init__(self, parameters, order):
        super().__init__()
        self.parameters, self.order = parameters, order

    def calculate(self, atoms=None, properties=("energy",), system_changes=()):
        super().calculate(atoms, properties, system_changes)
        value = sum(terms(self.parameters, self.atoms.positions[self.order] / 10.0).values())
        self.results = {"energy": value / EV, "forces": np.zeros((len(self.atoms), 3))}


def shaken(s, n=3):
    rng = np.random.default_rng(1)
    return [s.positions + rng.normal(0.0, 0.003, s.positions.shape) for _ in range(n)]


def test_a_ligand_by_its_force_field_is_the_force_field(monkeypatch, complexed):
    (bound,) = complexed.ligands
    order, charges = np.argsort(np.argsort(bound.atoms)), []

    def build(charge):
        charges.append(charge)
        return OfMolecule(bound.ligand.parameters, order)

    named(monkeypatch, build)
    for solvent in ("vacuum", "obc2"):
        whole = pc.energy(complexed, solvent=solvent)
        e = pc.energy(complexed, solvent=solvent, calculator="test")
        for x in shaken(complexed):
            assert e(x)[0] == pytest.approx(whole(x)[0], abs=SUM_OF_TERMS)
            assert sum(e.parts(x)[0].values()) == pytest.approx(e(x)[0], abs=SUM_OF_TERMS)
    assert charges == [1, 1]
    assert "27 atoms" in e.reason and e.forcefield == "amber14 + test" and e.solvent == "obc2"


@pytest.mark.parametrize(
    ("forcefield", "solvent"),
    [("amber14", "obc2"), ("amber19", "gbn2"), ("charmm36", "vacuum"), ("amber99sb", "vacuum")],
)
def test_a_peptide_by_its_force_field_is_the_force_field(monkeypatch, peptide, forcefield, solvent):
    """All terms within the region are replaced: CMAP and CHARMM's forces too. The solvent remains."""
    vacuum = pc.energy(peptide, forcefield, "vacuum")
    named(monkeypatch, lambda charge: pc.to_ase(peptide, vacuum).calc)
    e, whole = (pc.energy(peptide, forcefield, solvent, calculator=name) for name in ("test", None))
    for x in shaken(peptide):
        (value, forces), (expected, pull) = e(x), whole(x)
        assert value == pytest.approx(expected, abs=SUM_OF_TERMS)
        assert np.allclose(forces, pull, atol=1e-5)
    if solvent == "vacuum":
        assert sum(e.rest.parts(x)[0].values()) == pytest.approx(0.0, abs=SUM_OF_TERMS)


def test_units_and_forces_are_those_of_ase(monkeypatch, complexed):
    named(monkeypatch, lambda charge: LennardJones(sigma=1.2, epsilon=0.003, rc=20.0))
    e = pc.energy(complexed, solvent="vacuum", calculator="test")
    region = complexed.ligands[0].atoms
    atoms = ase.Atoms(complexed.atom_element[region].tolist(), complexed.positions[region] * 10.0)
    atoms.calc = LennardJones(sigma=1.2, epsilon=0.003, rc=20.0)
    x = complexed.positions
    assert e.parts(x)[0]["test"] == pytest.approx(EV * atoms.get_potential_energy(), rel=1e-8)
    forces = e(x)[1]
    for atom in (int(region[0]), int(region[-1]), 3):
        for axis in range(3):
            step = np.zeros_like(x)
            step[atom, axis] = 1e-5
            slope = (e(x + step)[0] - e(x - step)[0]) / 2e-5
            assert -slope == pytest.approx(forces[atom, axis], rel=BY_DIFFERENCES, abs=1e-2)


def recorder(calls):
    def build(*arguments, **keywords):
        calls.append((arguments, keywords))
        return LennardJones()

    return build


def test_potentials_are_built_with_the_total_charge(monkeypatch, complexed, peptide):
    calls = []
    for module, function in (
        ("tblite.ase", "TBLite"),
        ("aimnet.calculators", "AIMNet2ASE"),
        ("mace.calculators", "mace_off"),
    ):
        parent = module.partition(".")[0]
        fake = ModuleType(module)
        setattr(fake, function, recorder(calls))
        monkeypatch.setitem(sys.modules, parent, ModuleType(parent))
        monkeypatch.setitem(sys.modules, module, fake)
    for name in ("xtb", "aimnet2"):
        pc.energy(complexed, calculator=name)
    pc.energy(pc.from_sequence("GAG"), calculator="mace-off")
    assert calls == [
        ((), {"method": "GFN2-xTB", "charge": 1, "guess": "eeq", "verbosity": 0}),
        (("aimnet2",), {"charge": 1}),
        (("medium",), {"default_dtype": "float64"}),
    ]
    with pytest.raises(pc.ProtochainError, match=r"mace-off computes neutral .* charge \+1; give xtb"):
        pc.energy(peptide, calculator="mace-off")


@pytest.mark.parametrize(("name", "module"), [("xtb", "tblite"), ("aimnet2", "aimnet"), ("mace-off", "mace")])
def test_an_absent_library_is_refused_with_its_install_command(monkeypatch, peptide, name, module):
    monkeypatch.setitem(sys.modules, module, None)
    for child in [each for each in sys.modules if each.startswith(f"{module}.")]:
        monkeypatch.setitem(sys.modules, child, None)
    expected = f'{module} is not installed: pip install "protochain[{name}]"'
    with pytest.raises(pc.ProtochainError) as refused:
        pc.minimise(peptide, name)  # Its charge is not the first reason.
    assert str(refused.value) == expected
    assert refusal_as_said("minimise", STRUCTURES / "ala10.pdb", "-o", "-", "--energy", name) == expected


def test_refused_in_one_line(monkeypatch, peptide, complexed):
    with expect_refusal("calculator", match="aimnet2"):
        pc.energy(peptide, calculator="gfn")
    said = refusal_as_said("minimise", STRUCTURES / "ala10.pdb", "-o", "-", "--energy", "nonbonded")
    assert said.startswith("--energy nonbonded: give one of xtb") and said.endswith("--terms")
    named(monkeypatch, lambda charge: LennardJones(), largest=20)
    with pytest.raises(pc.ProtochainError, match="test computes up to 20 atoms, not 42; give a peptide"):
        pc.energy(peptide, calculator="test")
    with pytest.raises(pc.ProtochainError, match="up to 20 atoms, not 27; give a smaller one"):
        pc.energy(complexed, calculator="test")
    ends = complexed.ligands[0].atoms[0], 0
    linked = np.vstack([complexed.bonds, [sorted(map(int, ends))]])

    class Linked:
        name, ligands, n_atoms, bonds = "linked", complexed.ligands, complexed.n_atoms, linked
        describe = complexed.describe

    with pytest.raises(pc.ProtochainError, match="has a bond to the ligand, and xtb computes"):
        calculators.region_of(Linked(), "xtb")


class Failing(LennardJones):
    """Fails if two atoms come near one another, as an SCF does."""

    def calculate(self, *arguments, **keywords):
        super().calculate(*arguments, **keywords)
        if self.atoms.get_all_distances()[np.triu_indices(len(self.atoms), 1)].min() < 0.5:
            raise ase_calculators.CalculationFailed("no convergence")


def test_a_failure_is_no_energy_and_a_run_steps_back(monkeypatch, peptide):
    named(monkeypatch, lambda charge: Failing(sigma=1.0, epsilon=0.05, rc=20.0))
    e = pc.energy(peptide, solvent="vacuum", calculator="test")
    near = peptide.positions.copy()
    near[1] = near[0] + 1e-3
    value, forces = e(near)
    assert np.isnan(value) and np.isnan(forces).all()
    perturbed = peptide.with_positions(shaken(peptide)[0])
    r = pc.minimise(perturbed, e, "cartesian", max_evaluations=5)
    assert r.end.energy < r.start.energy


def test_results_keep_the_calculator(monkeypatch, peptide):
    named(monkeypatch, lambda charge: LennardJones(sigma=1.0, epsilon=0.05, rc=20.0))
    r = pc.minimise(peptide, "test", "lbfgs", max_evaluations=2)
    again = pc.energy(r, solvent="vacuum")
    assert (again.name, again.solvent) == ("test", "vacuum")
    clone = pickle.loads(pickle.dumps(again))
    assert clone(r.x)[0] == again(r.x)[0] and clone.fingerprint == again.fingerprint
    assert r.energy_function.fingerprint != pc.energy(peptide).fingerprint
    relaxed = pc.relax(r, max_iterations=1)
    assert relaxed.energy_start == pytest.approx(r.energy_function(r.x)[0], rel=1e-9)


def test_xtb_of_a_ligand_is_minimised(complexed):
    """Against tblite itself, without our conversion."""
    tblite = pytest.importorskip("tblite.interface")
    e = pc.energy(complexed, solvent="vacuum", calculator="xtb")
    region = complexed.ligands[0].atoms
    numbers = ase.Atoms(complexed.atom_element[region].tolist()).numbers
    bohr = complexed.positions[region] / 0.0529177210903
    single = tblite.Calculator("GFN2-xTB", numbers, bohr, charge=1.0)
    single.set("verbosity", 0)
    hartree = single.singlepoint()["energy"]
    assert e.parts(complexed.positions)[0]["xtb"] == pytest.approx(2625.4996394799 * hartree, rel=1e-8)
    r = pc.minimise(complexed, e, "lbfgs", max_evaluations=5)
    assert r.end.energy < r.start.energy


def test_a_named_calculator_gets_the_arguments_of_its_caller(monkeypatch, peptide):
    calls, by_force_field = [], pc.energy(peptide, solvent="vacuum")
    monkeypatch.setattr(requested, "energy", lambda _, **arguments: calls.append(arguments) or by_force_field)
    assert requested.as_energy("xtb", peptide, solvent="vacuum", threads=1) is by_force_field
    assert calls == [{"calculator": "xtb", "solvent": "vacuum", "threads": 1}]
