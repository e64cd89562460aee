"""Bond lengths and angles far from the values of the force field: strain, and bonds of a wrong length.

Strain is of the protein's heavy atoms. Wrong lengths are of bonds of all molecules to all elements but
metals, hydrogen included. The reference is the equilibrium length of Amber ff14SB, of its phosphates, and
of OL15 and OL3 for nucleotides. Bonds of ligands and of residues without template have their own parameters.
All other bonds are compared with the sum of covalent radii (Cordero et al., Dalton Trans. 2832, 2008).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path
from xml.etree import ElementTree

import gemmi
import numpy as np
from numpy.typing import NDArray

from protochain.core.arrays import Floats, Integers, Value, angle, distance, read_only
from protochain.core.graph import bond_angles
from protochain.core.settings import document_fields
from protochain.core.units import ANGSTROM_PER_NM
from protochain.structure.molecule import templates
from protochain.structure.molecule.model import Structure, per_structure
from protochain.structure.molecule.residues import NUCLEOTIDES
from protochain.validation.layout import positions

BEYOND = 4.0  # Standard deviations.
_THERMAL = 8.314462618e-3 * 300.0  # kJ/mol: RT at 300 K.
WINDOW = 0.03
"""nm from the reference, 11 thermal standard deviations of a C-H bond. Hydrogens of sound files are up to
0.024 farther away (OpenMM's Modeller), bonds of DNA in crystals are off by up to 0.011."""
_LONG, _SHORT = 0.045, 0.65
"""Limits of bonds to hydrogen and of bonds that the force field does not have: nm beyond the reference of
fixed molecules, slightly above the reader's limit, and the smallest share of the reference.
By convention hydrogens of files are nearer: C-H 0.93 angstrom for 1.09 (X-ray), S-H 0.96 for 1.34 (NMR)."""
_FILES = (templates.PROTEIN, templates.PHOSPHATES["amber14"], templates.DNA, templates.RNA)


@document_fields
@dataclass(frozen=True, eq=False)
class Strain(Value):
    """Bond lengths and angles of heavy atoms more than four standard deviations from the force field's."""

    bonds: Integers  # (n, 2) int: Atoms of the bonds, the worst first.
    bond_deviations: Floats  # (n,) float: In standard deviations, negative if the bond is too short.
    angles: Integers  # (m, 3) int: Atoms of the angles, the worst first.
    angle_deviations: Floats  # (m,) float: In standard deviations, negative if the angle is too small.
    n_bonds: int  # Number of compared bonds.
    n_angles: int  # Number of compared angles.

    def lines(self, structure: Structure, x: Floats | None = None) -> list[str]:
        """Describe each bond and angle in a line, at the positions measured: x (na, 3), nm, or its own."""
        x = structure.positions if x is None else x
        lengths = ANGSTROM_PER_NM * distance(*x[self.bonds.T])
        degrees = np.degrees(angle(*x[self.angles.T]))
        lines = []
        for (i, j), value, by in zip(self.bonds, lengths, self.bond_deviations, strict=True):
            ends = f"{structure.describe(int(i))} and {structure.describe(int(j))}"
            lines.append(f"bond of {ends} is {value:.2f} angstrom long, {by:+.1f} standard deviations")
        for atoms, value, by in zip(self.angles, degrees, self.angle_deviations, strict=True):
            name = "-".join(structure.atom_name[atoms].tolist())
            where = structure.describe_residue(int(structure.atom_residue[atoms[1]]))
            lines.append(f"angle {name} of {where} is {value:.0f} degrees, {by:+.1f} standard deviations")
        return lines


def strain(structure: Structure, x: Floats | None = None) -> Strain:
    """Find bonds and angles of the protein more than four standard deviations from the force field's values.

    Equilibrium values and force constants k are from Amber ff14SB (Maier et al., J. Chem. Theory Comput.
    11:3696, 2015), for any force field of a run. The standard deviation applies to a free bond or angle at
    300 K, sqrt(RT/k): 0.03 angstrom and 3 to 4 degrees for most. An outlier has more than 8 RT, 20 kJ/mol.
    The deviations of small-molecule crystals, MolProbity's unit, are about two thirds as large. Hydrogens,
    whose bonds are shorter in many files by convention, and molecules outside the protein are not
    examined.

    Parameters
    ----------
    structure : Structure
        Structure to measure.
    x : (na, 3) float, nm, optional
        Positions to measure, by default the structure's own.

    Returns
    -------
    Strain
        Bonds and angles, each the worst first.

    Raises
    ------
    ProtochainError
        If x has another shape.
    """
    x = positions(structure, x)
    (bonds, lengths), (triples, angles) = _terms(structure)
    outliers = (
        *_outliers(bonds, distance(*x[bonds.T]), lengths), *_outliers(triples, angle(*x[triples.T]), angles)
    )  # fmt: skip
    return Strain(*outliers, len(bonds), len(triples))


def _outliers(atoms: Integers, values: Floats, norms: Floats) -> tuple[Integers, Floats]:
    deviation = (values - norms[:, 0]) / norms[:, 1]
    outliers = np.flatnonzero(np.abs(deviation) > BEYOND)
    outliers = outliers[np.argsort(-np.abs(deviation[outliers]), kind="stable")]
    return read_only(atoms[outliers], np.int64), read_only(deviation[outliers])


@per_structure
def _terms(structure: Structure, hydrogens: bool = False) -> list[tuple[Integers, Floats]]:
    """Bonds (n, 2), angles (m, 3), each with their values and standard deviations (n, 2), nm or rad."""
    terms = []
    for atoms in (structure.bonds, bond_angles(structure.bonds, structure.n_atoms)):
        values = norms(structure, atoms, templates.PROTEIN, templates.PHOSPHATES["amber14"])
        has_norm = np.isfinite(values).all(axis=1)
        has_norm &= hydrogens | (structure.atom_element[atoms] != "H").all(axis=1)
        terms.append((atoms[has_norm], values[has_norm]))
    return terms


def norms(structure: Structure, atoms: Integers, *files: Path) -> Floats:
    """Values and thermal widths (n, 2) of bonds (n, 2) or angles (n, 3) by force-field files, else NaN."""
    names, kind = _kinds(structure)
    table = _parameters(*files)[atoms.shape[1] - 2]
    # Few kinds of terms, many terms.
    kinds, index = np.unique(kind[atoms], axis=0, return_inverse=True)
    values = [table.get(tuple(names[term].tolist()), (np.nan, np.nan)) for term in kinds]
    return np.array(values).reshape(-1, 2)[index.ravel()]


@per_structure
def _kinds(structure: Structure) -> tuple[NDArray[np.str_], Integers]:
    """Atom types of the force field, empty if it has none, and the place of each atom's type among them."""
    nucleotide = np.isin(structure.residue_name, [*NUCLEOTIDES])[structure.atom_residue]
    names = np.where(structure.kept & ~nucleotide, "", structure.atom_name)
    first = np.searchsorted(structure.atom_residue, np.arange(1, structure.n_residues))
    types: list[str] = []
    for residue, atoms in zip(structure.residue_name.tolist(), np.split(names, first), strict=True):
        by_name = _residue_types(residue, tuple(atoms.tolist()))
        types += [by_name.get(name, "") for name in atoms.tolist()]
    return np.unique(types, return_inverse=True)


@cache
def _by_residue() -> Mapping[str, list[templates.Template]]:
    by_name: dict[str, list[templates.Template]] = {}
    for template in templates.templates().values():
        by_name.setdefault(templates.standard_name(template.name)[0], []).append(template)
    return by_name


@lru_cache(maxsize=1024)
def _residue_types(residue: str, names: tuple[str, ...]) -> Mapping[str, str]:
    """Atom types of a residue: of the template with these atoms, or with the fewest more."""
    atoms = set(names) - {""}
    name = templates.standard_name(residue)[0]
    usable = [entry for entry in _by_residue().get(name, ()) if atoms and atoms <= entry.element.keys()]
    # Of two templates with the same atoms, use the disulfide's, not the thiolate's.
    best = min(usable, key=lambda entry: (len(entry.element) - len(atoms), "CYM" in entry.name), default=None)
    return best.type if best is not None else {}


@cache
def _parameters(*files: Path) -> tuple[Mapping[tuple[str, ...], tuple[float, float]], ...]:
    """Equilibrium values of bonds and angles, nm and rad, with their thermal widths, by atom types."""
    roots = [ElementTree.parse(file).getroot() for file in files]
    tables: list[dict[tuple[str, ...], tuple[float, float]]] = []
    for path, value, n in (("HarmonicBondForce/Bond", "length", 2), ("HarmonicAngleForce/Angle", "angle", 3)):
        table: dict[tuple[str, ...], tuple[float, float]] = {}
        for node in (node for root in roots for node in root.iterfind(path)):
            types = tuple(node.get(f"type{k + 1}", "") for k in range(n))
            norm = float(node.get(value, "nan")), float(np.sqrt(_THERMAL / float(node.get("k", "nan"))))
            table[types] = table[types[::-1]] = norm
        tables.append(table)
    return tuple(tables)


def wrong_bonds(structure: Structure, x: Floats) -> Integers:
    """(n, 2) int: covalent bonds off their reference by 0.3 angstrom, or to hydrogen too short by a third."""
    bonds, _, lower, upper = _references(structure)
    length = distance(*x[bonds.T])
    return np.asarray(bonds[(length < lower) | (length > upper)])


def bond_lines(structure: Structure, x: Floats, bonds: Integers) -> list[str]:
    """Describe bonds (n, 2) by their lengths: ``CD1 of A:ILE13 to HD11, 10.33 angstrom long, not 1.09``."""
    pairs, reference, _, _ = _references(structure)
    usual = {tuple(atoms): length for atoms, length in zip(pairs.tolist(), reference.tolist(), strict=True)}
    lines, residue_index = [], structure.atom_residue
    for (i, j), length in zip(bonds.tolist(), distance(*x[bonds.T]).tolist(), strict=True):
        first, second = structure.atom(i), structure.atom(j)
        partner_residue = "" if residue_index[i] == residue_index[j] else f" of {second.residue.label}"
        sizes = f"{ANGSTROM_PER_NM * length:.2f} angstrom long, not {ANGSTROM_PER_NM * usual[i, j]:.2f}"
        lines.append(f"{first.name} of {first.residue.label} to {second.name}{partner_residue}, {sizes}")
    return lines


@per_structure
def _references(structure: Structure) -> tuple[Integers, Floats, Floats, Floats]:
    """Bonds (n, 2) without metals, their reference lengths and bounds (n,), nm."""
    bonds = structure.bonds[~metals(structure)[structure.bonds].any(axis=1)]
    length = norms(structure, bonds, *_FILES)[:, 0]
    # A molecule with parameters of its own is not described by the names of its residue.
    key = bonds @ [structure.n_atoms, 1]
    order = np.argsort(key)
    for molecule in (*structure.ligands, *structure.fragments):
        term = molecule.ligand.parameters.bonds
        pairs = np.sort(molecule.atoms[term.atoms], axis=1)
        term_key = pairs @ [structure.n_atoms, 1]
        place = order[np.minimum(np.searchsorted(key, term_key, sorter=order), len(key) - 1)]
        is_bond = (key[place] == term_key) & (pairs >= 0).all(axis=1)
        length[place[is_bond]] = term.parameters[is_bond, 0]
    reach = covalent_radii(structure)[bonds].sum(axis=1) / ANGSTROM_PER_NM
    loose = np.isnan(length) | (structure.atom_element[bonds] == "H").any(axis=1)
    slack = np.where(loose & structure.obstacle[bonds].all(axis=1), _LONG, WINDOW)
    length = np.where(np.isnan(length), reach, length)
    return bonds, length, np.where(loose, _SHORT * length, length - WINDOW), length + slack


@per_structure
def covalent_radii(structure: Structure) -> Floats:
    """(na,) float, angstrom: covalent radii."""
    return np.array([gemmi.Element(str(symbol)).covalent_r for symbol in structure.atom_element])


@per_structure
def metals(structure: Structure) -> NDArray[np.bool_]:
    """(na,) bool: metals."""
    symbols = np.unique(structure.atom_element)
    return np.isin(structure.atom_element, [s for s in symbols if gemmi.Element(str(s)).is_metal])
