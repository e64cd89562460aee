"""Partial charges of a molecule: by a rule, or of a file."""

from pathlib import Path

import numpy as np

from protochain.core.arrays import Floats
from protochain.core.errors import Argument, ForceFieldError
from protochain.core.optional_libraries import library
from protochain.ligands import nagl
from protochain.ligands.molecule import Molecule, quietly, to_rdkit
from protochain.ligands.sources import read, text_of

_ROUNDING = 0.01  # e. Sums of charges in files are off by their rounded digits.


def by_rule(molecule: Molecule, rule: str) -> Floats:
    """Charges by ``nagl``, ``mmff94`` (Halgren, J. Comput. Chem. 17:490, 1996) or ``gasteiger``."""
    if rule == "nagl":
        return _correct_sum(molecule, nagl.charges(molecule), rule)
    chem, mol = library("rdkit.Chem.AllChem"), to_rdkit(molecule)
    if rule == "mmff94":
        properties = quietly(chem.MMFFGetMoleculeProperties, mol)
        values = [properties.GetMMFFPartialCharge(i) for i in range(molecule.n_atoms)] if properties else []
    else:
        chem.ComputeGasteigerCharges(mol)
        values = [atom.GetDoubleProp("_GasteigerCharge") for atom in mol.GetAtoms()]
    if not values or not np.isfinite(values).all():
        raise ForceFieldError(
            f"{molecule.source}: {rule} has no charges for one of its atoms; give a file of them as ",
            Argument("charges"),
        )
    return _correct_sum(molecule, np.array(values), rule)


def from_file(molecule: Molecule, path: Path) -> Floats:
    """Charges of a MOL2 file, in the order of the atoms, or of lines with name and charge."""
    lines = text_of(path).splitlines()
    in_order = path.suffix.lower() == ".mol2"
    rows = _of_mol2(lines) if in_order else [line.split() for line in lines if line.strip()]
    try:
        entries = [(name, float(charge)) for name, charge in rows]
    except ValueError:
        raise ForceFieldError(f"{path}: give lines of an atom's name and its charge") from None
    charge_of = dict(entries)
    if in_order and np.array_equal(read(path).elements, molecule.elements):
        values = [charge for _, charge in entries]
    elif len(entries) == len(charge_of) == molecule.n_atoms and charge_of.keys() == set(molecule.names):
        values = [charge_of[name] for name in molecule.names]
    else:
        missing = next((name for name in molecule.names if name not in charge_of), "each atom once")
        raise ForceFieldError(
            f"{path}: has {len(entries)} charges for the {molecule.n_atoms} atoms of {molecule.source}; "
            f"give also {missing}"
        )
    return _correct_sum(molecule, np.array(values), str(path))


def _of_mol2(lines: list[str]) -> list[list[str]]:
    """Name and charge of each atom."""
    start = next((i for i, line in enumerate(lines) if line.startswith("@<TRIPOS>ATOM")), len(lines)) + 1
    end = next((i for i in range(start, len(lines)) if lines[i].startswith("@")), len(lines))
    fields = [line.split() for line in lines[start:end] if line.strip()]
    return [[row[1], row[8]] if len(row) > 8 else row for row in fields]


def _correct_sum(molecule: Molecule, charges: Floats, source: str) -> Floats:
    """Charges whose sum is the formal charge. The rounding error is spread over all atoms."""
    difference = molecule.charge - float(charges.sum())
    if not abs(difference) <= _ROUNDING:
        raise ForceFieldError(
            f"{source}: charges sum to {charges.sum():g}, not to {molecule.charge}, the formal charge of "
            f"{molecule.source}; give its charges as ", Argument("charges"),
        )  # fmt: skip
    return charges + difference / len(charges)
