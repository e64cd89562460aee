"""Terms from the templates of a force field against terms of the System that OpenMM builds."""

from dataclasses import fields, is_dataclass

import numpy as np
import pytest
from fixtures.samples import load, shared
from openmm import app

import protochain as pc
from protochain.energies import elements, factory
from protochain.energies.native.terms import compile_system


def assert_equal(first, second):
    """Compare values with all arrays and mappings in them, to the bit."""
    assert type(first) is type(second)
    if is_dataclass(first):
        for field in fields(first):
            assert_equal(getattr(first, field.name), getattr(second, field.name))
    elif isinstance(first, dict):
        assert [*first] == [*second]
        for key in first:
            assert_equal(first[key], second[key])
    elif isinstance(first, np.ndarray):
        assert first.dtype == second.dtype
        assert first.shape == second.shape
        assert first.tobytes() == second.tobytes()
    else:
        assert first == second


@pytest.mark.parametrize(
    ("name", "forcefield", "solvent"),
    [
        ("3i40.pdb", "amber14", "obc2"),  # Disulfides between chains.
        ("5awl.pdb", "amber99sbildn", "obc2"),
        ("1ejg.pdb", "amber99sb", "vacuum"),
        ("aaqaa3_capped.pdb", "amber14", "obc2"),
        ("5vav_cyclic.pdb", "amber14", "vacuum"),
    ],
)
def test_terms_of_templates_equal_terms_of_the_system(name, forcefield, solvent):
    path = shared(name) if "_" in name else None
    structure = pc.load(path, keep="none") if path else load(name)
    energy = pc.energy(structure, forcefield, solvent, engine="native")
    built = factory.build_system(structure, forcefield, solvent)
    assert_equal(energy.terms, compile_system(built))
    assert energy.fingerprint == pc.energy(structure, system=built).fingerprint


def test_a_minimisation_builds_no_system(monkeypatch):
    structure = load("ala10.pdb")
    expected = pc.energy(structure, system=factory.build_system(structure))(structure.positions)

    def refuse(*arguments):
        raise AssertionError

    monkeypatch.setattr(factory, "build_system", refuse)
    energy = pc.energy(structure)
    value, forces = energy(structure.positions)
    assert value == expected[0]
    assert forces.tobytes() == expected[1].tobytes()
    assert pc.minimise(structure, energy).status == "converged"
    with pytest.raises(AssertionError):
        _ = energy.system


def test_errors_are_reported_as_of_the_system():
    structure = pc.load(shared("1as5_conotoxin.cif"), keep="none")
    with pytest.raises(pc.ProtochainError, match="does not fit"):
        pc.energy(structure, "amber99sb")


@pytest.mark.parametrize(
    ("name", "end", "base", "charge"), [("CYS", "SG", "CYS", 0), ("LYS", "NZ", "LYS", 1)]
)
def test_a_residue_with_a_bond_to_a_kept_molecule_is_of_the_form_with_most_hydrogens(name, end, base, charge):
    """Its charge is that of the form with the hydrogen in place of the bond: CYS, not CYM."""
    field = app.ForceField("amber14/protein.ff14SB.xml")
    template = field._templates[base]
    topology, atoms = app.Topology(), {}
    residue = topology.addResidue(name, topology.addChain())
    lost = next(a.name for a in reversed(template.atoms) if a.name.startswith("H" + end[1]))
    for atom in (a for a in template.atoms if a.name != lost):
        atoms[atom.name] = topology.addAtom(atom.name, atom.element, residue)
    for i, j in template.bonds:
        names = template.atoms[i].name, template.atoms[j].name
        if lost not in names:
            topology.addBond(*(atoms[end] for end in names))
    made = field._templates[elements._linked_template(field, residue, [atoms[end].index])]
    assert made.name.startswith(f"{base}-linked-") and len(made.atoms) == len(template.atoms) - 1
    assert sum(a.parameters["charge"] for a in made.atoms) == pytest.approx(charge, abs=1e-9)
