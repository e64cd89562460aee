"""Shape complementarity of two sides of an interface: Sc of Lawrence and Colman.

J. Mol. Biol. 234:946 (1993). Each dot of one surface that the other side buries, with the nearest dot on the
other, has S = -n.n' exp(-w d^2). Sc is the mean of the medians of both sides, weighted by the areas of
the dots. Dots within a band at the periphery of the contact do not count.
"""

import numpy as np
from scipy.spatial import cKDTree

from protochain.core.arrays import Floats, Integers
from protochain.core.graph import both_ways
from protochain.core.units import ANGSTROM_PER_NM
from protochain.structure.molecule.model import Structure
from protochain.validation.dots import Dots, molecular_surface

PROBE, DENSITY, BAND, WEIGHT = 1.7, 15.0, 1.5, 0.5
"""angstrom, 1/angstrom^2, angstrom, 1/angstrom^2: the probe, dots to an area, the periphery, and w."""
_RADIUS = {
    "C": (1.80, 1.85, 1.90, 1.95), "N": (1.65, 1.65, 1.70, 1.75), "O": (1.60, 1.70, 1.70), "S": (1.90,),
    "P": (1.80,),
}  # fmt: skip
"""angstrom, of atoms with 0, 1, 2 ... hydrogens: radii of CCP4's program sc by Lawrence. It selects them by
names of atoms, this module by numbers of hydrogens, so that ligands and nucleotides have them too."""
_AROMATIC_CH, _OTHERS = 1.90, 1.90
_BEYOND = 2.0 * BAND  # angstrom around atoms that may be buried, so that their periphery is known.


def united_radii(structure: Structure) -> Floats:
    """(na,) float, angstrom: radii of heavy atoms with their hydrogens, 0 for hydrogens."""
    element, n = np.char.upper(structure.atom_element), structure.n_atoms
    ends, is_h = both_ways(structure.bonds), element == "H"
    degree = np.bincount(ends[:, 0], minlength=n)
    hydrogens = np.bincount(ends[is_h[ends[:, 1]], 0], minlength=n)
    radii = [_RADIUS.get(symbol, (_OTHERS,)) for symbol in element.tolist()]
    radius = np.array([row[min(k, len(row) - 1)] for row, k in zip(radii, hydrogens.tolist(), strict=True)])
    radius[(element == "C") & (degree == 3) & (hydrogens == 1)] = _AROMATIC_CH
    radius[is_h] = 0.0
    return radius


def shape_complementarity(structure: Structure, x: Floats, first: Integers, second: Integers) -> float:
    """Sc of two sides: x (na, 3) nm, first, second (n,) int."""
    radius = united_radii(structure)
    heavy = [atoms[radius[atoms] > 0.0] for atoms in (first, second)]
    parts = [(ANGSTROM_PER_NM * x[atoms], radius[atoms]) for atoms in heavy]
    buried = [_buried_dots(*parts[k], *parts[1 - k]) for k in (0, 1)]
    return complementarity(*buried)


def complementarity(first: Dots, second: Dots) -> float:
    """Sc of the buried surfaces of two sides. NaN if a side has no dot."""
    if not len(first) or not len(second):
        return float("nan")
    return float(np.mean([_median(first, second), _median(second, first)]))


def _buried_dots(x: Floats, radius: Floats, partner: Floats, partner_radius: Floats) -> Dots:
    """Dots of a side that the other hides from the probe, without the periphery."""
    tree, reach = cKDTree(partner), partner_radius + PROBE
    near = tree.query(x)[0] < (radius + PROBE + _BEYOND + reach.max(initial=0.0))
    dots = molecular_surface(x, radius, PROBE, DENSITY, near)
    if not len(dots):
        return dots
    pairs = cKDTree(dots.probe).sparse_distance_matrix(tree, reach.max(), output_type="ndarray")
    hidden = np.zeros(len(dots), dtype=bool)
    hidden[pairs["i"][pairs["v"] < reach[pairs["j"]]]] = True
    if hidden.any() and not hidden.all():
        hidden[hidden] = cKDTree(dots.x[~hidden]).query(dots.x[hidden])[0] > BAND
    return dots[hidden]


def _median(first: Dots, second: Dots) -> float:
    """Median of S over the area of a side."""
    distance, nearest = cKDTree(second.x).query(first.x)
    s = -(first.normal * second.normal[nearest]).sum(axis=1) * np.exp(-WEIGHT * distance**2)
    order = np.argsort(s)
    below = np.cumsum(first.area[order])
    return float(s[order][np.searchsorted(below, 0.5 * below[-1])])
