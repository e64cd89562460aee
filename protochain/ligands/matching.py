"""Atoms of a model matched by graph to a molecule of known chemistry."""

from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import count
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from protochain.core.arrays import Floats, Integers, Value, read_only
from protochain.core.errors import StructureError
from protochain.core.graph import neighbours
from protochain.core.optional_libraries import library
from protochain.core.units import ANGSTROM_PER_NM
from protochain.ligands.molecule import Molecule, build_mol, place, to_rdkit

_MOST_MATCHES = 1000  # Of symmetric molecules: six phenyl groups have 64, four t-butyl groups 1296.
_REACH = 1.3
"""Of the sum of covalent radii: bonds of distorted models count. Only which atoms are joined follows."""
_SHORTER = {1.0: 1.0, 1.5: 0.92, 2.0: 0.87, 3.0: 0.78}
"""Length of a bond by its order, relative to the sum of covalent radii. 0.1 angstrom RMS in 74 ligands."""
_ALIKE = 0.02
"""Angstrom RMS: matches whose lengths fit as well as the best but for this are distinguished by stereo."""
_WORST = 0.25  # Angstrom RMS between lengths of bonds. Crystal ligands have up to 0.1.
_OTHER_RING = 0.09  # Angstrom: bonds of benzene are 0.13 shorter than bonds of cyclohexane.
_FLAT = 0.1  # Volume of three unit vectors, 0.77 in a tetrahedron.


@dataclass(frozen=True, eq=False)
class Placed(Value):
    """A molecule at its place in a model."""

    # With the chemistry of its source, names and positions of the model, and new positions of hydrogens.
    molecule: Molecule
    atoms: Integers  # (na,) int: The model's atom of each atom, -1 of hydrogens.
    # Stereocentres, and double bonds as ``C1=C2``, that the model has the other way round, or flat.
    inverted: tuple[str, ...]


def place_on_model(
    molecule: Molecule,
    elements: ArrayLike,
    names: tuple[str, ...],
    x: Floats,
    hydrogens: ArrayLike | None = None,
    *,
    by_name: bool = False,
) -> Placed:
    """Put a molecule on a model's elements (nm,) at x (nm, 3), nm, by the bonds that these show."""
    # The best match has the right hydrogens, then the best bond lengths, then the fewest inverted centres.
    elements = np.asarray(elements)
    if not np.isfinite(x).all():
        raise StructureError(f"{molecule.source}: the model has coordinates that are not finite; mend them")
    model_heavy, heavy = np.flatnonzero(elements != 1), molecule.heavy
    place_of = {names[k]: k for k in model_heavy.tolist()}
    chosen = np.array([place_of.get(molecule.names[i], -1) for i in heavy])
    agree = len(model_heavy) == len(heavy) and np.array_equal(elements[chosen], molecule.elements[heavy])
    if not by_name or -1 in chosen or not agree:
        chosen = _match_heavy(molecule, elements, names, x, model_heavy, hydrogens)
    elif not _is_bonded(molecule, elements[chosen], x[chosen]):
        with suppress(StructureError):
            chosen = _match_heavy(molecule, elements, names, x, model_heavy, hydrogens)
    atoms = np.full(molecule.n_atoms, -1)
    atoms[heavy] = chosen
    renamed = tuple(names[i] if i >= 0 else name for i, name in zip(atoms, molecule.names, strict=True))
    inverted = tuple("=".join(renamed[i] for i in centre) for centre in inverted_atoms(molecule, x[chosen]))
    moved = replace(molecule, names=renamed, positions=read_only(_with_hydrogens(molecule, x[chosen])))
    return Placed(moved, read_only(atoms, np.int64), inverted)


def copy_names(molecule: Molecule, elements: ArrayLike, names: tuple[str, ...], x: Floats) -> Molecule:
    """Give atoms of a molecule the names of a model, elements (nm,), x (nm, 3) nm, which may lack some."""
    elements, heavy = np.asarray(elements), molecule.heavy
    if len(names) >= len(heavy):
        places = _match_heavy(molecule, elements, names, x, np.arange(len(names)), None)
        name_of = {i: names[k] for i, k in zip(heavy.tolist(), places.tolist(), strict=True)}
    else:
        distance, reach, joined = _distances(elements, x)
        matches = _matches(elements, joined, molecule.elements, molecule.bonds)
        if not matches:
            raise StructureError(
                f"{molecule.source}: is another molecule than the model has; give the one that it has"
            )
        orders = zip(molecule.bonds.tolist(), molecule.orders.tolist(), strict=True)
        usual = {frozenset(pair): _SHORTER[order] for pair, order in orders}
        misfit = [
            sum(abs(distance[i, j] - usual[frozenset((match[i], match[j]))] * reach[i, j]) for i, j in joined)
            for match in matches
        ]
        name_of = dict(zip(matches[int(np.argmin(misfit))], names, strict=True))
    used = {*name_of.values()}
    for i, name in enumerate(molecule.names):
        if i not in name_of:
            name_of[i] = next(candidate for n in count() if (candidate := name + n * "X") not in used)
            used.add(name_of[i])
    return replace(molecule, names=tuple(name_of[i] for i in range(molecule.n_atoms)))


def _distances(elements: Any, x: Floats) -> tuple[Floats, Floats, Integers]:
    """Distances of atoms and sums of their radii, angstrom, and the pairs that are bonded by these."""
    table = library("rdkit.Chem").GetPeriodicTable()
    radius = np.array([table.GetRcovalent(int(z)) for z in elements])
    reach = radius[:, None] + radius
    distance = np.linalg.norm(x[:, None] - x, axis=2) * ANGSTROM_PER_NM
    return distance, reach, np.argwhere(np.triu(distance < _REACH * reach, 1))


def _bonds_of_heavy(molecule: Molecule) -> tuple[Any, Integers]:
    """Bonds between heavy atoms as a mask, and as pairs of numbers of heavy atoms."""
    number = np.cumsum(molecule.elements != 1) - 1
    inside = np.isin(molecule.bonds, molecule.heavy).all(1)
    return inside, number[molecule.bonds[inside]]


def _is_bonded(molecule: Molecule, elements: Any, heavy: Floats) -> bool:
    """Whether the heavy atoms of each bond are near enough for one."""
    distance, reach, _ = _distances(elements, heavy)
    first, second = _bonds_of_heavy(molecule)[1].T
    return bool((distance[first, second] < _REACH * reach[first, second]).all())


def _match_heavy(
    molecule: Molecule,
    elements: Any,
    names: tuple[str, ...],
    x: Floats,
    indices: Integers,
    hydrogens: ArrayLike | None,
) -> Integers:
    """The model's atom of each heavy atom of a molecule."""
    heavy = molecule.heavy
    inside, bonds = _bonds_of_heavy(molecule)
    target = molecule.elements[heavy]
    distance, reach, joined = _distances(elements[indices], x[indices])
    model, full = _formula(elements[indices]), _formula(target)
    if model != full:
        if Counter(elements[indices].tolist()) < Counter(target.tolist()):
            raise StructureError(
                f"{molecule.source}: the model has {model} of {full}; add what is missing to the file, or "
                "give the chemistry of what is there"
            )
        raise StructureError(
            f"{molecule.source}: is another molecule than the model has: {model}, not {full}; "
            "give the one that it has"
        )
    matches = np.array(_matches(target, bonds, elements[indices], joined))
    if not len(matches):
        raise StructureError(
            f"{molecule.source}: is another molecule than the model has: both are {full}, but bonded "
            f"otherwise ({_difference(elements[indices], joined, target, bonds)}); give the one that it has"
        )
    # Differences of bond lengths from the usual ones, for each match.
    mol = to_rdkit(molecule)
    orders = [1.5 if bond.GetIsAromatic() else bond.GetBondTypeAsDouble() for bond in mol.GetBonds()]
    usual = np.array([_SHORTER[order] for order in orders])[inside]
    first, second = matches[:, bonds].transpose(2, 0, 1)
    beyond = distance[first, second] - usual * reach[first, second]
    misfit = np.sqrt(np.mean(beyond**2, axis=1)) if len(bonds) else np.zeros(len(matches))
    # The matches with the fewest differences in hydrogens, and of these with nearly the smallest misfit.
    likest = np.arange(len(matches))
    if hydrogens is not None:
        ends = molecule.bonds[(molecule.elements[molecule.bonds] == 1).any(1)]
        of_molecule = np.bincount(ends.ravel(), minlength=molecule.n_atoms)[heavy]
        unlike = np.abs(np.asarray(hydrogens)[indices][matches] - of_molecule).sum(1)
        likest = np.flatnonzero(unlike == unlike.min())
    likest = likest[misfit[likest] <= misfit[likest].min() + _ALIKE]
    places = indices[matches]
    best = min(likest.tolist(), key=lambda k: (len(inverted_atoms(molecule, x[places[k]])), misfit[k]))
    off = np.zeros(len(orders))
    off[inside] = beyond[best]
    if misfit[best] > _WORST:
        raise StructureError(
            f"{molecule.source}: fits the model badly: bonds differ by {misfit[best]:.2f} angstrom RMS; give "
            "the molecule that it has, or mend its coordinates"
        )
    # Bond lengths distinguish aromatic from saturated carbon rings.
    for ring in mol.GetRingInfo().BondRings():
        atoms = {i for k in ring for i in molecule.bonds[k].tolist()}
        kinds = {orders[k] for k in ring}
        # Single bonds that are too short, or aromatic ones that are too long.
        beyond_usual = off[[*ring]].mean() * {1.0: -1.0, 1.5: 1.0}.get(max(kinds), 0.0)
        is_plain = len(kinds) == 1 and {*molecule.elements[[*atoms]].tolist()} == {6}
        if is_plain and beyond_usual > _OTHER_RING:
            model_atom = dict(zip(heavy.tolist(), places[best].tolist(), strict=True))
            where = ", ".join(names[model_atom[i]] for i in sorted(atoms))
            raise StructureError(
                f"{molecule.source}: fits the model badly: bonds of the ring of {where} differ by "
                f"{off[[*ring]].mean():+.2f} angstrom, as if it had others; give the molecule that it has"
            )
    return np.asarray(places[best])


def _matches(part_elements: Any, part_bonds: Any, elements: Any, bonds: Any) -> Any:
    """Matches of a part with a whole, heavy atoms joined by single bonds."""
    part, whole = (
        build_mol([""] * len(atoms), atoms, [0] * len(atoms), pairs, [1] * len(pairs), None)
        for atoms, pairs in ((part_elements, part_bonds), (elements, bonds))
    )
    return whole.GetSubstructMatches(part, uniquify=False, maxMatches=_MOST_MATCHES)


def _difference(model_elements: Any, model_bonds: Any, source_elements: Any, source_bonds: Any) -> str:
    """Kinds of bonds of which the model lacks some, or else has more."""
    model, source = (
        Counter(_formula(sorted(elements[list(pair)])) for pair in bonds)
        for elements, bonds in ((model_elements, model_bonds), (source_elements, source_bonds))
    )
    lacks = source - model or model - source
    word = "lacks" if source - model else "has more of"
    counts = ", ".join(f"{n} of {kind}" for kind, n in sorted(lacks.items()))
    return f"it {word} bonds: {counts}" if counts else "other atoms of the same elements are joined"


def inverted_atoms(molecule: Molecule, heavy: Floats) -> list[tuple[int, ...]]:
    """Return atoms of stereocentres and double bonds not as in the source: heavy (n, 3) nm, NaN to ignore."""
    x = np.zeros((molecule.n_atoms, 3))
    x[molecule.heavy] = heavy
    near = neighbours(molecule.bonds, molecule.n_atoms)
    inverted: list[tuple[int, ...]] = []
    for centre in np.flatnonzero(molecule.handedness).tolist():
        ways = {i: x[i] - x[centre] for i in near[centre] if molecule.elements[i] != 1}
        ways = {i: way / max(np.linalg.norm(way), 1e-9) for i, way in ways.items()}
        hydrogen = -np.sum(list(ways.values()), axis=0)
        # RDKit's clockwise: the first three span a negative volume.
        a, b, c = (ways.get(i, hydrogen) for i in near[centre][:3])
        volume = a @ np.cross(b, c)  # det would warn of NaN.
        if (volume if molecule.handedness[centre] == 2 else -volume) < _FLAT:
            inverted.append((centre,))
    for first, begin, end, last, cis in molecule.double_bonds.tolist():
        if 1 in molecule.elements[[first, last]]:
            continue
        axis = x[end] - x[begin]
        sides = np.cross(axis, x[first] - x[begin]) @ np.cross(axis, x[last] - x[end])
        if (sides if cis else -sides) < 0.0:
            inverted.append((begin, end))
    return inverted


def _with_hydrogens(molecule: Molecule, heavy: Floats) -> Floats:
    """Positions of all atoms: RDKit puts hydrogens about heavy ones."""
    chem = library("rdkit.Chem")
    bare = chem.RemoveAllHs(to_rdkit(molecule))
    place(bare, heavy)
    mol = chem.AddHs(bare, addCoords=True)
    new = mol.GetConformer().GetPositions() / ANGSTROM_PER_NM
    x, near = np.zeros((molecule.n_atoms, 3)), neighbours(molecule.bonds, molecule.n_atoms)
    for number, parent in enumerate(molecule.heavy.tolist()):
        x[parent] = heavy[number]
        hydrogens = [i for i in near[parent] if molecule.elements[i] == 1]
        joined = [neighbour.GetIdx() for neighbour in mol.GetAtomWithIdx(number).GetNeighbors()]
        x[hydrogens] = new[[i for i in joined if i >= len(heavy)]]
    return x


def _formula(elements: Any) -> str:
    """Heavy atoms as C10N2O."""
    symbols = Counter(library("rdkit.Chem").GetPeriodicTable().GetElementSymbol(int(z)) for z in elements)
    return "".join(f"{symbol}{n if n > 1 else ''}" for symbol, n in sorted(symbols.items()))
