"""Which close pairs of atoms, one of the protein and one of a molecule kept with it, are covalent bonds.

A bond that the file states is believed if its length is one of bonds and no atom gets more than it can have.
Any other has to be a known kind of link between atoms that lack a neighbour, at usual angles, of a residue
that is not near the protein elsewhere: two molecules that overlap have close pairs of every kind.
"""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import gemmi
import numpy as np
from scipy.spatial import KDTree

from protochain.core.arrays import Floats
from protochain.structure.molecule.links import Link, usual_length
from protochain.structure.molecule.member import Member
from protochain.structure.preparation.structure_draft import Draft

COVALENT_SLACK = 0.3
"""Angstrom by which atoms that are bonded may be nearer, or further apart, than the sum of their covalent
radii (Cordero et al., Dalton Trans. 2832, 2008)."""
STATED_SLACK = 0.7
"""The same further apart, if the file states the bond: models are off, and springs draw it in."""
STATED = 3.3
"""Angstrom: bonds that the file states are believed up to this length."""
SHORTEST = 0.8
"""Angstrom: atoms nearer than this lie on one another, whatever the file states."""
_ANGLES = np.deg2rad(75.0), np.deg2rad(150.0)
"""Of a bond with others of its atoms: C-S-C has 100, C-O-P 120, C=N-C 125 degrees; glycans at a resolution of
3.7 angstrom are off by 30."""
_FLAT = 0.25
"""Angstrom: a carbon whose height over its three neighbours is less has a double bond (0.5 without)."""
_LINEAR = np.deg2rad(160.0)

SUGAR = "sugar"
"""A carbon that has an oxygen of a ring or a chain, as C1 of a sugar has."""
_HYDROXYL = frozenset({"C", "P", "S", "B"})
_ACID = frozenset({"C", "P"})
KINDS: Mapping[tuple[str, str], frozenset[str]] = {
    ("ASN", "ND2"): frozenset({SUGAR}),  # N-glycans
    ("TRP", "CD1"): frozenset({SUGAR}),  # C-mannosyl
    ("SER", "OG"): _HYDROXYL,  # O-glycans, acyl enzymes, phosphates, phosphonates, sulphonyls, boronic acids
    ("THR", "OG1"): _HYDROXYL,
    ("TYR", "OH"): _HYDROXYL,  # glycogenin, nucleotides, DNA of topoisomerases, sulphate
    ("CYS", "SG"): frozenset({"C", "S"}),  # thioethers (heme c, flavins, bilins), thioesters, disulfides
    ("LYS", "NZ"): _ACID,  # Schiff bases (retinal, PLP), amides (biotin, lipoyl), nucleotides of ligases
    ("HIS", "ND1"): _ACID,  # flavins, chloromethyl ketones, phosphate
    ("HIS", "NE2"): _ACID,
    ("ASP", "OD1"): _ACID,  # glycosyl enzymes, esters of heme, acyl phosphates
    ("ASP", "OD2"): _ACID,
    ("GLU", "OE1"): _ACID,
    ("GLU", "OE2"): _ACID,
}
"""Elements to which atoms of side chains are known to be bonded: RESID (Garavelli, Proteomics 4:1527, 2004),
the list of modifications of UniProt (ptmlist), and of inhibitors CovPDB (Gao, Moumbock, Qaseem, Xu, Guenther,
Nucleic Acids Res. 50:D445, 2022)."""
_AT_N, _AT_C = frozenset({"C"}), frozenset({"N"})
"""The same of both ends of a chain: acyl groups, amides."""
_HYDROGENS_LEFT = {"ND2": 1, "NZ": 2, "N": 1}
"""Hydrogens that an atom of the protein may have beside such a bond; others have none."""
_MOST = {"C": 4, "N": 4, "O": 2, "P": 5, "S": 4, "Se": 4, "B": 4, "Si": 4}
"""Neighbours at most of an atom outside the protein; one of the protein gets one such bond."""
_REACH = 2.8
"""Angstrom: no bond between atoms that are no metals is longer."""


@dataclass(frozen=True, eq=False)
class ClosePairs:
    """Close pairs of atoms, by kind."""

    bonded: list[Link]  # In the order given.
    refused: list[tuple[Link, str]]  # Bonds that the file states and that cannot be, and why.
    overlapping: list[Link]  # As near as bonded atoms, and not bonded; in the order given.


def classify_pairs(draft: Draft, pairs: Sequence[Link]) -> ClosePairs:
    """Tell bonds from overlaps: those of the file first, then those nearest to a usual length."""
    near = _Neighbourhood(draft)
    close = [pair for pair in pairs if pair.excess <= COVALENT_SLACK]
    crowd = Counter(id(pair.hetero) for pair in close)
    likely = {pair for pair in close if not pair.stated and near.is_link(pair)}
    # Of a residue pushed into the protein, none of the close pairs is a bond; a heme may have two bonds.
    crowd -= Counter(id(pair.hetero) for pair in close if pair.stated or pair in likely)
    used: Counter[int] = Counter()
    bonded: list[Link] = []
    refused: list[tuple[Link, str]] = []
    for pair in sorted(pairs, key=lambda each: (not each.stated, abs(each.excess))):
        if pair.stated:
            reason = near.why_not(pair, used)
            if reason:
                refused.append((pair, reason))
                continue
        elif pair not in likely or crowd[id(pair.hetero)] or any(used[end] for end in pair.ends):
            continue
        used.update(pair.ends)
        bonded.append(pair)
    joined = {pair.owners for pair in bonded}
    # The neighbours of a bond may be near, too.
    overlapping = [
        pair
        for pair in close
        if pair not in bonded and not (pair.owners in joined and any(used[end] for end in pair.ends))
    ]
    return ClosePairs([pair for pair in pairs if pair in bonded], refused, overlapping)


class _Neighbourhood:
    """Bonded neighbours of the atoms of a draft, whose hydrogens may be missing."""

    def __init__(self, draft: Draft) -> None:
        protein = [part for part in draft.parts if not part.obstacle]
        ends = [part for part in protein if not part.cyclic]
        self.first = {id(part.members[0]) for part in ends}
        self.last = {id(part.members[-1]) for part in ends}
        cysteines = (m for part in protein for m in part.members if m.name == "CYS")
        self.sulphurs = [a for m in cysteines if (a := m.atom("SG"))]
        self.beside = [
            (m, a)
            for part in draft.parts if part.obstacle for m in part.members if m.name != "HOH"
            for a in m.atoms if not a.element.is_metal
        ]  # fmt: skip
        self.tree = KDTree([a.pos.tolist() for _, a in self.beside]) if self.beside else None

    def why_not(self, pair: Link, used: Mapping[int, int]) -> str:
        """Why a bond that the file states cannot be; empty if it can."""
        if pair.length < SHORTEST or pair.excess > STATED_SLACK:
            return f"it is {pair.length:.2f} angstrom long"
        heavy = sum(not a.is_hydrogen() for a in self._its(pair.hetero, pair.hetero_atom))
        free = _MOST.get(pair.hetero_atom.element.name, 1) - heavy
        for member, atom, left in ((pair.member, pair.atom, 1), (pair.hetero, pair.hetero_atom, free)):
            if used[id(atom)] >= left:
                return f"{atom.name} of {member} has no valence left for it"
        return ""

    def is_link(self, pair: Link) -> bool:
        """Whether a pair is a known kind of link, of atoms that lack a neighbour, at usual angles."""
        mine, its = self._mine(pair.member, pair.atom), self._its(pair.hetero, pair.hetero_atom)
        return (
            abs(pair.excess) <= COVALENT_SLACK
            # A nucleotide has all its atoms.
            and pair.hetero.template is not None
            and self._is_known(pair, its)
            and sum(a.is_hydrogen() for a in mine) <= _HYDROGENS_LEFT.get(pair.atom.name, 0)
            and (pair.atom.name != "SG" or len(mine) == 1)
            and len(pair.hetero.template.neighbours(pair.hetero_atom.name) - {a.name for a in its}) == 0
            and _lacks_neighbour(pair.hetero_atom, its)
            and has_usual_angles(mine, pair.atom, pair.hetero_atom)
            and has_usual_angles(its, pair.hetero_atom, pair.atom)
        )

    def _is_known(self, pair: Link, its: Sequence[gemmi.Atom]) -> bool:
        member, name, element = pair.member, pair.atom.name, pair.hetero_atom.element.name
        kinds = KINDS.get((member.name, name), frozenset())
        if SUGAR in kinds and element == "C":
            ethers = (a for a in its if a.element.name == "O")
            return any(len([b for b in self._its(pair.hetero, a) if not b.is_hydrogen()]) > 1 for a in ethers)
        if name == "N" and id(member) in self.first:
            kinds = _AT_N
        elif name == "C" and id(member) in self.last and not member.atom("OXT"):
            kinds = _AT_C
        return element in kinds

    def _mine(self, member: Member, atom: gemmi.Atom) -> list[gemmi.Atom]:
        """Neighbours of an atom of the protein in its residue, and the other sulphur of a disulfide."""
        near = {id(a): a for a in (*member.atoms, *(self.sulphurs if atom.name == "SG" else ()))}
        return [a for a in near.values() if a is not atom and _are_bonded(a, atom)]

    def _its(self, member: Member, atom: gemmi.Atom) -> list[gemmi.Atom]:
        """Neighbours of an atom outside the protein, in its molecule and in those bonded to it."""
        assert self.tree is not None
        names = member.template.neighbours(atom.name) if member.template else None
        near = (self.beside[k] for k in self.tree.query_ball_point(atom.pos.tolist(), _REACH))
        return [
            a
            for its, a in near
            if a is not atom
            and (a.name in names if its is member and names is not None else _are_bonded(a, atom))
        ]


def _are_bonded(first: gemmi.Atom, second: gemmi.Atom) -> bool:
    return (
        first.pos.dist(second.pos) <= usual_length(first.element.name, second.element.name) + COVALENT_SLACK
    )


def _lacks_neighbour(atom: gemmi.Atom, its: Sequence[gemmi.Atom]) -> bool:
    """Whether an atom outside the protein, with neighbours as they are in the file, can have one more."""
    element, x = atom.element.name, _places(its) - atom.pos.tolist()
    if element == "C" and len(its) == 3:
        across = np.cross(x[1] - x[0], x[2] - x[0])
        return bool(abs(across @ x[0]) > _FLAT * np.linalg.norm(across))
    if element == "C" and len(its) == 2:
        return bool(_angle(x[0], x[1]) < _LINEAR)
    if element == "S":
        return len(its) < (4 if any(a.element.name == "O" for a in its) else 2)
    return len(its) < {"C": 4, "N": 3, "P": 4, "B": 4}.get(element, 1)


def has_usual_angles(neighbours: Iterable[gemmi.Atom], middle: gemmi.Atom, end: gemmi.Atom) -> bool:
    """Whether a bond has usual angles with the others of an atom; those with hydrogens are not looked at."""
    low, high = _ANGLES
    arm = np.array(end.pos.tolist()) - middle.pos.tolist()
    others = _places([a for a in neighbours if not a.is_hydrogen()]) - middle.pos.tolist()
    return all(low <= _angle(other, arm) <= high for other in others)


def _places(atoms: Sequence[gemmi.Atom]) -> Floats:
    return np.array([a.pos.tolist() for a in atoms]).reshape(-1, 3)


def _angle(u: Floats, v: Floats) -> float:
    return float(np.arctan2(np.linalg.norm(np.cross(u, v)), u @ v))
