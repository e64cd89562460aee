"""Side chains turned about their bonds: bond lengths and angles stay."""

from collections.abc import Sequence

import numpy as np

from protochain.core.arrays import Floats, Integers
from protochain.structure.sidechains import dihedral, unit


def beyond(bonded: Sequence[Sequence[int]], first: int, second: int) -> set[int]:
    """Atoms on the second's side of a bond, without the second.

    Parameters
    ----------
    bonded : sequence of sequence of int
        Bonded atoms of each atom.
    first, second : int
        The bond's atoms; if it is of a ring, the atoms beyond lead back to the first, which is left out.
    """
    found, ahead = {first, second}, [second]
    while ahead:
        fresh = [i for i in bonded[ahead.pop()] if i not in found]
        found.update(fresh)
        ahead += fresh
    return found - {first, second}


def turned(
    x: Floats, axes: Sequence[Sequence[int]], outward: Sequence[Integers], chi: Floats, moved: Integers
) -> Floats:
    """Positions of a side chain at sets of dihedrals.

    Parameters
    ----------
    x : (na, 3) float
        All atoms, where they are now.
    axes : sequence of (4,) int
        Atoms that define each dihedral, from the backbone outward.
    outward : sequence of (n_turned,) int
        Atoms that each dihedral turns.
    chi : (n, n_chi) float, rad
    moved : (n_moved,) int
        Atoms that any of them turns.

    Returns
    -------
    (n, n_moved, 3) float
    """
    tried = np.repeat(x[moved][None], len(chi), axis=0)
    row = {int(atom): k for k, atom in enumerate(moved)}
    for k, (quartet, its) in enumerate(zip(axes, outward, strict=True)):
        at = [tried[:, row[i]] if i in row else x[i] for i in map(int, quartet)]
        rows = [row[int(i)] for i in its]
        tried[:, rows] = rotated(tried[:, rows], at[1], at[2], chi[:, k] - dihedral(*at))
    return tried


def rotated(x: Floats, start: Floats, end: Floats, angle: Floats) -> Floats:
    """Rotate positions (n, k, 3) about the axis from start to end, (3,) or (n, 3), by angles (n,)."""
    axis = np.broadcast_to(unit(end - start), (len(angle), 3))[:, None]
    arm = x - np.broadcast_to(end, (len(angle), 3))[:, None]
    c, s = np.cos(angle)[:, None, None], np.sin(angle)[:, None, None]
    along = axis * (axis * arm).sum(axis=-1, keepdims=True)
    turned = along + c * (arm - along) + s * np.cross(axis, arm)
    return np.asarray(np.broadcast_to(end, (len(angle), 3))[:, None] + turned)
