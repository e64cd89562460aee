"""Minima that a search found: which are the same, which are alike, and how free they are."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from protochain.batches.ensembles import grouped, rmsds
from protochain.chains.chain import Chain
from protochain.core.arrays import Floats, Integers
from protochain.core.units import ANGSTROM_PER_NM, MOLAR_GAS

if TYPE_CHECKING:
    from protochain.chains.hinges import Hinge

SAME_ENERGY, SAME_TORSION = 0.5, 0.2
"""kJ/mol, and rad of the torsion that differs most, within which two minima are one: a descent ends where
torques are 0.1 kJ/mol/rad, a hundredth of a radian from the minimum along soft torsions, and rings that turn
by half are not quite symmetrical."""

ALIKE = 1.0
"""angstrom. C-alpha RMSD at which clusters are cut, on average over their pairs."""

HALF_TURNS = {("PHE", "chi2"), ("ASP", "chi2"), ("GLU", "chi3"), ("ARG", "chi5")}
"""Torsions after half a turn of which a residue is as it was. Not tyrosine's: its hydroxyl then points to the
other side."""


def periods(chain: Chain) -> Floats:
    """(n,) float, rad: turn of each coordinate that changes nothing."""
    period = np.full(chain.n_q, 2.0 * np.pi)
    for hinge, coordinate in zip(chain.hinges, chain.tree.q_start[chain.hinge_body], strict=True):
        # psi of the last residue turns a carboxylate.
        of_carboxylate = hinge.kind == "psi" and chain.structure.atom_name[hinge.atoms[3]] == "O"
        is_half = (hinge.residue_name, hinge.kind) in HALF_TURNS and not _is_acid(chain, hinge)
        if of_carboxylate or is_half:
            period[coordinate] = np.pi
    return period


def _is_acid(chain: Chain, hinge: Hinge) -> bool:
    """Whether the hinge is in a side chain whose carboxyl group has its hydrogen."""
    structure = chain.structure
    its = structure.atom_residue == structure.atom_residue[hinge.atoms[1]]
    hydrogens = {"ASP": {"HD1", "HD2"}, "GLU": {"HE1", "HE2"}}.get(hinge.residue_name, set())
    return not hydrogens.isdisjoint(structure.atom_name[its].tolist())


def farthest(q: Floats, other: Floats, period: Floats) -> Floats:
    """Difference, rad, of the torsion that differs most; q (..., n) and other (..., n)."""
    return np.asarray(np.max(_turns(q, other, period), axis=-1))


def distance(q: Floats, other: Floats, period: Floats) -> Floats:
    """Sum of the differences, rad, of all torsions; q (..., n) and other (..., n)."""
    return np.asarray(np.sum(_turns(q, other, period), axis=-1))


def _turns(q: Floats, other: Floats, period: Floats) -> Floats:
    away = q - other
    return np.asarray(np.abs(away - period * np.rint(away / period)))


def unique(q: Floats, energy: Floats, period: Floats) -> Integers:
    """(k,) int: minima q (m, n) rad, of period (n,), that differ from all of lower energy (m,), sorted."""
    kept: list[int] = []
    first = 0
    for k in np.argsort(energy, kind="stable").tolist():
        if not np.isfinite(energy[k]):
            break
        while first < len(kept) and energy[kept[first]] < energy[k] - SAME_ENERGY:
            first += 1
        near = kept[first:]
        if not near or np.min(farthest(q[near], q[k], period)) > SAME_TORSION:
            kept.append(k)
    return np.array(kept, dtype=np.int64)


def clusters(positions: Sequence[Floats]) -> Integers:
    """Number, from 1, of the cluster of each of m sets of C-alphas (n, 3), nm, in order of the first in it.

    By average linkage over the RMSD of pairs, superposed.
    """
    if len(positions) < 2:
        return np.ones(len(positions), dtype=np.int64)
    found, _ = grouped(ANGSTROM_PER_NM * rmsds(positions), ALIKE)
    _, first = np.unique(found, return_index=True)
    renamed = {int(found[k]): number for number, k in enumerate(sorted(first.tolist()), 1)}
    return np.array([renamed[int(each)] for each in found], dtype=np.int64)


def free_energy(energy: float, hessian: Floats, temperature: float, log_det_mass: float = 0.0) -> float:
    """Harmonic free energy of a minimum at K, kJ/mol, of its energy and Hessian (n, n), kJ/mol/rad^2."""
    kt = MOLAR_GAS * temperature
    sign, log_det = np.linalg.slogdet(hessian / (2.0 * np.pi * kt))
    if sign <= 0.0 or np.linalg.eigvalsh(hessian)[0] <= 0.0:
        return np.nan
    return float(energy + 0.5 * kt * (log_det - log_det_mass))
