"""Side chains of a structure that can turn, and the dihedrals to try: rotamers, and those of the input."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from protochain.core.arrays import Floats
from protochain.relaxation.rotamer_energies import Rotamers
from protochain.structure import residues
from protochain.structure.chirality import volume
from protochain.structure.model import Structure
from protochain.structure.packing import WIDTH, wrapped
from protochain.structure.repairs import Kind, Repair
from protochain.structure.rotamers import rotamers
from protochain.structure.sidechains import dihedral
from protochain.structure.turning import beyond, turned

_RARITY = 5.0
"""kJ/mol: of the logarithm of a rotamer's frequency, twice kT."""
_RAREST = 10.0
"""Rarity of the input's dihedrals, at most: an outlier is no worse than the rarest rotamers."""
_STAYING = 10.0
"""kJ/mol that a turn must gain: what relaxing can mend stays."""
_TURNS = np.deg2rad([0.0, -12.0, 12.0])
"""About chi1 of a rotamer."""
_HALF_TURNS = {"ASP": 1, "GLU": 2, "PHE": 1, "TYR": 1}
"""Place of the chi whose half turn exchanges equal atoms."""
_STAGGERED, _PLANAR = np.deg2rad([60.0, 180.0, -60.0]), np.deg2rad([0.0, 180.0])
_POLAR = {"CYS": _STAGGERED, "SER": _STAGGERED, "THR": _STAGGERED, "TYR": _PLANAR}
"""Dihedrals of hydroxyl and thiol hydrogens."""


@dataclass(frozen=True, eq=False)
class Arm:
    """A side chain that can turn.

    Parameters
    ----------
    residue : int
    chi : (n, n_chi) float, rad
        Dihedrals to try, those of the input first; those of a polar hydrogen last.
    n_chi : int
        Dihedrals without that of a polar hydrogen.
    rotamers : Rotamers
        Positions at these dihedrals.
    """

    residue: int
    chi: Floats
    n_chi: int
    rotamers: Rotamers

    def repair(self, state: int, residue: residues.Residue) -> Repair:
        """How it is turned."""
        before, after = np.rint(np.rad2deg(wrapped(self.chi[[0, state], : self.n_chi]))).astype(int)
        if (before == after).all():
            return Repair(Kind.HYDROGEN_TURNED, {"residue": residue})
        old, new = (
            " ".join(f"chi{k} {value}" for k, value in enumerate(each.tolist(), 1))
            for each in (before, after)
        )
        return Repair(Kind.SIDE_CHAIN_TURNED, {"residue": residue, "before": old, "after": new})


class Arms:
    """Side chains of a structure at positions x (na, 3), nm."""

    def __init__(self, structure: Structure, x: Floats, moving: NDArray[np.bool_] | None = None) -> None:
        self.structure, self.x = structure, x
        self._held = structure.kept.copy()
        if moving is not None:
            self._held |= ~moving
        self._held[[atom for tie in structure.ties for atom in tie.atoms]] = True
        self._first = np.searchsorted(structure.atom_residue, np.arange(structure.n_residues + 1))

    def of(self, residue: int) -> Arm | None:
        """What of a residue can turn; None for one without chi, or bonded to others by its side chain."""
        name = str(self.structure.residue_name[residue])
        atoms = range(self._first[residue], self._first[residue + 1])
        at = {str(self.structure.atom_name[i]): i for i in atoms if not self.structure.kept[i]}
        library, frequency = rotamers(name)
        quartets = [*residues.CHI.get(name, ())[: library.shape[-1]]] if len(library) else []
        if not quartets or not all(atom in at for quartet in quartets for atom in quartet):
            return None
        n_chi = len(quartets)
        polar = [q for q in residues.ROTORS.get(name, ()) if q[3] in at and q[2][0] in "OS"]
        quartets += polar if name in _POLAR else []
        axes = [tuple(at[atom] for atom in quartet) for quartet in quartets]
        outward = [
            np.array(sorted(beyond(self.structure.neighbours, a[1], a[2])), dtype=np.int64) for a in axes
        ]
        moved = outward[0]
        side = set(at.values()) - {at[atom] for atom in ("N", "CA", "C", "O") if atom in at}
        if not set(moved.tolist()) <= side or self._held[moved].any():
            return None
        now = np.array([float(dihedral(*self.x[list(quartet)])) for quartet in axes])
        hand = self._hand(at)
        chi, rarity = _tried(name, now[:n_chi], hand * library, -np.log(frequency))
        if polar and n_chi < len(axes):
            chi, rarity = _with_hydrogen(chi, rarity, float(now[-1]), _POLAR[name])
        x = turned(self.x, axes, outward, chi, moved)
        # Those of the input stay bit for bit.
        x[0] = self.x[moved]
        cost = _RARITY * rarity
        cost[0] -= _STAYING
        return Arm(residue, chi, n_chi, Rotamers(moved, x, cost))

    def _hand(self, at: dict[str, int]) -> int:
        names = ("CA", "N", "C", "CB")
        return -1 if volume(self.x[[at[name] for name in names]]) < 0.0 else 1


def _tried(name: str, now: Floats, library: Floats, rarity: Floats) -> tuple[Floats, Floats]:
    """Dihedrals (n, n_chi), rad, and rarities (n,): those of now, and rotamers with turns about them."""
    off = wrapped(library - now)
    if name in _HALF_TURNS:
        last = _HALF_TURNS[name]
        # Of the two that are equal, the one nearer to the input.
        flipped = wrapped(off[:, last] + np.pi)
        off[:, last] = np.where(np.abs(flipped) < np.abs(off[:, last]), flipped, off[:, last])
    unlikely = rarity + 0.5 * ((off / WIDTH) ** 2).sum(axis=1)
    steps = np.zeros((len(_TURNS), len(now)))
    steps[:, 0] = _TURNS
    chi = (now + off[:, None] + steps).reshape(-1, len(now))
    cost = (rarity[:, None] + 0.5 * ((steps / WIDTH) ** 2).sum(axis=1)).ravel()
    return np.vstack([now, chi]), np.append(min(float(unlikely.min()), _RAREST), cost)


def _with_hydrogen(chi: Floats, rarity: Floats, now: float, turns: Floats) -> tuple[Floats, Floats]:
    """With a dihedral of a polar hydrogen: all turns for each, and that of the input for the input's."""
    n = len(turns)
    each = np.column_stack([np.repeat(chi, n, axis=0), np.tile(turns, len(chi))])
    first = np.append(chi[0], now)
    return np.vstack([first, each]), np.append(rarity[0], np.repeat(rarity, n))


def arms(
    structure: Structure, x: Floats, residues: Sequence[int], moving: NDArray[np.bool_] | None = None
) -> list[Arm]:
    """Side chains of residues that can turn.

    Parameters
    ----------
    structure : Structure
    x : (na, 3) float, nm
    residues : sequence of int
    moving : (na,) bool, optional
        Atoms that may move; all by default.

    Returns
    -------
    list of Arm
    """
    here = Arms(structure, x, moving)
    return [arm for residue in residues if (arm := here.of(residue)) is not None]
