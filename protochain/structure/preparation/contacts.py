"""Contact score of the ends of a side chain, by dots on their surfaces.

Probe's score (Word et al., J. Mol. Biol. 285:1711, 1999) of a dot by its gap to the nearest atom, angstrom:
exp(-(gap / 0.25)^2) at a contact, -10 times half an overlap, 4 times half the overlap of a hydrogen bond. An
overlap of a hydrogen bond beyond 0.6 is a clash. The sum is divided by the dots of a square angstrom.
"""

from collections.abc import Collection, Mapping, Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist

from protochain.core.arrays import Floats, sphere
from protochain.core.graph import neighbours
from protochain.structure.molecule.hydrogens import place_hydrogens
from protochain.structure.molecule.member import Member
from protochain.structure.molecule.templates import Template

RADII = {"C": 1.70, "N": 1.55, "O": 1.40, "S": 1.80, "P": 1.80, "F": 1.30, "Cl": 1.77, "Br": 1.95}
CARBONYL, POLAR, OTHER, METAL = 1.65, 1.05, 1.22, 1.0
"""Angstrom: radii of C=O carbons, hydrogens of nitrogen and aromatic rings, other hydrogens, metals."""
_DENSITY, _WIDTH, _BUMP, _BOND, _DEEPEST, _FARTHEST = 16.0, 0.25, 5.0, 2.0, 0.6, 0.5
"""Dots per square angstrom, width of a contact, weights, limits of a hydrogen bond and of a gap, angstrom."""
_BONDED = 1.9
_COVERED = 2.7  # Angstrom: atoms of the side chain nearer than this to one another cover dots.
_HISTIDINE: Mapping[str, Sequence[str]] = {"N": ["H"], "CA": ["HA"], "CB": ["HB2", "HB3"]}


class Spheres(NamedTuple):
    """Atoms as spheres."""

    x: Floats  # (n, 3) angstrom.
    radius: Floats  # (n,) angstrom.
    donor: np.ndarray  # (n,) bool: Whether it is a polar hydrogen or a metal.
    acceptor: np.ndarray  # (n,) bool: Whether it accepts a hydrogen bond.
    rotor: np.ndarray  # (n,) bool: Whether its hydrogens turn to an acceptor.

    def subset(self, index: Any) -> "Spheres":
        """Return the spheres of an index."""
        return Spheres(*(column[index] for column in self))


def surroundings(
    residues: Sequence[tuple[Member, Template | None]], ends: Mapping[int, Collection[str]]
) -> tuple[Spheres, np.ndarray]:
    """Return the atoms outside the ends, with hydrogens by geometry, and the ``id`` of their residues."""
    heavy = [(a, m, _HISTIDINE if t is None else t.hydrogens) for m, t in residues for a in m.heavy]
    x, elements = [a.pos.tolist() for a, *_ in heavy], [a.element.name for a, *_ in heavy]
    bonds = KDTree(x).query_pairs(_BONDED, output_type="ndarray")
    near = neighbours(bonds, len(heavy))
    rows, parents = [], list[int]()
    for k, (a, m, hydrogens) in enumerate(heavy):
        element, n = a.element.name, len(hydrogens.get(a.name, ()))
        is_end = a.name in ends.get(id(m), ())
        rotor = n > 0 and (element in "OS" or (element == "N" and (n == 3 or not near[k])))
        acceptor = element in "OS" or (element == "N" and n == 0 and len(near[k]) == 2)
        radius = RADII.get(element, RADII["S"])
        if element == "C" and any(elements[j] == "O" for j in near[k]):
            radius = CARBONYL
        is_metal = a.element.is_metal
        rows.append((METAL if is_metal else radius, is_metal, acceptor, rotor, id(m), not is_end))
        parents += [k] * n * (bool(near[k]) and not is_end and not rotor)
    for k in parents:
        is_polar = elements[k] == "N"
        rows.append((POLAR if is_polar else OTHER, is_polar, False, False, rows[k][4], True))
    bonds = np.concatenate([bonds, np.column_stack([parents, len(heavy) + np.arange(len(parents))])])
    start = 0.1 * np.concatenate([x, np.full((len(parents), 3), np.nan)])
    placed = place_hydrogens(start, elements + ["H"] * len(parents), np.zeros(len(start)), bonds.astype(int))
    *columns, owner, is_outside = (np.array(column) for column in zip(*rows, strict=True))
    is_used = is_outside & np.isfinite(placed[:, 0])
    return Spheres(10.0 * placed, *columns).subset(is_used), owner[is_used]


def score(ends: Spheres, stem: Floats, near: Spheres) -> float:
    """Return the contact score of the ends of a side chain. Its stem atoms (n, 3), angstrom, cover dots."""
    total = 0.0
    x, r = np.concatenate([ends.x, stem]), np.concatenate([ends.radius, np.full(len(stem), 1.6)])
    for k, radius in enumerate(ends.radius.tolist()):
        dots = ends.x[k] + radius * _directions(radius)
        distance = np.linalg.norm(x - ends.x[k], axis=1)
        covers = (distance < _COVERED) & (np.arange(len(x)) != k)
        dots = dots[(cdist(dots, x[covers]) > r[covers]).all(axis=1)]
        vector = ends.x[k] - near.x
        length = np.maximum(np.linalg.norm(vector, axis=1), 1e-9)
        turned = near.rotor & ends.acceptor[k]
        reached = length - near.radius - turned < radius + _FARTHEST
        if not len(dots) or not reached.any():
            continue
        centre = (near.x + turned[:, None] * vector / length[:, None])[reached]
        gaps = cdist(dots, centre) - np.where(turned, POLAR, near.radius)[reached]
        bonds = (ends.donor[k] & near.acceptor | ends.acceptor[k] & (near.donor | turned))[reached]
        gap, bond = gaps.min(axis=1), bonds[gaps.argmin(axis=1)]
        overlap = np.maximum(-gap, 0.0)
        within = np.where(bond, np.minimum(overlap, _DEEPEST), 0.0)
        contact = np.where((gap > 0.0) & (gap < _FARTHEST), np.exp(-((gap / _WIDTH) ** 2)), 0.0)
        total += float((contact + _BOND * within - _BUMP * (overlap - within)).sum())
    return total / _DENSITY


@cache
def _directions(radius: float) -> Floats:
    return sphere(round(4.0 * np.pi * radius**2 * _DENSITY))
