"""Rotate side chains about their bonds, with fixed bond lengths and angles."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from protochain.core.arrays import Floats, Integers, cross, dihedral
from protochain.core.graph import beyond
from protochain.structure.sidechains.ideal import unit
from protochain.structure.sidechains.rotamers import BACKBONE

WIDTH = np.deg2rad(20.0)
"""Standard deviation of a dihedral about its rotamer."""


@dataclass(frozen=True, eq=False)
class Arm:
    """Rotatable part of a side chain."""

    axes: tuple[tuple[int, ...], ...]  # Atoms that define each dihedral, from the backbone outward.
    outward: tuple[Integers, ...]  # Atoms that each dihedral rotates. The first rotates all of them.

    @property
    def moved_atoms(self) -> Integers:
        """(n_moved,) int: atoms that any dihedral turns."""
        return self.outward[0]

    def dihedrals(self, x: Floats) -> Floats:
        """(n_chi,) float, rad: dihedrals of positions x (na, 3)."""
        return np.array([float(dihedral(*x[list(quartet)])) for quartet in self.axes])

    def positions_at(self, x: Floats, chi: Floats) -> Floats:
        """Rotate the moved atoms of x (na, 3) to dihedrals (n, n_chi), rad: positions (n, n_moved, 3)."""
        tried = np.repeat(x[self.moved_atoms][None], len(chi), axis=0)
        row = {int(atom): k for k, atom in enumerate(self.moved_atoms)}
        for k, (quartet, atoms) in enumerate(zip(self.axes, self.outward, strict=True)):
            at = [tried[:, row[i]] if i in row else x[i] for i in quartet]
            rows = [row[int(i)] for i in atoms]
            tried[:, rows] = rotate(tried[:, rows], at[1], at[2], chi[:, k] - dihedral(*at))
        return tried


def arm_of(bonded: Sequence[Sequence[int]], axes: Sequence[tuple[int, ...]]) -> Arm:
    """Return the side chain with these dihedral axes. ``bonded`` lists the neighbours of each atom."""
    outward = (np.array(sorted(beyond(bonded, *quartet[1:3])), dtype=np.int64) for quartet in axes)
    return Arm(tuple(axes), tuple(outward))


def backbone_of(
    bonded: Sequence[Sequence[int]], at: Mapping[str, int], x: Floats, mirror: int
) -> tuple[float, float]:
    """Return phi and psi (degrees) at x (na, 3), usual at ends. If ``mirror`` is -1, of the mirror image."""
    residue_atoms, angles = set(at.values()), list(BACKBONE)
    inner = [at[name] for name in ("N", "CA", "C")]
    for k, end in enumerate(("N", "C")):
        for neighbour in [i for i in bonded[at[end]] if i not in residue_atoms][:1]:
            quartet = [neighbour, *inner] if end == "N" else [*inner, neighbour]
            angles[k] = mirror * float(np.rad2deg(dihedral(*x[quartet])))
    return angles[0], angles[1]


def dihedral_grid(
    chi: Floats, rarity: Floats, turns: Iterable[float], n_turned: int, width: float = WIDTH
) -> tuple[Floats, Floats]:
    """Return dihedrals (m, n_chi) around rotamers chi (n, n_chi), rad, and their costs (m,)."""
    ways = list(product(turns, repeat=n_turned))
    steps = np.zeros((len(ways), chi.shape[1]))
    steps[:, :n_turned] = ways
    cost = (rarity[:, None] + 0.5 * ((steps / width) ** 2).sum(axis=1)).ravel()
    return (chi[:, None] + steps).reshape(len(cost), chi.shape[1]), cost


def rotate(x: Floats, start: Floats, end: Floats, angle: Floats) -> Floats:
    """Rotate positions (n, k, 3) about the axis from start to end, (3,) or (n, 3), by angles (n,)."""
    axis = np.broadcast_to(unit(end - start), (len(angle), 3))[:, None]
    arm = x - np.broadcast_to(end, (len(angle), 3))[:, None]
    c, s = np.cos(angle)[:, None, None], np.sin(angle)[:, None, None]
    along = axis * (axis * arm).sum(axis=-1, keepdims=True)
    turned = along + c * (arm - along) + s * cross(axis, arm)
    return np.asarray(np.broadcast_to(end, (len(angle), 3))[:, None] + turned)


def wrap_angle(angle: Floats) -> Floats:
    """Wrap angles to the range from -pi to pi."""
    return np.asarray((angle + np.pi) % (2 * np.pi) - np.pi)
