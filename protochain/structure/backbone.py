"""One missing atom of a residue's backbone, from the residues before and after it."""

from collections.abc import Sequence

import numpy as np

from protochain.core.arrays import Floats
from protochain.structure.draft import Member, atom
from protochain.structure.residues import BACKBONE
from protochain.structure.sidechains.ideal import unit

_N_CA, _CA_C, _C_N = 1.459, 1.525, 1.336
"""Angstrom: Engh, Huber, International Tables for Crystallography F, 18.3 (2001)."""
_OFF = 0.4
"""Angstrom by which the other bond of a rebuilt atom may be off."""
_CIS = 3.4
"""Angstrom: C-alphas on both sides of a peptide bond are 3.8 apart, of a cis one 2.9."""


def complete_backbone(run: Sequence[Member], i: int) -> str:
    """Build the atom of the backbone that residue i alone lacks, where its neighbours say where it is.

    Returns
    -------
    str
        Its name; empty if it has all, or none can be built.
    """
    member = run[i]
    missing = [name for name in BACKBONE if not member.atom(name)]
    if len(missing) != 1 or member.is_cap:
        return ""
    at = {a.name: np.array(a.pos.tolist()) for a in member.atoms}
    for step, mark in ((-1, "-"), (1, "+")):
        if 0 <= i + step < len(run):
            at |= {a.name + mark: np.array(a.pos.tolist()) for a in run[i + step].atoms}
    found = _BUILD[missing[0]](at)
    if found is None:
        return ""
    name = missing[0]
    b_iso = float(np.mean([a.b_iso for a in member.atoms]))
    member.atoms.insert(BACKBONE.index(name), atom(name, name[0], np.round(found, 4).tolist(), b_iso))
    return name


def _nitrogen(at: dict[str, Floats]) -> Floats | None:
    return _opposite(at, "C-", ("CA-", "O-"), _C_N, "CA", _N_CA)


def _alpha(at: dict[str, Floats]) -> Floats | None:
    return _opposite(at, "C", ("O", "N+"), _CA_C, "N", _N_CA)


def _opposite(
    at: dict[str, Floats], centre: str, others: tuple[str, str], length: float, end: str, expected: float
) -> Floats | None:
    """The third neighbour of a trigonal carbon, if it is as far from its other neighbour as bonded atoms."""
    if not {centre, end, *others} <= at.keys():
        return None
    first, second = (unit(at[other] - at[centre]) for other in others)
    x = at[centre] - length * unit(first + second)
    return x if abs(np.linalg.norm(x - at[end]) - expected) < _OFF else None


def _carbonyl(at: dict[str, Floats]) -> Floats | None:
    """C between CA and the next N, in the plane of the peptide bond."""
    if not {"CA", "N+", "CA+"} <= at.keys():
        return None
    way = at["N+"] - at["CA"]
    length = float(np.linalg.norm(way))
    along = (length**2 + _CA_C**2 - _C_N**2) / (2.0 * length)
    if length > _CA_C + _C_N + _OFF or along > _CA_C:
        return None
    beyond = at["CA+"] - at["CA"]
    aside = unit(beyond - (beyond @ unit(way)) * unit(way))
    side = 1.0 if np.linalg.norm(beyond) > _CIS else -1.0
    return np.asarray(at["CA"] + along * unit(way) + side * np.sqrt(_CA_C**2 - along**2) * aside)


_BUILD = {"N": _nitrogen, "CA": _alpha, "C": _carbonyl}
