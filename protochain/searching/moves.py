"""Moves in torsions from a minimum towards others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import TypeVar

import numpy as np

from protochain.chains.chain import Chain
from protochain.core.arrays import Floats, Value, read_only
from protochain.structure.sidechains.rotamers import BACKBONE, rotamers
from protochain.validation.ramachandran import FAVOURED, residue_classes, tables

JITTER = np.deg2rad(10.0)
"""Standard deviation of a side chain's dihedral about its rotamer's, about the width of their peaks."""
NONE = -1
WEIGHTS = {"backbone": 0.5, "rotamer": 0.3, "crankshaft": 0.2, "turn": 0.1}
"""Weight of each kind of move, normalised over the kinds that a chain has."""
CROSSINGS = {"part": 0.4, "stretch": 0.4, "few": 0.2}
"""Probability of each kind of crossing."""
_FEW = 5

T = TypeVar("T")


@dataclass(frozen=True)
class Residue:
    """Coordinates of the torsions of one residue."""

    name: str
    kind: int  # Index of its class in ``ramachandran.CLASSES``.
    mirror: float  # 1, or -1 for a D-amino acid.
    phi: int = NONE  # phi, psi: ``NONE`` if the torsion does not turn.
    psi: int = NONE
    chi: tuple[int, ...] = ()  # From chi1 outwards, as far as they turn.
    is_first: bool = False  # Whether it is first in the chain, and so has no phi.
    is_last: bool = False  # Whether psi is a carboxylate's, by its first oxygen.

    @property
    def backbone(self) -> list[int]:
        """Phi and psi, as far as they turn."""
        return [k for k in (self.phi, self.psi) if k != NONE]


@dataclass(frozen=True, eq=False)
class Moves(Value):
    """Moves of a chain's torsions."""

    residues: tuple[Residue, ...]  # Residues with turning torsions, in the order of the sequence.
    # Coordinates of psi of a residue and phi of the next, on either side of a peptide bond.
    flips: tuple[tuple[int, int], ...]
    other_hinges: tuple[int, ...]  # Coordinates of all hinges that are neither phi, psi nor chi.

    @classmethod
    def of(cls, chain: Chain) -> Moves:
        """Sort the hinges of a chain by residue."""
        structure = chain.structure
        names, classes = structure.residue_name.tolist(), residue_classes(structure).tolist()
        by_residue: dict[int, dict[str, int]] = {}
        other_hinges, c_termini = [], set()
        for hinge, coordinate in zip(
            chain.hinges, chain.tree.q_start[chain.hinge_body].tolist(), strict=True
        ):
            if hinge.kind in ("phi", "psi") or hinge.kind.startswith("chi"):
                r = int(structure.atom_residue[hinge.atoms[1]])  # Of both atoms of its bond.
                by_residue.setdefault(r, {})[hinge.kind] = coordinate
                if hinge.kind == "psi" and structure.atom_name[hinge.atoms[3]] == "O":
                    c_termini.add(r)
            else:
                other_hinges.append(coordinate)
        residues = []
        for r, coordinates in sorted(by_residue.items()):
            chi: list[int] = []
            while (kind := f"chi{len(chi) + 1}") in coordinates:
                chi.append(coordinates[kind])
            mirror = -1.0 if structure.mirrored[r] else 1.0
            phi_psi = coordinates.get("phi", NONE), coordinates.get("psi", NONE)
            ends = r == 0, r in c_termini
            residues.append(Residue(names[r], classes[r], mirror, *phi_psi, tuple(chi), *ends))
        flips = tuple(
            (coordinates["psi"], by_residue[r + 1]["phi"])
            for r, coordinates in sorted(by_residue.items())
            if "psi" in coordinates and "phi" in by_residue.get(r + 1, {})
        )
        return cls(tuple(residues), flips, tuple(other_hinges))

    @cached_property
    def kinds(self) -> tuple[str, ...]:
        """Kinds of moves that the chain has."""
        groups = self.with_backbone, self.with_chi, self.flips, self.other_hinges
        return tuple(kind for kind, members in zip(WEIGHTS, groups, strict=True) if members)

    @cached_property
    def parts(self) -> tuple[list[int], ...]:
        """Groups of coordinates: the backbone of a residue, its side chain, or another hinge."""
        coordinates = [part for residue in self.residues for part in (residue.backbone, list(residue.chi))]
        return *(part for part in coordinates if part), *([k] for k in self.other_hinges)

    @cached_property
    def with_backbone(self) -> tuple[Residue, ...]:
        """Residues whose phi or psi turns."""
        return tuple(residue for residue in self.residues if max(residue.phi, residue.psi) >= 0)

    @cached_property
    def with_chi(self) -> tuple[Residue, ...]:
        """Residues whose side chain turns."""
        return tuple(residue for residue in self.residues if residue.chi)


def draw_kind(moves: Moves, random: np.random.Generator) -> str:
    """Draw a kind of move of the chain."""
    weights = np.array([WEIGHTS[kind] for kind in moves.kinds])
    return moves.kinds[int(random.choice(len(weights), p=weights / weights.sum()))]


def cross_over(moves: Moves, q: Floats, q_other: Floats, random: np.random.Generator) -> Floats:
    """Torsions (n,), rad, with some of q (n,) replaced by torsions of another minimum, q_other (n,)."""
    # Replace the backbone or the side chain of one residue, a stretch of up to half of all residues, or up
    # to five random hinges.
    kind = random.choice(list(CROSSINGS), p=list(CROSSINGS.values()))
    if kind == "part":
        chosen = _draw_one(moves.parts, random)
    elif kind == "few":
        chosen = random.choice(len(q), min(int(random.integers(1, _FEW + 1)), len(q)), replace=False).tolist()
    else:
        length = int(random.integers(1, max(2, len(moves.residues) // 2 + 1)))
        first = int(random.integers(len(moves.residues) - length + 1))
        stretch = moves.residues[first : first + length]
        chosen = [k for residue in stretch for k in (*residue.backbone, *residue.chi)]
    q = q.copy()
    q[chosen] = q_other[chosen]
    return q


def apply_move(moves: Moves, kind: str, q: Floats, size: float, random: np.random.Generator) -> Floats:
    """Torsions (n,) after a move of this kind at a random residue or hinge: q (n,) rad, size rad."""
    q = q.copy()
    if kind == "backbone":
        _turn_backbone(q, _draw_one(moves.with_backbone, random), random)
    elif kind == "rotamer":
        residue = _draw_one(moves.with_chi, random)
        q[list(residue.chi)] = side_chain(residue, q, random)
    elif kind == "crankshaft":
        psi, phi = _draw_one(moves.flips, random)
        turn = random.normal(scale=size)
        q[psi] += turn
        q[phi] -= turn
    else:
        q[_draw_one(moves.other_hinges, random)] += random.normal(scale=size)
    return q


def random_torsions(moves: Moves, n: int, random: np.random.Generator) -> Floats:
    """Torsions (n,), rad: drawn for each residue as in moves, uniform for other hinges."""
    q = random.uniform(-np.pi, np.pi, n)
    for residue in moves.residues:
        _turn_backbone(q, residue, random)
        if residue.chi:
            q[list(residue.chi)] = side_chain(residue, q, random)
    return q


def backbone(residue: Residue, random: np.random.Generator) -> tuple[float, float]:
    """Phi and psi, rad, from the favoured regions of a residue, drawn in proportion to their score."""
    phi, psi, share = _favoured_points(residue.kind)
    at = int(np.searchsorted(share, random.random()))
    within = random.uniform(-1.0, 1.0, 2)
    return (
        float(residue.mirror * np.deg2rad(phi[at] + within[0])),
        float(residue.mirror * np.deg2rad(psi[at] + within[1])),
    )


def side_chain(residue: Residue, q: Floats, random: np.random.Generator) -> Floats:
    """Dihedrals of a side chain, rad: a rotamer by its frequency at this phi and psi, with noise."""
    n = len(residue.chi)
    backbone_degrees = [
        usual if k == NONE else residue.mirror * float(np.rad2deg(q[k]))
        for k, usual in zip((residue.phi, residue.psi), BACKBONE, strict=True)
    ]
    chi, frequency = rotamers(residue.name, *backbone_degrees)
    if not len(frequency) or chi.shape[1] < n:
        return random.uniform(-np.pi, np.pi, n)
    drawn = chi[random.choice(len(frequency), p=frequency), :n]
    return np.asarray(residue.mirror * (drawn + random.normal(scale=JITTER, size=n)))


@cache
def _favoured_points(kind: int) -> tuple[Floats, Floats, Floats]:
    """Phi and psi of the favoured points of a class, degrees, and their cumulative shares."""
    table = tables()[kind]
    i, j = np.nonzero(table >= FAVOURED)
    share = np.cumsum(table[i, j])
    return read_only(-179.0 + 2.0 * i), read_only(-179.0 + 2.0 * j), read_only(share / share[-1])


def _turn_backbone(q: Floats, residue: Residue, random: np.random.Generator) -> None:
    for coordinate, angle in zip((residue.phi, residue.psi), backbone(residue, random), strict=True):
        if coordinate != NONE:
            q[coordinate] = angle


def _draw_one(sequence: Sequence[T], random: np.random.Generator) -> T:
    return sequence[int(random.integers(len(sequence)))]
