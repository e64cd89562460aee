"""Far interactions: charges of the atoms by kind, the fields of their nodes, and their targets.

If exp(-r^2 / 4 B B) is negligible, Coulomb and generalised Born are one interaction, q q / (78.5 r). Its far
field is a 78th of Coulomb's. Otherwise tiles add the difference of 1/f and 1/r. Born integrals of far atoms
are s^3 (c_0 / r^4 + c_1 s^2 / r^6). Lennard-Jones is -B / r^6, with B as a sum of few products of factors.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from protochain.core.arrays import Floats, Integers
from protochain.core.settings import document_fields
from protochain.energies.native.evaluate import Layout
from protochain.energies.native.expansion import POWER, n_terms, tables
from protochain.energies.native.layout import W, n_blocks
from protochain.energies.native.terms import Terms
from protochain.energies.native.tree import FIRST, LEFT, Tree

_SMALLEST = 0.15
"""Largest s / r at which two terms approximate the descreening integral to 1.7e-4 of its value."""
_LEAST = 1.0  # nm. Smallest distance of far atoms: r^-12 is negligible, and no pair is bonded.
_REST = 2  # Order of the correction for scaled radii that differ from the mean, in integrals.
_FACTORED = 3e-4  # Largest error of the products of factors, as a share of the largest B.


def _two_terms() -> tuple[float, float]:
    y = np.linspace(0.0, _SMALLEST**2, 200)
    g = np.sum([2 * k / (2 * k + 1) * y ** (k - 1) for k in range(1, 40)], axis=0)
    return 2.0 / 3.0, float(np.sum((g - 2.0 / 3.0) * y) / np.sum(y * y))


FAR_TERMS = _two_terms()  # c_0 and c_1 of s^3 / 2 (c_0 / r^4 + c_1 s^2 / r^6).


@document_fields
@dataclass(frozen=True)
class Opening:
    """Parameters of the accuracy of a tree."""

    angle: float  # Two nodes are far if their radii add up to less than this share of their distance.
    order: int  # Order of charges and Born integrals.
    screened: float = 8.0  # Largest r^2 / (4 B B) at which f of generalised Born differs from r.
    lower: int = 2  # Difference to the order of dispersion, which is lower because dispersion decays faster.


def same_charge(terms: Terms) -> bool:
    """Whether Coulomb and generalised Born have the same charges, except for a factor."""
    charge = terms.nonbonded.charge
    if terms.solvent is None or not charge.any():
        return True
    deviation = terms.solvent.charge - (terms.solvent.charge @ charge) / (charge @ charge) * charge
    return bool(np.abs(deviation).max() <= 1e-6 * np.abs(charge).max())


def least_distance(layout: Layout) -> float:
    """Least distance of far atoms, nm."""
    solvent = layout.terms.solvent
    s = 0.0 if solvent is None else float(np.abs(solvent.scaled_radius).max())
    return max(_LEAST, layout.near, layout.neck_reach, s / _SMALLEST)


FEWEST_BLOCKS = 64  # Smallest number of blocks for a tree, because each chunk requires some.
_OPENINGS = (
    (Opening(0.6, 5, 6.0), 1e-2, 1.0),
    (Opening(0.5, 5, 7.0), 5e-3, 0.5),
    (Opening(0.5, 6), 2e-3, 0.2),
    (Opening(0.47, 6), 1e-3, 0.1),
    (Opening(0.43, 6), 7e-4, 0.07),
    (Opening(0.45, 7, 9.0, 3), 5e-4, 0.04),
    (Opening(0.45, 8, 10.0, 3), 2e-4, 0.01),
    (Opening(0.4, 8, 10.0, 3), 1e-4, 3e-3),
    (Opening(0.4, 9, 12.0, 3), 3e-5, 1e-3),
    (Opening(0.35, 10, 14.0, 3), 1e-5, 1e-4),
    (Opening(0.3, 10, 16.0, 3), 3e-6, 3e-5),
)
"""Openings from quick to accurate, with the smallest RMS errors of forces in kJ/mol/nm for which they are
tried, in a solvent, which screens far charges, and in vacuum."""


def openings(accuracy: float, in_solvent: bool) -> list[Opening]:
    """Return the openings to try for an accuracy, quickest first."""
    return [
        opening
        for opening, solvated, in_vacuum in _OPENINGS
        if (solvated if in_solvent else in_vacuum) <= accuracy
    ]


@dataclass(frozen=True, eq=False)
class Far:
    """Charges and fields of a layout."""

    layout: Layout  # In the order of the tree.
    opening: Opening
    tree: Tree
    # (n, 2) int: Pairs of far blocks, and their rows, for which f of generalised Born differs from r.
    screened: tuple[Integers, np.ndarray] = (np.zeros((0, 2), np.int64), np.zeros((0, W), np.bool_))

    @cached_property
    def charge_ratio2(self) -> float:
        """Square of the ratio of generalised Born's to Coulomb's charges."""
        solvent, charge = self.layout.terms.solvent, self.layout.terms.nonbonded.charge
        if solvent is None or not charge.any():
            return 0.0
        return float(solvent.charge @ charge / (charge @ charge)) ** 2

    def geometry(self) -> tuple[Any, ...]:
        """Leaf of each block, nodes, roots, centres, and far nodes of each node."""
        tree = self.tree
        leaves = np.flatnonzero(tree.nodes[:, LEFT] < 0)
        leaves = leaves[np.argsort(tree.nodes[leaves, FIRST])]
        return leaves, tree.nodes, tree.roots, tree.centre, tree.start, tree.source

    def work_arrays(self) -> tuple[Floats, Floats, Floats, Floats]:
        """Charges, and arrays for moments, fields, and forces of the fields."""
        n, kinds, terms = len(self.tree.nodes), self.charges.shape[1], n_terms(self.opening.order)
        # As many fields as kinds of charge: two for the first kind of integrals, one for both.
        return (
            self.charges, np.zeros((n, kinds, terms)), np.zeros((n, kinds, terms)),
            np.zeros((len(self.charges), 3, W)),
        )  # fmt: skip

    @cached_property
    def _factors(self) -> tuple[Floats, Floats]:
        """Signs, and factors (n, types), of B = sum of sign * factor * factor."""
        values, vectors = np.linalg.eigh(self.layout.terms.nonbonded.b6)
        counts = np.abs(values) * (vectors**2).max(axis=0) > _FACTORED * np.abs(values).max(initial=0.0)
        values, vectors = values[counts], vectors[:, counts]
        return np.sign(values), (vectors * np.sqrt(np.abs(values))).T

    @cached_property
    def charges(self) -> Floats:
        """(blocks, kinds, W) float: charge, factors of B, s^3 c_0 / 2 and its remainder, dE/d(integral)."""
        terms = self.layout.terms
        rows = [terms.nonbonded.charge, *self._factors[1][:, terms.nonbonded.lj_type]]
        if terms.solvent is not None:
            s = terms.solvent.scaled_radius
            remainder = 0.5 * FAR_TERMS[1] * s**3 * (s**2 - self._mean_square)
            rows += [0.5 * FAR_TERMS[0] * s**3, remainder, np.zeros(len(s))]
        wide = np.zeros((len(rows), n_blocks(terms.n_atoms) * W))
        wide[:, : terms.n_atoms] = rows
        return np.ascontiguousarray(wide.reshape(len(rows), -1, W).swapaxes(0, 1))

    def arguments(self) -> tuple[Any, ...]:
        """Interactions, orders and factors, by subject."""
        # -> (fields,) int: Kind on which each field acts, its order, factors of force, of energy in vacuum
        # and of polar energy.
        high, low = self.opening.order, max(1, self.opening.order - self.opening.lower)
        signs = self._factors[0]
        first, second, acts, orders = [(1, high, 0, 0)], [], [0], [high]
        kinds, pulls = [(0, high)], []
        factors = [(1.0 - self.charge_ratio2, 0.5, -0.5 * self.charge_ratio2)]
        dispersion = [(6, low, k, k) for k in range(1, 1 + len(signs))]
        for k, sign in enumerate(signs, 1):
            kinds, acts, orders = [*kinds, (k, low)], [*acts, k], [*orders, low]
            factors.append((-sign, -0.5 * sign, 0.0))
        if self.layout.terms.solvent is not None:
            near, remainder, pull = (1 + len(signs) + k for k in range(3))
            # The integrals' field acts on dE/d(integral), fields of dE/d(integral) on the integrals' sources.
            first += [(4, high, near, near), (6, _REST, remainder, near)]
            second += [(4, high, pull, remainder), (6, _REST, pull, pull)]
            kinds, pulls = [*kinds, (near, high), (remainder, _REST)], [(pull, high)]
            acts, orders = [*acts, pull, near, remainder], [*orders, high, high, _REST]
            factors += 3 * [(1.0, 0.0, 0.0)]
        first = sorted(first + dispersion, key=lambda use: (use[0], -use[1]))
        stages = []
        for stage_kinds, stage_uses in ((kinds, first), (pulls, second)):
            uses = np.array(stage_uses, np.int64).reshape(-1, 4)
            seconds = np.where(uses[:, POWER] == 4, self._second, 0.0)
            stages.append((np.array(stage_kinds, np.int64).reshape(-1, 2), uses, seconds))
        return *stages, np.array(acts), np.array(orders), np.array(factors), tables(high)

    @property
    def _second(self) -> float:
        """nm^2. Factor of r^-6 relative to r^-4."""
        return FAR_TERMS[1] / FAR_TERMS[0] * self._mean_square

    @cached_property
    def _mean_square(self) -> float:
        """nm^2. Mean square of the scaled radii, weighted by their cubes."""
        solvent = self.layout.terms.solvent
        s = np.abs(solvent.scaled_radius) if solvent else np.zeros(1)
        return float((s**5).sum() / max((s**3).sum(), 1e-300))
