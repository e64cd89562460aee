"""Energies of the rotamers of side chains, with the fixed atoms and between pairs.

Terms are the force field's: torsions, Lennard-Jones and Coulomb, hydrogens included. As is usual for
rigid rotamers, repulsion is softened: radii are scaled by 0.9 (Dahiyat, Mayo, PNAS 94:10172, 1997) and the
energy is linear within 0.6 of the contact (Alford et al., J. Chem. Theory Comput. 13:3031, 2017).
To model the solvent, Coulomb's constant is divided by four times the distance in angstrom.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from protochain.core.arrays import Floats, Integers, dihedral
from protochain.core.compilation import njit
from protochain.energies.native.terms import Bonded, Terms
from protochain.relaxation.rotamers import Rotamers
from protochain.structure.sidechains.reduction import Pairs, sphere, touching

_TWIST = 0.5
"""Weight of the torsions, which the frequencies of rotamers contain too."""
_SOFT = 0.9
"""Scale of the radii."""
_LINEAR = 0.6
"""Share of the distance of the minimum, within which repulsion is linear."""
_CUTOFF = 0.6
"""nm: Lennard-Jones and Coulomb energies are shifted to zero there."""
_DIELECTRIC = 40.0
"""1/nm: relative permittivity over distance."""
_CLOSEST = 0.1
"""nm. The Coulomb energy is constant below this distance."""


@dataclass(frozen=True, eq=False)
class _Parameters:
    """Parameters of all pairs (k, m) of two groups of atoms."""

    a12: Floats
    b6: Floats
    charges: Floats
    linear: Floats
    """nm^2: squared distance within which repulsion is linear."""


class Interactions:
    """Energies of rotamers by the terms of a force field, with all other atoms at x (na, 3) nm."""

    def __init__(self, terms: Terms, x: Floats, rotamers: Sequence[Rotamers]) -> None:
        self.terms, self.x, self.rotamers = terms, x, rotamers
        scale = _SOFT**6
        self._a12, self._b6 = terms.nonbonded.a12 * scale**2, terms.nonbonded.b6 * scale
        self._exceptions = _exceptions_by_atom(terms.nonbonded.exceptions)
        turning = np.zeros(terms.n_atoms, dtype=bool)
        for side_chain in rotamers:
            turning[side_chain.atoms] = True
        self._still = np.flatnonzero(~turning)
        self._tree = KDTree(x[self._still])
        torsions = terms.bonded["torsions"]
        turns = turning[torsions.atoms].any(axis=1)
        self._torsions = Bonded(torsions.atoms[turns], torsions.parameters[turns])

    def self_energies(self, i: int) -> Floats:
        """(n_i,) float, kJ/mol: rarity, torsions, and energies within the side chain and with fixed atoms."""
        site = self.rotamers[i]
        centre, reach = sphere(site.x)
        near = self._still[np.sort(self._tree.query_ball_point(centre, reach + _CUTOFF))]
        around = self._pair_parameters(site.atoms, near)
        within = self._pair_parameters(site.atoms, site.atoms)
        outer = _table(site.x, self.x[near][None], around.a12, around.b6, around.charges, around.linear)[:, 0]
        inside = _inside(site.x, within.a12, within.b6, within.charges, within.linear)
        return np.asarray(site.cost + self._torsion_energies(site) + outer + inside)

    def pairs(self) -> Pairs:
        """(n_i, n_j) float, kJ/mol: energies between the rotamers of all sites i < j in reach."""
        tables = {}
        for i, j in touching([site.x for site in self.rotamers], _CUTOFF):
            first, second = self.rotamers[i], self.rotamers[j]
            pair = self._pair_parameters(first.atoms, second.atoms)
            table = _table(first.x, second.x, pair.a12, pair.b6, pair.charges, pair.linear)
            if table.any():
                tables[i, j] = table
        return tables

    def _pair_parameters(self, rows: Integers, columns: Integers) -> _Parameters:
        nonbonded = self.terms.nonbonded
        kinds = np.ix_(nonbonded.lj_type[rows], nonbonded.lj_type[columns])
        a12, b6 = self._a12[kinds], self._b6[kinds]
        charges = np.outer(nonbonded.charge[rows], nonbonded.charge[columns])
        place = {atom: k for k, atom in enumerate(columns.tolist())}
        for k, atom in enumerate(rows.tolist()):
            for partner, values in self._exceptions.get(atom, ()):
                if partner in place:
                    a12[k, place[partner]], b6[k, place[partner]], charges[k, place[partner]] = values
        # The minimum is at r^6 = 2 A/B.
        ratio = np.divide(2.0 * a12, b6, out=np.zeros_like(a12), where=b6 > 0.0)
        return _Parameters(a12, b6, charges, _LINEAR**2 * np.cbrt(ratio))

    def _torsion_energies(self, arm: Rotamers) -> Floats:
        """(n,) float: energies of the turning torsions."""
        is_turning = np.isin(self._torsions.atoms, arm.atoms).any(axis=1)
        atoms, parameters = self._torsions.atoms[is_turning], self._torsions.parameters[is_turning]
        involved, place = np.unique(atoms, return_inverse=True)
        at = np.repeat(self.x[involved][None], len(arm.x), axis=0)
        turns, rows = (np.isin(involved, arm.atoms), {atom: k for k, atom in enumerate(arm.atoms.tolist())})
        at[:, turns] = arm.x[:, [rows[atom] for atom in involved[turns].tolist()]]
        place = place.reshape(atoms.shape)
        phi = dihedral(*(at[:, place[:, k]] for k in range(4)))
        multiplicity, phase, height = parameters.T
        return np.asarray((_TWIST * height * (1.0 + np.cos(multiplicity * phi - phase))).sum(axis=1))


def _exceptions_by_atom(exceptions: Bonded) -> dict[int, list[tuple[int, list[float]]]]:
    """Exceptions by atom: the partners of each atom, with A, B and the product of the charges."""
    by_atom: dict[int, list[tuple[int, list[float]]]] = {}
    for (i, j), values in zip(exceptions.atoms.tolist(), exceptions.parameters.tolist(), strict=True):
        by_atom.setdefault(i, []).append((j, values))
        by_atom.setdefault(j, []).append((i, values))
    return by_atom


@njit(cache=True, error_model="numpy", forceinline=True)
def _pair_energy(r2: float, a12: float, b6: float, charges: float, linear: float) -> float:
    """Energy of two atoms at a squared distance below the squared cutoff."""
    energy = charges / _DIELECTRIC * (1.0 / max(r2, _CLOSEST**2) - 1.0 / _CUTOFF**2)
    if a12 > 0.0:
        end = 1.0 / _CUTOFF**6
        s = 1.0 / max(r2, linear)
        s6 = s * s * s
        energy += (a12 * s6 - b6) * s6 - (a12 * end - b6) * end
        if r2 < linear:
            slope = (12.0 * a12 * s6 - 6.0 * b6) * s6 * np.sqrt(s)
            energy += slope * (np.sqrt(linear) - np.sqrt(r2))
    return energy


@njit(cache=True, error_model="numpy")
def _table(x: Floats, x_other: Floats, a12: Floats, b6: Floats, charges: Floats, linear: Floats) -> Floats:
    """Energies (n, m) between positions x (n, k, 3) and x_other (m, l, 3)."""
    energies = np.zeros((len(x), len(x_other)))
    for r in range(len(x)):
        for s in range(len(x_other)):
            energy = 0.0
            for k in range(x.shape[1]):
                x0, x1, x2 = x[r, k, 0], x[r, k, 1], x[r, k, 2]
                for m in range(x_other.shape[1]):
                    d0, d1, d2 = x0 - x_other[s, m, 0], x1 - x_other[s, m, 1], x2 - x_other[s, m, 2]
                    r2 = d0 * d0 + d1 * d1 + d2 * d2
                    if r2 < _CUTOFF**2:
                        energy += _pair_energy(r2, a12[k, m], b6[k, m], charges[k, m], linear[k, m])
            energies[r, s] = energy
    return energies


@njit(cache=True, error_model="numpy")
def _inside(x: Floats, a12: Floats, b6: Floats, charges: Floats, linear: Floats) -> Floats:
    """Energies (n,) of positions x (n, k, 3) with themselves."""
    energies = np.zeros(len(x))
    for r in range(len(x)):
        for k in range(x.shape[1]):
            for m in range(k):
                d0, d1, d2 = x[r, k, 0] - x[r, m, 0], x[r, k, 1] - x[r, m, 1], x[r, k, 2] - x[r, m, 2]
                r2 = d0 * d0 + d1 * d1 + d2 * d2
                if r2 < _CUTOFF**2:
                    energies[r] += _pair_energy(r2, a12[k, m], b6[k, m], charges[k, m], linear[k, m])
    return energies
