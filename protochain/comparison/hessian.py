"""Second derivatives of an energy in the freedoms of a chain, analytic or by differences of its torques."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from protochain.chains.articulate import with_energy
from protochain.chains.chain import Chain, pose, pull_back
from protochain.comparison.pair_hessian import applies, colours, pair_hessian
from protochain.core.arrays import Floats, finite, floats
from protochain.core.checks import check_arguments
from protochain.core.errors import Fault, ProtochainError
from protochain.energies import Energy, NativeEnergy
from protochain.mechanics import multibody
from protochain.minimisers.spaces import Torsions

STEP = 3e-6
"""Change of the largest freedom, rad (a tenth of it, in nm, for a root's position).

The error of a central difference is h^2/6 times the third derivative, plus about eps/h times the terms of a
torque. Their sum is least near eps^(1/3) = 6e-6 if both are of order one. Third derivatives are larger here,
because long arms press atoms together. In ubiquitin the largest error of a column is 1e-8 of its length at
this step, and 6e-8 at 1e-5 and at 1e-6.
"""


@dataclass(frozen=True, eq=False)
class Torques:
    """Torques of an energy near one point of a chain."""

    chain: Chain
    energy: Energy  # Energy of all terms.
    q: Floats  # (n_q,): Coordinates of the point.

    @cached_property
    def _varying(self) -> Energy:
        """The energy without terms that are constant in rigid bodies, which would add rounding errors."""
        # It is exact, because platforms of OpenMM round forces to single precision.
        energy = self.energy
        energy = energy if energy.is_exact else energy.exact
        return energy.without_constants(self.chain.rigid_groups, self.chain.structure.positions)

    @cached_property
    def scale(self) -> Floats:
        """(n_v,) float: unit of each freedom, 1 rad, or the equivalent of a root's position, nm."""
        return Torsions(self.chain).scale

    @property
    def largest(self) -> float:
        """Largest torque at the point, kJ/mol/rad, with the root's positions in their unit."""
        return float(np.max(np.abs(self.scale * self.torques_after(np.zeros(self.chain.n_v))), initial=0.0))

    def torques_after(self, change: Floats) -> Floats:
        """Torques (n_v,) after a change (n_v,) of the freedoms."""
        at = pose(self.chain, multibody.integrate(self.chain.tree, self.q, change))
        return pull_back(self.chain, at, self._varying(at.x)[1])

    def product(self, direction: Floats) -> Floats:
        """Hessian times a direction (n_v,), by two evaluations."""
        size = np.max(np.abs(direction / self.scale), initial=0.0)
        if size == 0.0:
            return np.zeros_like(direction)
        change = STEP / size * direction
        return np.asarray((self.torques_after(-change) - self.torques_after(change)) / (2.0 * STEP / size))

    def matrix(self, freedoms: Any) -> Floats:
        """Hessian (n, n) of some freedoms, analytic if possible, else by two evaluations for each row."""
        if not applies(self.energy):
            return self._by_rows(freedoms)
        block = self._analytic()
        # The same memory is used: rows move towards its beginning.
        selected = block.reshape(-1)[: len(freedoms) ** 2].reshape(len(freedoms), -1)
        for row, freedom in zip(selected, freedoms, strict=True):
            row[:] = block[freedom, freedoms]
        return selected

    def _analytic(self) -> Floats:
        """Pairs and Born radii analytically, bonded terms by differences for the hinges of each colour."""
        assert isinstance(self.energy, NativeEnergy)
        block = pair_hessian(self.chain, self.energy, pose(self.chain, self.q))
        bonded = replace(self, energy=self.energy.bonded_terms)
        coupled, colour = colours(self.chain, self.energy)
        for colour_index in range(int(colour.max(initial=-1)) + 1):
            column = np.flatnonzero(colour == colour_index)
            direction = np.zeros(self.chain.n_v)
            direction[column] = self.scale[column]
            fall = bonded.product(direction)
            for v in column:
                rows = coupled.indices[coupled.indptr[v] : coupled.indptr[v + 1]]
                half = 0.5 * fall[rows] / self.scale[v]
                block[rows, v] += half
                block[v, rows] += half
        return block

    def _by_rows(self, freedoms: Any) -> Floats:
        """Hessian (n, n) by differences, symmetrised."""
        rows = np.empty((len(freedoms), len(freedoms)))
        for row, freedom in zip(rows, freedoms, strict=True):
            row[:] = self.product(np.eye(1, self.chain.n_v, freedom)[0])[freedoms]
        return 0.5 * (rows + rows.T)


def torques_at(chain: Chain, energy: Energy, q: Any) -> Torques:
    """Torques near q, or near the chain's start."""
    q = chain.q0 if q is None else finite(q, (chain.n_q,), "q")
    torques = Torques(chain, energy, q)
    if not np.isfinite(torques.torques_after(np.zeros(chain.n_v))).all():
        raise ProtochainError(
            f"{chain.structure.name}: the torques are not finite; minimise it first, as by pc.minimise",
            fault=Fault.NOT_FINITE,
        )
    return torques


@check_arguments()
def hessian(chain: Any, energy: Any = None, q: Any = None) -> Floats:
    """Second derivatives of the potential energy in the freedoms of a chain.

    Parameters
    ----------
    chain : Chain, Structure, path, or anything that :func:`protochain.as_structure` accepts
        Files and structures are cut into chains with the default hinges, results with their hinges.
    energy : Energy or callable, optional
        As in :func:`protochain.minimise`.
    q : (n_q,) float, optional
        Coordinates, by default the coordinates of the chain's structure.

    Returns
    -------
    (n_v, n_v) float, kJ/mol/rad^2
        Symmetric matrix. A free root has (turn, shift) about its frame's origin, world axes, with shifts in
        nm. It moves by the exponential map: at nonzero torque its entries are the symmetric part.

    Raises
    ------
    ProtochainError
        If the input cannot be used.

    Notes
    -----
    For the native engine without a cutoff, in vacuum and in OBC2, pairs of atoms and Born radii are analytic.
    Bonded terms are central differences from about ten evaluations of these terms. The cost is O(na^2 n), in
    ubiquitin equal to 200 evaluations. For other energies all terms are central differences of torques, with
    two evaluations for each row, to about 1e-8 of the largest entry.

    Examples
    --------
    >>> c = pc.build_chain(pc.from_sequence("GAG"))
    >>> pc.hessian(c).shape
    (5, 5)
    """
    chain, energy = with_energy(chain, energy)
    return torques_at(chain, energy, q).matrix(np.arange(chain.n_v))


@check_arguments()
def hessian_product(chain: Any, energy: Any, q: Any, direction: Any) -> Floats:
    """Hessian of the potential energy times a direction, by two evaluations and without the matrix.

    Parameters
    ----------
    chain : Chain, Structure, path, or anything that :func:`protochain.as_structure` accepts
        As in :func:`hessian`.
    energy : Energy, callable or None
        As in :func:`hessian`.
    q : (n_q,) float or None
        As in :func:`hessian`.
    direction : (n_v,) float
        Direction in the freedoms, of any length.

    Returns
    -------
    (n_v,) float, kJ/mol/rad times the unit of the direction
        By a central difference of torques.

    Raises
    ------
    ProtochainError
        If the input cannot be used.

    Examples
    --------
    >>> c = pc.build_chain(pc.from_sequence("GAG"))
    >>> row = pc.hessian_product(c, pc.energy(c.structure), c.q0, np.eye(c.n_v)[0])
    >>> bool(np.allclose(row, pc.hessian(c)[0], rtol=1e-3, atol=0.1))
    True
    """
    chain, energy = with_energy(chain, energy)
    return torques_at(chain, energy, q).product(floats(direction, (chain.n_v,), "direction"))
