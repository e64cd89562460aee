"""Nucleotides: puckers of sugars, and base pairs."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from protochain.core.arrays import Floats, Integers, Value
from protochain.core.errors import ProtochainError
from protochain.core.graph import neighbours
from protochain.core.optional_libraries import library
from protochain.core.units import ANGSTROM_PER_NM
from protochain.structure.molecule.model import Structure
from protochain.structure.molecule.residues import NUCLEOTIDES
from protochain.validation.layout import dihedrals

if TYPE_CHECKING:
    import pandas as pd

NUCLEOTIDE_COLUMNS = (
    "chain", "residue", "name", "pucker", "phase_degrees", "amplitude_degrees", "delta_degrees",
    "pucker_outlier", "paired_with",
)  # fmt: skip
"""Columns of :attr:`Validation.nucleotide_table`."""
_RING = (("C4'", "O4'", "C1'", "C2'"), ("O4'", "C1'", "C2'", "C3'"), ("C1'", "C2'", "C3'", "C4'"),
         ("C2'", "C3'", "C4'", "O4'"), ("C3'", "C4'", "O4'", "C1'"))  # fmt: skip
"""Torsions nu0 to nu4 of the sugar (IUPAC-IUB, Eur. J. Biochem. 131:9, 1983)."""
_DELTA = ("C5'", "C4'", "C3'", "O3'")
_NAMES = ("C3'-endo", "C4'-exo", "O4'-endo", "C1'-exo", "C2'-endo", "C3'-exo", "C4'-endo", "O4'-exo",
          "C1'-endo", "C2'-exo")  # fmt: skip
"""By tenths of the circle of phases."""
_LEAST, _MIDDLE, _MOST = 55.0, 110.0, 175.0
"""Degrees of delta: of sugars, and between sugars with C3' and with C2' on the side of C5'."""
_PERPENDICULAR = 2.9
"""Angstrom: from the phosphate after a ribose to the line of its glycosidic bond. With C3'-endo it is more
(Richardson et al., RNA 14:465, 2008)."""
_BONDED = 0.25  # nm: O3' and P that are further apart belong to two strands.


@dataclass(frozen=True, eq=False)
class Nucleotides(Value):
    """Sugars and base pairs of a structure."""

    residue: Integers  # (n,) int: Nucleotides with a complete sugar.
    # (n,) degrees: Of its pseudorotation: Altona, Sundaralingam, J. Am. Chem. Soc. 94:8205 (1972).
    phase: Floats
    amplitude: Floats
    delta: Floats  # (n,) degrees.
    # (n,) bool: Delta is outside the range of sugars, or contradicts the phosphate after a ribose.
    outlier: NDArray[np.bool_]
    # (k, 2) int: Residues whose bases are paired by the criteria of DSSR (Lu, Bussemaker, Olson, Nucleic
    # Acids Res. 43:e142, 2015), as biotite finds them; None without biotite.
    pairs: Integers | None

    @property
    def pucker(self) -> list[str]:
        """Name of each pucker."""
        return [_NAMES[int(phase // 36.0)] for phase in self.phase]


def nucleotides(structure: Structure, x: Floats) -> Nucleotides:
    """Measure sugars, and find base pairs: x (na, 3) nm."""
    atoms_of = _atoms(structure)
    ring = {name for torsion in _RING for name in torsion} | {*_DELTA}
    complete = [r for r, atoms in atoms_of.items() if ring <= atoms.keys()]
    nu = [_torsions(x, atoms_of, complete, names) for names in _RING]
    delta = _torsions(x, atoms_of, complete, _DELTA)
    # Equation 3 of Altona and Sundaralingam.
    across = (nu[4] + nu[1] - nu[3] - nu[0]) / (2.0 * np.sin(np.deg2rad([36.0, 72.0])).sum())
    phase, amplitude = np.rad2deg(np.arctan2(across, nu[2])) % 360.0, np.hypot(across, nu[2])
    distance = np.array([_from_glycosidic_bond(x, atoms_of, r) for r in complete])
    contradicts = np.isfinite(distance) & ((distance < _PERPENDICULAR) == (delta <= _MIDDLE))
    outlier = (delta < _LEAST) | (delta > _MOST) | contradicts
    pairs = _pairs(structure, x, atoms_of)
    return Nucleotides(np.array(complete, dtype=np.int64), phase, amplitude, delta, outlier, pairs)


def nucleotide_table(structure: Structure, sugars: Nucleotides) -> "pd.DataFrame":
    """Return a row for each nucleotide with a whole sugar: ``NUCLEOTIDE_COLUMNS``."""
    import pandas as pd

    s, r = structure, sugars.residue
    number = np.char.add(s.residue_number, s.residue_insertion_code)
    pairs = np.empty((0, 2), dtype=np.int64) if sugars.pairs is None else sugars.pairs
    partners = neighbours(pairs, s.n_residues)
    paired = [", ".join(f"{s.residue_chain[k]}:{number[k]}" for k in sorted(partners[i])) for i in r.tolist()]
    columns = (
        s.residue_chain[r], number[r], s.residue_name[r], sugars.pucker, sugars.phase, sugars.amplitude,
        sugars.delta, sugars.outlier, paired,
    )  # fmt: skip
    return pd.DataFrame(dict(zip(NUCLEOTIDE_COLUMNS, columns, strict=True)))


def _atoms(structure: Structure) -> dict[int, dict[str, int]]:
    """Heavy atoms of each nucleotide, by name."""
    is_nucleotide = np.isin(structure.residue_name, [*NUCLEOTIDES])[structure.atom_residue]
    atoms: dict[int, dict[str, int]] = {}
    for k in np.flatnonzero(is_nucleotide & (structure.atom_element != "H")).tolist():
        atoms.setdefault(int(structure.atom_residue[k]), {})[str(structure.atom_name[k])] = k
    return atoms


def _torsions(
    x: Floats, atoms_of: dict[int, dict[str, int]], residues: list[int], names: tuple[str, ...]
) -> Floats:
    """(n,) float, degrees: a torsion of each residue."""
    atoms = np.array([[atoms_of[r][name] for name in names] for r in residues], dtype=np.int64).reshape(-1, 4)
    return dihedrals(x, atoms)


def _from_glycosidic_bond(x: Floats, atoms_of: dict[int, dict[str, int]], residue: int) -> float:
    """Angstrom from the phosphate after a ribose to the line of its glycosidic bond, NaN of others."""
    atoms, after = atoms_of[residue], atoms_of.get(residue + 1, {})
    base = next((atoms[name] for name in ("N9", "N1") if name in atoms), None)
    if "O2'" not in atoms or base is None or "P" not in after:
        return np.nan
    bond, arm = x[base] - x[atoms["C1'"]], x[after["P"]] - x[atoms["C1'"]]
    if np.linalg.norm(x[after["P"]] - x[atoms["O3'"]]) > _BONDED:
        return np.nan
    return ANGSTROM_PER_NM * float(np.linalg.norm(np.cross(bond, arm)) / np.linalg.norm(bond))


def _pairs(structure: Structure, x: Floats, atoms_of: dict[int, dict[str, int]]) -> Integers | None:
    # A molecule of any kind may bear a nucleotide's name: a base is bonded to a sugar by a nitrogen.
    bases = [base for base in atoms_of.values() if "C1'" in base and base.keys() & {"N1", "N9"}]
    atoms = [k for base in bases for k in base.values()]
    if not atoms:
        return np.empty((0, 2), dtype=np.int64)
    try:
        biotite = library("biotite.structure")
    except ProtochainError:
        return None
    array = biotite.AtomArray(len(atoms))
    array.coord = ANGSTROM_PER_NM * x[atoms]
    array.atom_name, array.element = structure.atom_name[atoms], structure.atom_element[atoms]
    array.res_id = structure.atom_residue[atoms]
    array.res_name = structure.residue_name[structure.atom_residue[atoms]]
    first = biotite.base_pairs(array).astype(np.int64)  # without any, empty and of floats
    return np.array(array.res_id[first], dtype=np.int64).reshape(-1, 2)
