"""Ions of one atom: element and charge by name, parameters by both."""

import gemmi
import numpy as np
import openmm
import pytest
from fixtures.components import read_columns
from fixtures.samples import STRUCTURES

import protochain as pc
from protochain.energies.factory import build_system
from protochain.structure.formats import ions
from protochain.structure.molecule.repairs import Reason

APART = (40.0, 40.0, 40.0)
"""Angstrom: a place that no atom of the peptide coordinates."""


def with_ion(tmp_path, residue: str, atom: str, element: str = "  ", charge: str = ""):
    """Decaalanine, without a column of elements where the ion has none, and an ion."""
    width = 80 if element.strip() else 76
    lines = [
        line[:width].rstrip()
        for line in (STRUCTURES / "ala10.pdb").read_text().splitlines()
        if line[:4] == "ATOM"
    ]
    lines.append("HETATM 9001 {:>4s} {:>3s} A 201    {:8.3f}{:8.3f}{:8.3f}".format(atom, residue, *APART))
    lines[-1] += f"  1.00 20.00          {element:>2s}{charge}"
    path = tmp_path / "ion.pdb"
    path.write_text("\n".join([*lines, "END"]))
    return path


def parameters(structure, forcefield="amber14"):
    """Charge (e), sigma (nm) and depth (kJ/mol) of the last atom."""
    system = build_system(structure, forcefield)
    (force,) = (each for each in system.getForces() if isinstance(each, openmm.NonbondedForce))
    return [value._value for value in force.getParticleParameters(structure.n_atoms - 1)]


@pytest.mark.parametrize(
    ("residue", "atom", "element", "charge"),
    [
        ("SOD", "SOD", "Na", 1), ("CLA", "CLA", "Cl", -1), ("ZN2", "ZN", "Zn", 2), ("CA", "CA", "Ca", 2),
        ("CD", "CD", "Cd", 2), ("CL-", "CL-", "Cl", -1), ("ION", "K", "K", 1),
    ],
)  # fmt: skip
def test_names_of_programs_say_the_element_where_no_column_does(tmp_path, residue, atom, element, charge):
    s = pc.load(with_ion(tmp_path, residue, atom), keep="all")
    assert (s.atom_element[-1], s.formal_charge[-1]) == (element, charge)


@pytest.mark.parametrize(
    ("residue", "element", "charge"),
    [
        ("CU1", "Cu", 1), ("3CO", "Co", 3), ("FE2", "Fe", 2), ("EU", "Eu", 2), ("BRO", "Br", 0),
    ],
)  # fmt: skip
def test_charges_are_those_of_components_and_of_the_energy(tmp_path, residue, element, charge):
    s = pc.load(with_ion(tmp_path, residue, element.upper(), element.upper()), keep="all")
    assert (s.atom_element[-1], s.formal_charge[-1]) == (element, charge)
    assert parameters(s)[0] == charge


def test_a_force_field_without_the_ion_has_it_by_element(tmp_path):
    s = pc.load(with_ion(tmp_path, "FE2", "FE", "FE"), keep="all")
    assert parameters(s, "charmm36")[0] == 2


def test_the_table_is_that_of_the_chemical_component_dictionary():
    of, element, charge = read_columns("chem_comp_atom", "comp_id", "type_symbol", "charge")
    chosen = np.flatnonzero(np.isin(of, [*ions._ARCHIVE]))
    rows = zip(of[chosen], element[chosen], charge[chosen], strict=True)
    assert {str(name): (str(z).capitalize(), int(q)) for name, z, q in rows} == ions._ARCHIVE
    assert len(chosen) == len(ions._ARCHIVE)


@pytest.mark.parametrize(
    ("residue", "element", "sigma", "depth"),
    # Na+, Joung and Cheatham; Zn2+, Fe3+ and Fe2+ of Li, Merz and others: OpenMM's amber14/tip3p.xml.
    [("NA", "Na", 0.24393, 0.36585), ("FE", "Fe", 0.25711, 0.09989), ("CU1", "Cu", 0.21399, 0.00470)],
)  # fmt: skip
def test_radii_are_those_of_the_ion_of_that_charge(tmp_path, residue, element, sigma, depth):
    s = pc.load(with_ion(tmp_path, residue, element.upper(), element.upper()), keep="all")
    assert parameters(s)[1:] == pytest.approx([sigma, depth], abs=1e-5)


def test_a_charge_in_the_file_stays_and_an_unknown_one_is_named(tmp_path):
    s = pc.load(with_ion(tmp_path, "FE", "FE", "FE", "2+"), keep="all")
    assert s.formal_charge[-1] == 2 and parameters(s)[1] == pytest.approx(0.24108, abs=1e-5)
    s = pc.load(with_ion(tmp_path, "XXQ", "NB", "NB"), keep="all")
    assert not s.kept.any() and [loss.why for loss in s.losses] == [Reason.CHARGE]
    assert pc.load(with_ion(tmp_path, "XXQ", "NB", "NB", "3+"), keep="all").formal_charge[-1] == 3


def test_dummies_of_a_membrane_are_never_kept(tmp_path):
    s = pc.load(with_ion(tmp_path, "DUM", "N", "N"), keep="all")
    assert not s.kept.any() and [loss.why for loss in s.losses] == [Reason.DUMMY]


def test_an_amino_acid_alone_is_no_ion():
    structure = gemmi.read_pdb_string(
        "ATOM      1  CA  ALA A   1       0.000   0.000   0.000  1.00 20.00\n"
        "ATOM      2  P     U B   1       9.000   0.000   0.000  1.00 20.00\nEND\n"
    )
    ions.name_ions(structure)
    found = [(place.atom.element.name, place.atom.charge) for place in structure[0].all()]
    assert found == [("C", 0), ("P", 0)]
    assert np.isfinite([place.atom.pos.x for place in structure[0].all()]).all()
