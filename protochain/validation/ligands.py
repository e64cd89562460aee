"""Ligands of known chemistry, one by one: PoseBusters' tests, strain, contacts, clashes, stereo."""

import sys
from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from protochain.core.arrays import Floats, Integers, Value, distance
from protochain.core.errors import ProtochainError
from protochain.core.optional_libraries import library
from protochain.core.settings import document_fields
from protochain.core.units import ANGSTROM_PER_NM
from protochain.ligands.energy import strain
from protochain.ligands.matching import inverted_atoms
from protochain.ligands.molecule import quietly, to_rdkit
from protochain.structure.ligand_files import bonded_ligands
from protochain.structure.molecule.model import BoundLigand, Structure, per_positions
from protochain.structure.molecule.residues import Residue
from protochain.validation.clashes import Clashes, clashes

_MOST_MATCHES = 10_000  # Numberings that are tried: a molecule with 4 t-butyl groups has 1296.
CONTACT = 4.0  # Angstrom between heavy atoms.
_RECEPTOR = 10.0  # Angstrom from the ligand. PoseBusters' tests do not need molecules farther away.
LIGAND_COLUMNS = (
    "chain", "residue", "name", "source", "strain_kj_mol", "contacts", "clashes", "inverted",
    "posebusters_passed", "posebusters_failed",
)  # fmt: skip
_NOT_TESTS = ("file", "molecule", "position")
POSEBUSTERS = (
    "mol_pred_loaded", "mol_cond_loaded", "sanitization", "inchi_convertible", "all_atoms_connected",
    "no_radicals", "bond_lengths", "bond_angles", "internal_steric_clash", "aromatic_ring_flatness",
    "non-aromatic_ring_non-flatness", "double_bond_flatness", "internal_energy",
    "protein-ligand_maximum_distance", "minimum_distance_to_protein",
    "minimum_distance_to_organic_cofactors", "minimum_distance_to_inorganic_cofactors",
    "minimum_distance_to_waters", "volume_overlap_with_protein", "volume_overlap_with_organic_cofactors",
    "volume_overlap_with_inorganic_cofactors", "volume_overlap_with_waters",
)  # fmt: skip
"""Tests of PoseBusters' configuration ``dock``."""


@document_fields
@dataclass(frozen=True, eq=False)
class LigandFound(Value):
    """Findings of a ligand in its place."""

    residue: Residue  # Residue as the file names it.
    source: str  # Source of its chemistry.
    # Energy of its bonds, angles, torsions and Lennard-Jones above the nearest minimum, in vacuum, after
    # hydrogens are put at the lowest energy. None if it is not finite.
    strain_kj_mol: float | None
    contacts: int  # Its heavy atoms within 4 angstrom of one of the protein.
    # Overlaps with the protein of 0.4 angstrom and more, as of :func:`protochain.validation.clashes`.
    clashes: int
    inverted: tuple[str, ...]  # Stereocentres, and double bonds as ``C1=C2``, that differ from the source.
    # Whether it passes each test of PoseBusters' configuration ``dock`` (Buttenschoen et al., Chem. Sci.
    # 15:3130, 2024) with everything outside it as the receptor. None if they were not run.
    posebusters: Mapping[str, bool] | None = None

    def __post_init__(self) -> None:
        if self.posebusters is not None:
            object.__setattr__(self, "posebusters", MappingProxyType(dict(self.posebusters)))

    @property
    def failed(self) -> tuple[str, ...] | None:
        """PoseBusters' tests that it fails, None if they were not run."""
        if self.posebusters is None:
            return None
        return tuple(name for name, passed in self.posebusters.items() if not passed)

    @property
    def is_valid(self) -> bool:
        """Whether PoseBusters' tests pass. If they were not run: no clashes, and the stereo of its source."""
        return not (self.clashes or self.inverted if self.failed is None else self.failed)

    def record(self) -> dict[str, Any]:
        """Flat row: residue, source, and findings."""
        return {
            "chain": self.residue.chain, "residue": self.residue.number, "name": self.residue.name,
            "source": self.source, **self.measures(),
        }  # fmt: skip

    def measures(self) -> dict[str, Any]:
        """Findings, without residue and source."""
        failed = self.failed
        return {
            "strain_kj_mol": self.strain_kj_mol,
            "contacts": self.contacts,
            "clashes": self.clashes,
            "inverted": list(self.inverted),
            "posebusters_passed": None if failed is None else not failed,
            "posebusters_failed": None if failed is None else list(failed),
        }

    def __str__(self) -> str:
        parts = [
            "strain unknown" if self.strain_kj_mol is None else f"strain {self.strain_kj_mol:.0f} kJ/mol",
            f"{self.contacts} heavy atoms within {CONTACT:g} angstrom of the protein",
            f"{self.clashes} clashes with it",
        ]
        if self.inverted:
            parts.append(f"inverted: {', '.join(self.inverted)}")
        if self.failed is not None:
            parts.append(
                f"PoseBusters fails {', '.join(self.failed)}" if self.failed else "PoseBusters passes"
            )
        return f"{self.residue}: {', '.join(parts)}"


def ligand_findings(structure: Structure, x: Floats, clashing: Clashes) -> tuple[LigandFound, ...]:
    """Examine each ligand of a structure at positions, without PoseBusters: x (na, 3) nm."""
    protein = np.flatnonzero(~structure.kept & (structure.atom_element != "H"))
    tree = cKDTree(ANGSTROM_PER_NM * x[protein])

    def distances(bound: BoundLigand) -> Floats:
        heavy = bound.atoms[bound.ligand.molecule.heavy]
        return np.asarray(tree.query(ANGSTROM_PER_NM * x[heavy], distance_upper_bound=CONTACT)[0])

    return tuple(
        LigandFound(
            structure.residue(int(structure.atom_residue[bound.atoms[0]])),
            bound.ligand.molecule.source,
            strained,
            int(np.isfinite(distances(bound)).sum()),
            int((np.isin(clashing.pairs, bound.atoms) & ~structure.kept[clashing.pairs[:, ::-1]]).sum()),
            tuple("=".join(bound.ligand.molecule.names[i] for i in atoms) for atoms in _inversions(bound, x)),
        )
        for bound, strained in zip(structure.ligands, _strains(structure, x), strict=True)
    )


def ligand_motion(start: Structure, x: Floats) -> Floats:
    """(n, 2) float, angstrom: RMSD and largest displacement of each ligand from a start, not superposed."""
    # Of heavy atoms; x (na, 3) nm. RDKit's CalcRMS has the least RMSD over symmetric numberings, those of
    # conjugated terminal groups as carboxylates included.
    motion = np.full((len(start.ligands), 2), np.nan)
    for row, bound in zip(motion, start.ligands, strict=True):
        molecule, atoms = bound.ligand.molecule, bound.atoms
        if np.isfinite(x[atoms]).all():
            ends = [
                library("rdkit.Chem").RemoveHs(to_rdkit(molecule, positions[atoms]), sanitize=False)
                for positions in (x, start.positions)
            ]
            heavy = atoms[molecule.heavy]
            row[0] = library("rdkit.Chem.rdMolAlign").CalcRMS(*ends, maxMatches=_MOST_MATCHES)
            row[1] = ANGSTROM_PER_NM * distance(x[heavy], start.positions[heavy]).max()
    return motion


def sdf_properties(
    structure: Structure, x: Floats, motion: Floats, energy: float, status: str
) -> list[dict[str, str]]:
    """Fields of the SDF record of each ligand at the end of a run, see :func:`protochain.save_ligands`."""
    fields = []
    for ligand, (rmsd, _) in zip(findings_of(structure, x)[0], motion.tolist(), strict=True):
        strain = "" if ligand.strain_kj_mol is None else f"{ligand.strain_kj_mol:.3f}"
        fields.append({"strain_kj_mol": strain, "rmsd_angstrom": f"{rmsd:.4f}"})
    for molecule, atoms in bonded_ligands(structure):
        heavy = atoms[molecule.heavy]
        rmsd = ANGSTROM_PER_NM * np.sqrt((distance(x[heavy], structure.positions[heavy]) ** 2).mean())
        fields.append({"rmsd_angstrom": f"{rmsd:.4f}"})
    rows = ({"energy_kj_mol": f"{energy:.3f}", **values, "status": status} for values in fields)
    return [{f"protochain_{key}": value for key, value in row.items()} for row in rows]


def describe_motion(motion: Floats) -> str:
    """Describe the largest values of ``ligand_motion`` after other values, empty without ligands."""
    if not len(motion):
        return ""
    return ", ligand RMSD {:.2f} angstrom, farthest atom {:.2f}".format(*motion.max(axis=0))


@per_positions
def _strains(structure: Structure, x: Floats) -> tuple[float | None, ...]:
    """Strain of each ligand in kJ/mol, from two minimisations, None if not available."""
    strains = [
        strain(ligand.ligand.parameters, x[ligand.atoms], ligand.ligand.molecule.elements)
        for ligand in structure.ligands
    ]
    return tuple(value if np.isfinite(value) else None for value in strains)


def _inversions(bound: BoundLigand, x: Floats) -> list[tuple[int, ...]]:
    """Stereocentres, and ends of double bonds, by their places in the molecule."""
    heavy = bound.atoms[bound.ligand.molecule.heavy]
    return inverted_atoms(bound.ligand.molecule, np.where(heavy[:, None] < 0, np.nan, x[heavy]))


def inverted_double_bonds(structure: Structure, x: Floats) -> Integers:
    """(n, 2) int: double bonds at x (na, 3), nm, with the other E/Z than in their source."""
    bonds = [
        molecule.atoms[list(atoms)].tolist()
        for molecule in (*structure.ligands, *structure.fragments)
        for atoms in _inversions(molecule, x)
        if len(atoms) == 2
    ]
    return np.array(bonds, dtype=np.int64).reshape(-1, 2)


def describe_double_bonds(structure: Structure, pairs: Integers) -> list[str]:
    """Name double bonds (n, 2), as ``C1=C2 of A:LIG1``."""
    of = structure.atom_residue
    return [f"{'='.join(structure.atom_name[p])} of {structure.residue(int(of[p[0]]))}" for p in pairs]


def _posebusters(structure: Structure, bound: BoundLigand, x: Floats) -> dict[str, bool]:
    """Results by name of the test. A test without a result is not passed."""
    busters = library("posebusters").PoseBusters(config="dock")
    # It flushes the stream of the call before, which may be closed by now, and would report failed tests.
    library("rdkit").log_handler.stream = sys.stderr
    pose = to_rdkit(bound.ligand.molecule, x[bound.atoms])
    row = quietly(busters.bust, [pose], None, _receptor(structure, bound, x)).iloc[0]
    return {name: value is True or value == 1 for name, value in row.items() if name not in _NOT_TESTS}


def _receptor(structure: Structure, bound: BoundLigand, x: Floats) -> Any:
    """Heavy atoms near a ligand, or all if none is, as RDKit's molecule without bonds."""
    chem = library("rdkit.Chem")
    outside = structure.atom_element != "H"
    outside[bound.atoms] = False
    is_far = cKDTree(x[bound.atoms]).query(x)[0] * ANGSTROM_PER_NM > _RECEPTOR
    near = outside & ~is_far
    indices = np.flatnonzero(near if near.any() else outside).tolist()
    receptor, conformer = chem.RWMol(), chem.Conformer(len(indices))
    for number, k in enumerate(indices):
        atom = chem.Atom(str(structure.atom_element[k]))
        name = str(structure.residue_name[structure.atom_residue[k]])
        is_hetero = bool(structure.kept[k])
        atom.SetMonomerInfo(
            chem.AtomPDBResidueInfo(str(structure.atom_name[k]), residueName=name, isHeteroAtom=is_hetero)
        )
        receptor.AddAtom(atom)
        conformer.SetAtomPosition(number, (ANGSTROM_PER_NM * x[k]).tolist())
    receptor.AddConformer(conformer)
    return receptor


def with_posebusters(
    structure: Structure, x: Floats, ligands: tuple[LigandFound, ...]
) -> tuple[tuple[LigandFound, ...], str]:
    """Add results of PoseBusters' tests, and return why they were not run, empty if they were."""
    try:
        results = [_posebusters(structure, ligand, x) for ligand in structure.ligands]
    except ProtochainError as error:
        return ligands, str(error)
    return tuple(replace(ligand, posebusters=row) for ligand, row in zip(ligands, results, strict=True)), ""


def findings_of(
    structure: Structure, x: Floats, *, posebusters: bool = False
) -> tuple[tuple[LigandFound, ...], str]:
    """Examine each ligand at positions, and return why requested PoseBusters' tests were not run."""
    if not structure.ligands or not np.isfinite(x).all():
        return (), ""
    findings = ligand_findings(structure, x, clashes(structure, x))
    return with_posebusters(structure, x, findings) if posebusters else (findings, "")


def at_both_ends(start: LigandFound, end: LigandFound, motion: Floats) -> dict[str, Any]:
    """Flat row of a ligand at the start and the end of a run, with its row of ``ligand_motion``."""
    row = {key: value for key, value in start.record().items() if key not in start.measures()}
    for key in start.measures():
        for when, ligand in (("start", start), ("end", end)):
            row[_at(key, when)] = ligand.measures()[key]
    return row | dict(zip(MOTION, map(float, motion), strict=True))


def _at(key: str, when: str) -> str:
    """Name of a column at the start or end. The unit comes last."""
    unit = "_kj_mol"
    return f"{key.removesuffix(unit)}_{when}{unit}" if key.endswith(unit) else f"{key}_{when}"


MOTION = ("rmsd_angstrom", "displacement_max_angstrom")  # Columns of :func:`ligand_motion`.
LIGAND_ENDS = (*(_at(key, when) for key in LIGAND_COLUMNS[4:] for when in ("start", "end")), *MOTION)
"""Columns of :func:`at_both_ends`, without residue and source."""
