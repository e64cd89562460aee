"""Turning side chains of a structure, and their candidate dihedrals: rotamers, and the input's."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from protochain.core.arrays import Floats, Integers
from protochain.structure.molecule import residues
from protochain.structure.molecule.chirality import volume
from protochain.structure.molecule.model import Structure
from protochain.structure.molecule.repairs import Kind, Repair
from protochain.structure.sidechains.arms import WIDTH, arm_of, backbone_of, dihedral_grid, wrap_angle
from protochain.structure.sidechains.rotamers import rotamers

_MOST_CHI = 4  # The fifth chi of arginine is planar.
_RARITY = 5.0  # kJ/mol: factor of the logarithm of a rotamer's frequency, twice kT.
_RAREST = 10.0
"""Upper limit of the rarity of the input's dihedrals: outliers cost as much as the rarest rotamers."""
_STAYING = 10.0  # kJ/mol that a turn must gain. Relaxation removes smaller strain.
_TURNS = np.deg2rad([0.0, -12.0, 12.0])  # Turns about chi1 of a rotamer.
_STAGGERED, _PLANAR = np.deg2rad([60.0, 180.0, -60.0]), np.deg2rad([0.0, 180.0])
_POLAR = {"CYS": _STAGGERED, "SER": _STAGGERED, "THR": _STAGGERED, "TYR": _PLANAR}
"""Dihedrals of hydroxyl and thiol hydrogens."""


@dataclass(frozen=True, eq=False)
class Rotamers:
    """Candidate positions of the side chain of a residue."""

    residue: int
    atoms: Integers  # (k,) int: Turning atoms.
    chi: Floats  # (n, n_chi) rad: Candidate dihedrals, the input's in row 0, a polar hydrogen's in column -1.
    n_chi: int  # Number of dihedrals without the polar hydrogen's.
    x: Floats  # (n, k, 3) nm.
    cost: Floats  # (n,) kJ/mol: Energy of their rarity.

    def repair(self, state: int, residue: residues.Residue) -> Repair:
        """Repair that reports the turn."""
        before, after = np.rint(np.rad2deg(wrap_angle(self.chi[[0, state], : self.n_chi]))).astype(int)
        if (before == after).all():
            return Repair(Kind.HYDROGEN_TURNED, {"residue": residue})
        ends = before.tolist(), after.tolist()
        old, new = (" ".join(f"chi{k} {value}" for k, value in enumerate(end, 1)) for end in ends)
        return Repair(Kind.SIDE_CHAIN_TURNED, {"residue": residue, "before": old, "after": new})


def rotamers_of(
    structure: Structure, x: Floats, residues: Sequence[int], moving: NDArray[np.bool_] | None = None
) -> list[Rotamers]:
    """Rotamers of the turning side chains: x (na, 3) nm, moving (na,) bool."""
    fixed = structure.kept.copy()
    if moving is not None:
        fixed |= ~moving
    fixed[[atom for tie in structure.ties for atom in tie.atoms]] = True
    first = np.searchsorted(structure.atom_residue, np.arange(structure.n_residues + 1))
    atoms = (range(first[residue], first[residue + 1]) for residue in residues)
    side_chains = map(partial(_of_residue, structure, x, fixed), residues, atoms)
    return [side_chain for side_chain in side_chains if side_chain is not None]


def _of_residue(
    structure: Structure, x: Floats, fixed: NDArray[np.bool_], residue: int, atoms: Sequence[int]
) -> Rotamers | None:
    """Rotamers of a residue, or None if it has no chi, or its side chain is bonded to others."""
    name = str(structure.residue_name[residue])
    at = {str(structure.atom_name[i]): i for i in atoms if not structure.kept[i]}
    quartets = [*residues.CHI.get(name, ())[:_MOST_CHI]]
    if not quartets or not all(atom in at for quartet in quartets for atom in quartet):
        return None
    n_chi = len(quartets)
    polar = [q for q in residues.ROTORS.get(name, ()) if q[3] in at and q[2][0] in "OS"]
    quartets += polar if name in _POLAR else []
    arm = arm_of(structure.neighbours, [tuple(at[atom] for atom in quartet) for quartet in quartets])
    side = set(at.values()) - {at[atom] for atom in ("N", "CA", "C", "O") if atom in at}
    if not set(arm.moved_atoms.tolist()) <= side or fixed[arm.moved_atoms].any():
        return None
    now = arm.dihedrals(x)
    mirror = -1 if volume(x[[at[name] for name in ("CA", "N", "C", "CB")]]) < 0.0 else 1
    library, frequency = rotamers(name, *backbone_of(structure.neighbours, at, x, mirror))
    chi, rarity = _candidate_dihedrals(name, now[:n_chi], mirror * library, -np.log(frequency))
    if polar and n_chi < len(quartets):
        chi, rarity = _with_hydrogen(chi, rarity, float(now[-1]), _POLAR[name])
    turned = arm.positions_at(x, chi)
    # The input's positions are preserved bit for bit.
    turned[0] = x[arm.moved_atoms]
    cost = _RARITY * rarity
    cost[0] -= _STAYING
    return Rotamers(residue, arm.moved_atoms, chi, n_chi, turned, cost)


def _candidate_dihedrals(name: str, now: Floats, library: Floats, rarity: Floats) -> tuple[Floats, Floats]:
    """Dihedrals (n, n_chi), rad, and rarities (n,) of the input, and of rotamers with turns about them."""
    off = wrap_angle(library - now)
    if name in residues.SYMMETRIC:
        # Of two equivalent dihedrals, use the nearer to the input.
        flipped = wrap_angle(off[:, -1] + np.pi)
        off[:, -1] = np.where(np.abs(flipped) < np.abs(off[:, -1]), flipped, off[:, -1])
    unlikely = rarity + 0.5 * ((off / WIDTH) ** 2).sum(axis=1)
    chi, cost = dihedral_grid(now + off, rarity, _TURNS, 1)
    return np.vstack([now, chi]), np.append(min(float(unlikely.min()), _RAREST), cost)


def _with_hydrogen(chi: Floats, rarity: Floats, now: float, turns: Floats) -> tuple[Floats, Floats]:
    """Add a dihedral of a polar hydrogen: the input's to row 0, and all turns to each row."""
    n = len(turns)
    combined = np.column_stack([np.repeat(chi, n, axis=0), np.tile(turns, len(chi))])
    first = np.append(chi[0], now)
    return np.vstack([first, combined]), np.append(rarity[0], np.repeat(rarity, n))
