"""Missing atoms of a residue's backbone, from its other atoms and the residues before and after it."""

from collections.abc import Sequence

import numpy as np

from protochain.core.arrays import Floats
from protochain.structure.molecule.member import Member, atom
from protochain.structure.molecule.residues import BACKBONE

_BONDS = {
    ("C-", "N"): 1.336, ("N", "CA"): 1.459, ("CA", "C"): 1.525, ("C", "N+"): 1.336, ("C", "O"): 1.229,
    ("CA", "CB"): 1.532,
}  # fmt: skip
"""Angstrom: Engh, Huber, International Tables for Crystallography F, 18.3 (2001)."""
_ACROSS = {
    ("CA-", "N"): 2.43, ("O-", "N"): 2.25, ("C-", "CA"): 2.43, ("N", "C"): 2.46, ("N", "CB"): 2.46,
    ("C", "CB"): 2.50, ("CA", "O"): 2.40, ("CA", "N+"): 2.43, ("O", "N+"): 2.25, ("C", "CA+"): 2.43,
}  # fmt: skip
"""Angstrom: the same across an angle."""
_TRANS = {("CA-", "CA"): 3.80, ("CA", "CA+"): 3.80}
"""Angstrom: across a peptide bond; a cis one has 2.9, and is told from it by the other distances alone."""
_OFF = 0.25
"""Angstrom by which a bond of a rebuilt atom may be off."""
_STARTS = 8


def complete_backbone(run: Sequence[Member], i: int) -> tuple[str, ...]:
    """Build the atoms of the backbone that residue i lacks, where its neighbours say where they are."""
    member = run[i]
    missing = tuple(name for name in BACKBONE if not member.atom(name))
    if not missing or member.is_cap:
        return ()
    at = {a.name: np.array(a.pos.tolist()) for a in member.atoms}
    for step, mark in ((-1, "-"), (1, "+")):
        if 0 <= i + step < len(run):
            at |= {a.name + mark: np.array(a.pos.tolist()) for a in run[i + step].atoms}
    found = _built(missing, at)
    if found is None:
        return ()
    b_iso = float(np.mean([a.b_iso for a in member.atoms]))
    for name, x in zip(missing, found, strict=True):
        member.atoms.insert(BACKBONE.index(name), atom(name, name[0], np.round(x, 4).tolist(), b_iso))
    return missing


def _built(missing: Sequence[str], at: dict[str, Floats]) -> Floats | None:
    """Places (n, 3) of atoms at the usual distances from others; None if no bond may be so long or short."""
    ends = {"N": ("C-", "CA-"), "CA": (), "C": ("N+", "CA+")}
    if not {end for name in missing for end in ends[name]} <= at.keys():
        return None
    usual = _BONDS | _ACROSS | (_TRANS if len(missing) > 1 else {})
    pairs = [(pair, d) for pair, d in usual.items() if {*pair} & {*missing} and {*pair} <= {*missing, *at}]
    if len(pairs) <= 3 * len(missing):  # Places are not determined.
        return None
    weight = np.array([1.0 if pair in _BONDS else 0.5 for pair, _ in pairs])

    from scipy.optimize import least_squares

    def off(x: Floats) -> Floats:
        there = at | dict(zip(missing, x.reshape(-1, 3), strict=True))
        return np.array([np.linalg.norm(there[a] - there[b]) - d for (a, b), d in pairs])

    def weighted(x: Floats) -> Floats:
        return np.asarray(weight * off(x))

    near = np.mean([at[name] for pair, _ in pairs for name in pair if name in at], axis=0)
    starts = near + np.random.default_rng(0).normal(size=(_STARTS, len(missing), 3))
    found = [least_squares(weighted, each.ravel()) for each in starts]
    best = min(found, key=lambda each: float(each.cost))
    bonds = [abs(each) for each, (pair, _) in zip(off(best.x), pairs, strict=True) if pair in _BONDS]
    return np.asarray(best.x.reshape(-1, 3)) if max(bonds) < _OFF else None
