"""A structure, prepared once, with the positions of each frame of an ensemble."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import gemmi
import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, connected_components
from scipy.spatial import KDTree

from protochain.core.arrays import Floats, Integers, Value, read_only
from protochain.core.errors import StructureError
from protochain.core.units import ANGSTROM_PER_NM
from protochain.structure.convert import as_structure
from protochain.structure.formats.frames import Frame, Frames
from protochain.structure.molecule.hydrogens import place_hydrogens
from protochain.structure.molecule.model import Structure
from protochain.structure.molecule.residues import BACKBONE
from protochain.structure.preparation.periodic import touching_image
from protochain.structure.preparation.protonate import BONDED
from protochain.structure.write import as_gemmi

_LONGEST_BOND = 1.0  # nm. Longer bonds have atoms in two images of a box, or other atoms, even in bad models.
_BROKEN = "it is of other atoms, or broken across a box that the file does not state"
_NEAREST = 0.02  # nm. A fifth of the shortest bond. Shorter bonds have no direction.
_FARTHEST = 1e4  # nm. Largest coordinate, as in files.
_CONTACT = 0.6  # nm. Largest distance between atoms of molecules in contact.
_IN_FRAMES = ("N", "CA", "C", "O")


@dataclass(frozen=True, eq=False)
class Ensemble(Value):
    """A structure and the places of its atoms in frames."""

    structure: Structure  # Prepared once. All frames have its atoms, bonds and protonation.
    # (na,) int: Place of each of its atoms in a frame, or -1 for atoms that are placed in each frame.
    place: Integers
    # Options of :func:`protochain.as_structure` for frames that lack heavy atoms.
    settings: Mapping[str, Any]

    def __post_init__(self) -> None:
        object.__setattr__(self, "place", read_only(self.place, np.int64))

    @classmethod
    def of(cls, structure: Structure, frames: Frames, settings: Mapping[str, Any] = {}) -> "Ensemble":
        """Find the atoms of a structure in frames by name, or in the order of its file or of itself."""
        return cls(structure, _places(structure, frames), dict(settings))

    def at(self, frame: Frame) -> Structure:
        """Return the structure at a frame with whole molecules and all missing atoms placed."""
        return self.structure.with_positions(self._positions(frame))

    def gap(self, x: Floats) -> float | None:
        """Largest distance, nm, in a frame between molecules that are in contact in the structure."""
        distances = [float(np.min(KDTree(x[a]).query(x[b])[0])) for a, b in self._touching]
        return max(distances, default=None)

    @cached_property
    def _touching(self) -> list[tuple[Integers, Integers]]:
        """Atoms of earlier molecules and of each molecule in contact with them in the structure."""
        x = self.structure.positions
        molecules = self._molecules
        pairs = [(np.concatenate(molecules[:k]), molecules[k]) for k in range(1, len(molecules))]
        return [(a, b) for a, b in pairs if np.min(KDTree(x[a]).query(x[b])[0]) < _CONTACT]

    @cached_property
    def _molecules(self) -> list[Integers]:
        """Atoms of each molecule that frames have."""
        molecule = self._outward[2][self._present]
        return [self._present[molecule == m] for m in dict.fromkeys(molecule.tolist())]

    def _positions(self, frame: Frame) -> Floats:
        if frame.x is None:
            raise StructureError(frame.error)
        s, x = self.structure, np.full((self.structure.n_atoms, 3), np.nan)
        x[self._present] = frame.x[self.place[self._present]]
        if strange := self._present[~(np.abs(x[self._present]) < _FARTHEST).all(axis=1)].tolist():
            raise StructureError(f"the position of {s.describe(strange[0])} is not a number, or far away")
        if frame.box is not None:
            x = self._gather(self._make_whole(x, frame.box), frame.box)
        ends = x[self._bonds]
        lengths = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)
        if len(lengths) and not _NEAREST < lengths.min() <= lengths.max() < _LONGEST_BOND:
            worst = int(np.argmax(lengths if lengths.max() >= _LONGEST_BOND else -lengths))
            first, second = (s.describe(atom) for atom in self._bonds[worst].tolist())
            cause = _BROKEN if lengths.max() >= _LONGEST_BOND else "correct its coordinates"
            separation = f"{ANGSTROM_PER_NM * lengths[worst]:.2f} angstrom apart"
            raise StructureError(f"{first} and {second} are bonded, but {separation}: {cause}")
        # As in a file, a hydrogen too far from its parent is placed again.
        loose = np.unique(self._bonds[ANGSTROM_PER_NM * lengths > BONDED])
        x[loose[s.atom_element[loose] == "H"]] = np.nan
        if not np.isnan(x).any():
            return x
        if ((self.place < 0) & (s.atom_element != "H")).any():
            x = self._rebuild(x)
        charge = s.origin.charge if s.origin else np.zeros(s.n_atoms)
        return place_hydrogens(x, s.atom_element.tolist(), charge, s.bonds)

    @cached_property
    def _present(self) -> Integers:
        """Atoms that frames have."""
        return np.flatnonzero(self.place >= 0)

    @cached_property
    def _bonds(self) -> Integers:
        """Bonds of atoms that frames have."""
        bonds = self.structure.bonds
        return bonds[(self.place[bonds] >= 0).all(axis=1)]

    @cached_property
    def _outward(self) -> tuple[Integers, Integers, Integers]:
        """Atoms and their parents, each parent before its children, and the molecule of each atom."""
        n = self.structure.n_atoms
        graph = coo_array((np.ones(len(self._bonds)), self._bonds.T), (n, n)).tocsr()
        _, molecule = connected_components(graph, directed=False)
        atoms, parents = [], []
        for first in np.unique(molecule[self._present], return_index=True)[1]:
            order, parent = breadth_first_order(graph, self._present[first], directed=False)
            atoms.append(order[1:])
            parents.append(parent[order[1:]])
        arrays = (np.concatenate(atoms), np.concatenate(parents), molecule)
        first, second, third = (np.asarray(array, dtype=np.int64) for array in arrays)
        return first, second, third

    def _make_whole(self, x: Floats, box: Floats) -> Floats:
        """Move each atom to the image nearest to its bonded parent."""
        atoms, parents, _ = self._outward
        turns = np.round((x[atoms] - x[parents]) @ np.linalg.inv(box))
        if not turns.any():
            return x
        shift = np.zeros((len(x), 3))
        for atom, parent, turn in zip(atoms.tolist(), parents.tolist(), turns, strict=True):
            shift[atom] = shift[parent] - turn
        return np.asarray(x + shift @ box)

    def _gather(self, x: Floats, box: Floats) -> Floats:
        """Move molecules without contact to earlier molecules to an image with contact, if there is one."""
        molecules = self._molecules
        for k, atoms in enumerate(molecules[1:], 1):
            turns = touching_image(KDTree(x[np.concatenate(molecules[:k])]), x[atoms], box, _CONTACT)
            if turns is not None and turns.any():
                x = np.array(x)
                x[atoms] += turns @ box
        return x

    def _rebuild(self, x: Floats) -> Floats:
        """Build heavy atoms that the frame lacks, as for a file. Hydrogens stay missing."""
        s, model = self.structure, as_gemmi([self.structure])
        k = 0
        for residue in (residue for chain in model[0] for residue in chain):
            absent = []
            for i, atom in enumerate(residue):
                absent += [i] if np.isnan(x[k, 0]) else []
                atom.pos = gemmi.Position(*(ANGSTROM_PER_NM * x[k]).tolist())
                k += 1
            for i in reversed(absent):
                del residue[i]
        # Frames may lack caps.
        for chain, i in [(c, i) for c in model[0] for i in reversed(range(len(c))) if not len(c[i])]:
            del chain[i]
        complete = as_structure(model, s.name, **{"keep": "all", **self.settings})
        built = dict(zip(_keys(complete), complete.positions, strict=True))
        x, keys = np.array(x), _keys(s)
        for k in np.flatnonzero(np.isnan(x[:, 0]) & (s.atom_element != "H")).tolist():
            if keys[k] not in built:
                raise StructureError(f"{s.describe(k)} cannot be built; give frames with all heavy atoms")
            x[k] = built[keys[k]]
        return x


def _keys(s: Structure) -> list[tuple[str, ...]]:
    res = s.atom_residue
    columns = (s.residue_chain[res], s.residue_number[res], s.residue_insertion_code[res], s.atom_name)
    return [tuple(map(str, row)) for row in zip(*columns, strict=True)]


def _places(s: Structure, frames: Frames) -> Integers:
    if frames.sequence:
        return _places_in_backbones(s, frames)
    origin = s.origin
    if frames.names and origin:
        return _places_by_name(s, frames)
    n_filed = len(origin.atoms) if origin else s.n_atoms
    orders = []
    if origin and frames.n_atoms == n_filed:
        orders.append(origin.place)
    if frames.n_atoms == s.n_atoms:
        orders.append(np.arange(s.n_atoms))
    if not orders:
        prepared = "" if s.n_atoms == n_filed else f", and {s.n_atoms} as it is prepared"
        raise StructureError(
            f"{frames.source}: has {frames.n_atoms} atoms a frame, but {s.name} {n_filed}{prepared}; "
            "give the topology of the frames"
        )
    if len(orders) > 1:
        x = next((frame.x for frame in frames if frame.x is not None), None)
        if x is not None:
            orders.sort(key=lambda place: _length(s, place, x))
    return orders[0]


def _length(s: Structure, place: Integers, x: Floats) -> float:
    """Sum of the lengths of all bonds, if the atoms are in these places."""
    bonds = s.bonds[(place[s.bonds] >= 0).all(axis=1)]
    return float(np.nansum(np.linalg.norm(x[place[bonds[:, 0]]] - x[place[bonds[:, 1]]], axis=1)))


def _places_by_name(s: Structure, frames: Frames) -> Integers:
    assert s.origin
    at = {name: k for k, name in enumerate(frames.names)}
    names = [s.origin.atoms[place] if place >= 0 else "" for place in s.origin.place.tolist()]
    elements = zip(names, s.atom_element.tolist(), strict=True)
    absent = [name for name, element in elements if name and element != "H" and name not in at]
    if absent:
        raise StructureError(
            f"{frames.source}: has no atom {absent[0]}, which {s.name} has; give the topology of the frames"
        )
    return np.array([at.get(name, -1) for name in names])


def _places_in_backbones(s: Structure, frames: Frames) -> Integers:
    amino = [r for r in range(s.n_residues) if {*BACKBONE} <= {*s.atom_name[s.atom_residue == r].tolist()}]
    sequence = gemmi.one_letter_code([str(s.residue_name[r]) for r in amino]).upper()
    fits = len(sequence) == len(frames.sequence) and all(
        a in (b, "X") for a, b in zip(frames.sequence, sequence, strict=True)
    )
    if not fits or s.kept.any() or len(amino) < s.n_residues:
        raise StructureError(
            f"{frames.source}: holds backbones of {frames.sequence}, but {s.name} is {sequence}"
            f"{' and other molecules' * bool(s.kept.any())}; give the topology of the frames"
        )
    row = {r: k for k, r in enumerate(amino)}
    atoms = zip(s.atom_name.tolist(), s.atom_residue.tolist(), strict=True)
    return np.array([4 * row[r] + _IN_FRAMES.index(name) if name in _IN_FRAMES else -1 for name, r in atoms])
