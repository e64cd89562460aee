"""Atoms of a model matched to those of a molecule whose chemistry is known, by their graph."""

from collections import Counter
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from protochain.core.arrays import Floats, Integers, Value, read_only
from protochain.core.errors import StructureError
from protochain.core.graph import neighbours
from protochain.core.units import ANGSTROM_PER_NM
from protochain.ligands.molecule import Molecule, assembled, library, place, to_rdkit

_MOST_MATCHES = 1000
"""Of symmetric molecules: six phenyl groups have 64, four t-butyl groups 1296."""
_REACH = 1.3
"""Of the sum of covalent radii: bonds of distorted models count. Only which atoms are joined follows."""
_FLAT = 0.1
"""Volume of three unit vectors; 0.77 in a tetrahedron."""


@dataclass(frozen=True, eq=False)
class Placed(Value):
    """A molecule where a model has it.

    Parameters
    ----------
    molecule : Molecule
        With the chemistry of its source, and names and positions of the model; new places of hydrogens.
    atoms : (na,) int
        The model's atom of each; -1 of hydrogens.
    inverted : tuple of str
        Stereocentres, and double bonds as ``C1=C2``, that the model has the other way round, or flat.
    """

    molecule: Molecule
    atoms: Integers
    inverted: tuple[str, ...]


def placed(
    molecule: Molecule, elements: ArrayLike, names: tuple[str, ...], x: Floats, bonds: ArrayLike | None = None
) -> Placed:
    """Put a molecule where a model has it; names need not agree.

    Of several matches that symmetry allows, the one in which all names agree is taken, else that with fewest
    stereocentres inverted, then that whose distances are most like those of the source. (Some names may agree
    by chance: those of SMILES and SDF files are counted off.)

    Parameters
    ----------
    molecule : Molecule
    elements : (nm,) int
        Atomic numbers in the model; hydrogens are left out.
    names : tuple of str
    x : (nm, 3) float, nm
    bonds : (m, 2) int, optional
        Of the model; without them, atoms that are near enough. Orders are always those of the source.

    Raises
    ------
    StructureError
        If the model has another molecule there.
    """
    elements = np.asarray(elements)
    if not np.isfinite(x).all():
        raise StructureError(f"{molecule.source}: the model has coordinates that are not finite; mend them")
    kept = np.flatnonzero(elements != 1)
    model = _skeleton(elements, x, bonds, kept)
    heavy = molecule.heavy
    inside = np.isin(molecule.bonds, heavy).all(1)
    order = {number: place for place, number in enumerate(heavy.tolist())}
    own = [(order[i], order[j]) for i, j in molecule.bonds[inside].tolist()]
    n = len(heavy)
    query = assembled([""] * n, molecule.elements[heavy], [0] * n, own, [1] * len(own), None)
    matches = (
        model.GetSubstructMatches(query, uniquify=False, maxMatches=_MOST_MATCHES)
        if len(kept) == len(heavy)
        else ()
    )
    here, whole = Counter(elements[kept].tolist()), Counter(molecule.elements[heavy].tolist())
    if not matches and here < whole:
        raise StructureError(
            f"{molecule.source}: the model has {_formula(elements[kept])} of "
            f"{_formula(molecule.elements[heavy])}; complete it"
        )
    if not matches:
        raise StructureError(
            f"{molecule.source}: is another molecule than the model has: {_formula(elements[kept])}, not "
            f"{_formula(molecule.elements[heavy])}, or bonded otherwise; give the one that it has"
        )
    found = [kept[list(match)] for match in matches]
    own_names = [molecule.names[i] for i in heavy]
    same = [each for each in found if [names[i] for i in each] == own_names]
    chosen = min(same or found, key=lambda i: (len(inverted_atoms(molecule, x[i])), _away(molecule, x[i])))
    atoms = np.full(molecule.n_atoms, -1)
    atoms[heavy] = chosen
    renamed = tuple(names[i] if i >= 0 else name for i, name in zip(atoms, molecule.names, strict=True))
    inverted = tuple("=".join(renamed[i] for i in each) for each in inverted_atoms(molecule, x[chosen]))
    moved = replace(molecule, names=renamed, positions=read_only(_with_hydrogens(molecule, x[chosen])))
    return Placed(moved, read_only(atoms, np.int64), inverted)


def _skeleton(elements: Any, x: Floats, bonds: ArrayLike | None, kept: Integers) -> Any:
    """The model's heavy atoms, joined by single bonds, as RDKit's molecule."""
    if bonds is None:
        table = library("rdkit.Chem").GetPeriodicTable()
        radius = np.array([table.GetRcovalent(int(z)) for z in elements[kept]])
        apart = np.linalg.norm(x[kept][:, None] - x[kept], axis=2) * ANGSTROM_PER_NM
        pairs = np.argwhere(np.triu(apart < _REACH * (radius[:, None] + radius), 1))
    else:
        number = np.full(len(elements), -1)
        number[kept] = np.arange(len(kept))
        pairs = number[np.asarray(bonds, dtype=np.int64).reshape(-1, 2)]
        pairs = pairs[(pairs >= 0).all(1)]
    n = len(kept)
    return assembled([""] * n, elements[kept], [0] * n, pairs, [1] * len(pairs), None)


def inverted_atoms(molecule: Molecule, heavy: Floats) -> list[tuple[int, ...]]:
    """Return the atoms of each stereocentre and double bond that is not as in the source.

    Parameters
    ----------
    molecule : Molecule
    heavy : (n, 3) float, nm
        Positions of its heavy atoms.
    """
    x = np.zeros((molecule.n_atoms, 3))
    x[molecule.heavy] = heavy
    near = neighbours(molecule.bonds, molecule.n_atoms)
    found: list[tuple[int, ...]] = []
    for centre in np.flatnonzero(molecule.handedness).tolist():
        ways = {i: x[i] - x[centre] for i in near[centre] if molecule.elements[i] != 1}
        ways = {i: way / np.linalg.norm(way) for i, way in ways.items()}
        hydrogen = -np.sum(list(ways.values()), axis=0)
        # RDKit's clockwise: the first three span a negative volume.
        volume = np.linalg.det([ways.get(i, hydrogen) for i in near[centre][:3]])
        if abs(volume) < _FLAT or (volume < 0.0) != (molecule.handedness[centre] == 1):
            found.append((centre,))
    for first, begin, end, last, cis in molecule.double_bonds.tolist():
        if 1 in molecule.elements[[first, last]]:
            continue
        axis = x[end] - x[begin]
        sides = np.cross(axis, x[first] - x[begin]) @ np.cross(axis, x[last] - x[end])
        if (sides > 0.0) != bool(cis):
            found.append((begin, end))
    return found


def _away(molecule: Molecule, heavy: Floats) -> float:
    """Root mean square difference of distances between heavy atoms, in nm.

    If the source has no positions, bonds' orders times lengths: double bonds are the shorter ones.
    """
    if molecule.positions is None:
        x = np.full((molecule.n_atoms, 3), np.nan)
        x[molecule.heavy] = heavy
        length = np.linalg.norm(np.subtract(*x[molecule.bonds.T]), axis=1)
        return float(np.nansum(molecule.orders * length))
    there, here = (
        np.linalg.norm(each[:, None] - each, axis=2) for each in (molecule.positions[molecule.heavy], heavy)
    )
    return float(np.sqrt(np.mean((here - there) ** 2)))


def _with_hydrogens(molecule: Molecule, heavy: Floats) -> Floats:
    """Positions of all atoms: RDKit puts hydrogens about heavy ones."""
    chem = library("rdkit.Chem")
    bare = chem.RemoveAllHs(to_rdkit(molecule))
    place(bare, heavy)
    made = chem.AddHs(bare, addCoords=True)
    new = made.GetConformer().GetPositions() / ANGSTROM_PER_NM
    x, near = np.zeros((molecule.n_atoms, 3)), neighbours(molecule.bonds, molecule.n_atoms)
    for number, parent in enumerate(molecule.heavy.tolist()):
        x[parent] = heavy[number]
        theirs = [i for i in near[parent] if molecule.elements[i] == 1]
        joined = [each.GetIdx() for each in made.GetAtomWithIdx(number).GetNeighbors()]
        x[theirs] = new[[i for i in joined if i >= len(heavy)]]
    return x


def _formula(elements: Any) -> str:
    """Heavy atoms as C10N2O."""
    symbols = Counter(library("rdkit.Chem").GetPeriodicTable().GetElementSymbol(int(z)) for z in elements)
    return "".join(f"{symbol}{n if n > 1 else ''}" for symbol, n in sorted(symbols.items()))
