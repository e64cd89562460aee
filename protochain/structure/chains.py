"""Map chains of a model to chains of a reference if several have the same sequence.

Names of such chains are arbitrary, as of the two alpha chains of haemoglobin. As in AlphaFold-Multimer (Evans
et al., bioRxiv 2021.10.04.463034) the structures are superposed on one pair of chains, and the other chains
are paired by position. Here linear assignment pairs them. It is repeated after superposition on all pairs, as
in iterative closest points (Besl, McKay, IEEE T-PAMI 14:239, 1992). The number of superpositions grows with
the square of the number of chains, not with its factorial.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from protochain.core.arrays import Floats, Integers, Value
from protochain.structure.superpose import motion_of

_ROUNDS = 20  # Superpositions after one start. Each lowers the sum of squares, and mostly two are enough.
_STARTS = 400
"""Initial pairs of chains: all pairs of 20 equal chains. With more, the first chains of the reference."""
_EQUAL = 1e-9  # Fraction of the sum of squares about the origin. Mappings with smaller differences are equal.

_ALIKE = 0.1
"""nm. Mappings of a symmetric complex differ less in RMSD, mappings of equal chains in other places more."""


@dataclass(frozen=True, eq=False)
class PairSums(Value):
    """Sums over points of pairs of k and m chains, for the superposition of any pairs."""

    weight: Floats  # (k, m): Number of points, or 0 for chains that may not be paired.
    model: Floats  # (k, m, 3): Sums of the points of the model and of the reference.
    reference: Floats
    across: Floats  # (k, m, 3, 3): Sums of products of points of the reference with points of the model.
    square: Floats  # (k, m): Sums of the squares of both.

    @classmethod
    def of(cls, points: dict[tuple[int, int], tuple[Floats, Floats]], k: int, m: int) -> "PairSums":
        """Sum points (n, 3) of model and reference by chains (i, j). Pairs of one chain have equal weight."""
        weight, square = np.zeros((2, k, m))
        model, reference, across = np.zeros((k, m, 3)), np.zeros((k, m, 3)), np.zeros((k, m, 3, 3))
        size = [max((len(x) for (i, _), (x, _) in points.items() if i == row), default=0) for row in range(k)]
        for (i, j), (x, y) in points.items():
            scale = size[i] / len(x)
            weight[i, j], square[i, j] = size[i], scale * float(np.sum(x**2) + np.sum(y**2))
            model[i, j], reference[i, j] = scale * x.sum(axis=0), scale * y.sum(axis=0)
            across[i, j] = scale * y.T @ x
        return cls(weight, model, reference, across, square)

    def motion(self, rows: Integers, columns: Integers) -> tuple[Floats, Floats]:
        """Rotation and translation of the model with the least sum of squares over some pairs."""
        n, model, reference, across = (
            sums[rows, columns].sum(axis=0) for sums in (self.weight, self.model, self.reference, self.across)
        )
        return motion_of(across - np.outer(reference, model) / n, model / n, reference / n)

    def deviations(self, turn: Floats, shift: Floats) -> Floats:
        """Sums (k, m) of squared distances of all pairs after a motion of the model."""
        along = self.model @ turn.T @ shift - self.reference @ shift
        across = np.einsum("ab,ijab->ij", turn, self.across)
        return np.asarray(self.square + self.weight * (shift @ shift) + 2.0 * along - 2.0 * across)


def least_rmsd_mappings(sums: PairSums, first: Integers) -> list[Integers]:
    """Find the chain of the model for each of the reference (k,), as many as ``first``, of least RMSD.

    Mappings of almost the same RMSD follow, as those of a symmetric complex.
    """
    allowed = sums.weight > 0.0
    best, least = first, _mean_square(sums, first)
    squares = dict[tuple[int, ...], float]()
    same = _EQUAL * float((sums.square / np.maximum(sums.weight, 1.0)).max(initial=0.0))
    for start in _starts(allowed):
        mapping = _refine(sums, allowed, start)
        off = squares[tuple(mapping.tolist())] = _mean_square(sums, mapping)
        if (mapping >= 0).sum() >= (best >= 0).sum() and off < least - same:
            best, least = mapping, off
    highest = (max(least, 0.0) ** 0.5 + _ALIKE) ** 2
    alike = [np.array(mapping) for mapping, off in squares.items() if off < highest]
    n_mapped = (best >= 0).sum()
    return [best, *(m for m in alike if (m >= 0).sum() == n_mapped and (m != best).any())]


def _starts(allowed: NDArray[np.bool_]) -> Iterator[Integers]:
    """Initial mappings of one chain each."""
    rows, columns = (indices[:_STARTS].tolist() for indices in np.nonzero(allowed))
    for row, column in zip(rows, columns, strict=True):
        start = np.full(len(allowed), -1)
        start[row] = column
        yield start


def _refine(sums: PairSums, allowed: NDArray[np.bool_], mapping: Integers) -> Integers:
    """Superpose and assign chains in turn until the mapping is stable."""
    from scipy.optimize import linear_sum_assignment

    for _ in range(_ROUNDS):
        (rows,) = np.nonzero(mapping >= 0)
        off = sums.deviations(*sums.motion(rows, mapping[rows]))
        # Larger than any sum of allowed pairs, so that as many of them as possible are assigned.
        beyond = 1.0 + 2.0 * len(off) * float(np.abs(off[allowed]).max())
        first, second = linear_sum_assignment(np.where(allowed, off, beyond))
        assigned = np.full(len(mapping), -1)
        is_allowed = allowed[first, second]
        assigned[first[is_allowed]] = second[is_allowed]
        if (assigned == mapping).all():
            break
        mapping = assigned
    return mapping


def _mean_square(sums: PairSums, mapping: Integers) -> float:
    """Mean square deviation of the pairs of a mapping after superposition on all pairs."""
    (rows,) = np.nonzero(mapping >= 0)
    columns = mapping[rows]
    if not len(rows):
        return float("inf")
    off = sums.deviations(*sums.motion(rows, columns))[rows, columns]
    return float(off.sum() / sums.weight[rows, columns].sum())
