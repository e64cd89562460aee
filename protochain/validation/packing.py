"""Packing of two sides of an interface: the share of the volume between them that their atoms fill.

The volume is within 2.8 angstrom of both sides, and a probe of 1.4 angstrom cannot reach it. The share is 1
without voids, and 0.74 in a close packing of spheres. Rosetta's packstat has the same aim (Sheffler, Baker,
Protein Sci. 18:229, 2009), with a trained scale in place of volumes (Richards, J. Mol. Biol. 82:1, 1974).
"""

import numpy as np
from scipy.spatial import cKDTree

from protochain.core.arrays import Floats

PROBE, REACH, GRID = 1.4, 2.8, 0.4
"""angstrom: radius of water, distance from either side, distance between points."""
_STEP = 0.1  # angstrom between sizes of balls.
_FEW = 4  # Number of nearest centres. One of them belongs to the nearest surface.


def packing(x: Floats, radius: Floats, partner: Floats, partner_radius: Floats) -> float:
    """Packing of spheres of two sides: centres (n, 3) and radii (n,), angstrom. NaN if none are near."""
    if not len(x) or not len(partner):
        return float("nan")
    limit, largest = 2.0 * REACH + partner_radius.max(), max(radius.max(), partner_radius.max())
    near = cKDTree(partner).query(x, distance_upper_bound=limit + radius.max())[0] < limit + radius
    between = _grid_around(x[near], radius.max() + REACH)
    for place, size in ((x, radius), (partner, partner_radius)):
        between = between[_outside(between, place, size, REACH) < REACH]
    x, radius = np.concatenate([x, partner]), np.concatenate([radius, partner_radius])
    distance = _outside(between, x, radius, largest)
    filled, void = int((distance < 0.0).sum()), between[distance >= 0.0]
    empty = _grid_around(void, PROBE)
    room = np.minimum(_outside(empty, x, radius, 2.0 * PROBE), 2.0 * PROBE - _STEP)
    # Remove the points that a probe reaches: balls without atoms, of at least its radius, contain them.
    for least in np.arange(PROBE, 2.0 * PROBE, _STEP):
        if (mask := (room >= least) & (room < least + _STEP)).any():
            void = void[cKDTree(empty[mask]).query(void, distance_upper_bound=least)[0] > least]
    return filled / (filled + len(void)) if filled else float("nan")


def _grid_around(x: Floats, reach: float) -> Floats:
    """(n, 3) points of the grid within reach of any of x, and of the nearest point of the grid to it."""
    reach += GRID
    n = int(reach / GRID) + 1
    steps = np.stack(np.meshgrid(*[np.arange(-n, n + 1)] * 3), axis=-1).reshape(-1, 3)
    steps = steps[np.sum((GRID * steps) ** 2, axis=1) <= reach**2]
    nearest = np.rint(x / GRID).astype(np.int64)
    low = nearest.min(axis=0, initial=0) - n
    shape = tuple((nearest.max(axis=0, initial=0) - low + n + 1).tolist())
    row = np.array([shape[1] * shape[2], shape[2], 1])
    occupied = np.zeros(shape, dtype=bool)
    occupied.ravel()[((nearest - low) @ row)[:, None] + steps @ row] = True
    return GRID * (np.argwhere(occupied) + low)


def _outside(points: Floats, x: Floats, radius: Floats, limit: float) -> Floats:
    """(n,) distance of points from the nearest sphere's surface, inf beyond ``limit``."""
    distance, nearest = cKDTree(x).query(points, _FEW, distance_upper_bound=radius.max() + limit)
    return np.min(distance - np.append(radius, 0.0)[nearest], axis=1)
