"""Distinction of covalent bonds and overlaps among close pairs of protein and hetero atoms.

A bond in the file is accepted if its length is plausible and both atoms have a free valence. Other pairs
must be a known kind of link at usual angles, between atoms that lack a neighbour. The residue must have no
other close contacts with the protein, because overlapping molecules have close pairs of every kind.
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
"""Angstrom. Largest deviation of a bond from covalent radii (Cordero et al., Dalton Trans. 2832, 2008)."""
STATED_SLACK = 0.7
"""Angstrom. Largest excess length of a bond in the file. Models are inaccurate, and springs shorten it."""
STATED = 3.3
"""Angstrom. Largest length of bonds in the file."""
SHORTEST = 0.8
"""Angstrom. Closer atoms overlap, also if the file lists a bond."""
_ANGLES = np.deg2rad(75.0), np.deg2rad(150.0)
"""Limits of bond angles: C-S-C has 100, C-O-P 120, C=N-C 125 degrees. Errors of glycans at a resolution of
3.7 angstrom are 30 degrees."""
_PLANAR = 0.25
"""Angstrom. A carbon closer to the plane of its three neighbours has a double bond (0.5 without)."""
_LINEAR = np.deg2rad(160.0)

SUGAR = "sugar"
"""A carbon bonded to an ether oxygen, such as C1 of a sugar."""
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
"""Elements that are known to bond to side-chain atoms: RESID (Garavelli, Proteomics 4:1527, 2004), UniProt's
list of modifications (ptmlist), and for inhibitors CovPDB (Gao, Moumbock, Qaseem, Xu, Guenther, Nucleic Acids
Res. 50:D445, 2022)."""
_AT_N, _AT_C = frozenset({"C"}), frozenset({"N"})
"""Elements that bond to the ends of a chain: acyl groups, amides."""
_MAX_HYDROGENS = {"ND2": 1, "NZ": 2, "N": 1}
"""Largest number of hydrogens of a protein atom with such a bond. Other atoms have none."""
_MAX_NEIGHBOURS = {"C": 4, "N": 4, "O": 2, "P": 5, "S": 4, "Se": 4, "B": 4, "Si": 4}
"""Largest number of neighbours of a hetero atom. A protein atom can have one such bond."""
_REACH = 2.8  # Angstrom. Upper limit of bonds between nonmetals.


@dataclass(frozen=True, eq=False)
class ClosePairs:
    """Close pairs of atoms, by kind."""

    bonded: list[Link]  # In the order of the input.
    refused: list[tuple[Link, str]]  # Impossible bonds of the file, with the reason.
    overlapping: list[Link]  # At bonding distance but not bonded, in the order of the input.


def classify_pairs(draft: Draft, pairs: Sequence[Link]) -> ClosePairs:
    """Classify pairs as bonds or overlaps: bonds of the file first, then by deviation from usual lengths."""
    near = _Neighbourhood(draft)
    close = [pair for pair in pairs if pair.excess <= COVALENT_SLACK]
    crowd = Counter(id(pair.hetero) for pair in close)
    likely = {pair for pair in close if not pair.stated and near.is_link(pair)}
    # A residue with other close pairs overlaps the protein and has no bonds. A heme may have two bonds.
    crowd -= Counter(id(pair.hetero) for pair in close if pair.stated or pair in likely)
    used: Counter[int] = Counter()
    bonded: list[Link] = []
    refused: list[tuple[Link, str]] = []
    for pair in sorted(pairs, key=lambda link: (not link.stated, abs(link.excess))):
        if pair.stated:
            reason = near.refusal(pair, used)
            if reason:
                refused.append((pair, reason))
                continue
        elif pair not in likely or crowd[id(pair.hetero)] or any(used[end] for end in pair.ends):
            continue
        used.update(pair.ends)
        bonded.append(pair)
    joined = {pair.owners for pair in bonded}
    # The neighbours of a bond may also be close.
    overlapping = [
        pair
        for pair in close
        if pair not in bonded and not (pair.owners in joined and any(used[end] for end in pair.ends))
    ]
    return ClosePairs([pair for pair in pairs if pair in bonded], refused, overlapping)


class _Neighbourhood:
    """Bonded neighbours of the atoms of a draft, which may lack hydrogens."""

    def __init__(self, draft: Draft) -> None:
        protein = [part for part in draft.parts if not part.obstacle]
        ends = [part for part in protein if not part.cyclic]
        self.first = {id(part.members[0]) for part in ends}
        self.last = {id(part.members[-1]) for part in ends}
        cysteines = (m for part in protein for m in part.members if m.name == "CYS")
        self.sulphurs = [a for m in cysteines if (a := m.atom("SG"))]
        self.hetero_atoms = [
            (m, a)
            for part in draft.parts if part.obstacle for m in part.members if m.name != "HOH"
            for a in m.atoms if not a.element.is_metal
        ]  # fmt: skip
        self.tree = KDTree([a.pos.tolist() for _, a in self.hetero_atoms]) if self.hetero_atoms else None

    def refusal(self, pair: Link, used: Mapping[int, int]) -> str:
        """Return why a bond of the file is impossible, or an empty string."""
        if pair.length < SHORTEST or pair.excess > STATED_SLACK:
            return f"it is {pair.length:.2f} angstrom long"
        heavy = sum(not a.is_hydrogen() for a in self._outer(pair.hetero, pair.hetero_atom))
        free = _MAX_NEIGHBOURS.get(pair.hetero_atom.element.name, 1) - heavy
        for member, atom, left in ((pair.member, pair.atom, 1), (pair.hetero, pair.hetero_atom, free)):
            if used[id(atom)] >= left:
                return f"{atom.name} of {member} has no valence left for it"
        return ""

    def is_link(self, pair: Link) -> bool:
        """Return whether a pair is a known link at usual angles, between atoms that lack a neighbour."""
        inner, outer = self._inner(pair.member, pair.atom), self._outer(pair.hetero, pair.hetero_atom)
        return (
            abs(pair.excess) <= COVALENT_SLACK
            # Nucleotides have no template here, and their valences are complete.
            and pair.hetero.template is not None
            and self._is_known_link(pair, outer)
            and sum(a.is_hydrogen() for a in inner) <= _MAX_HYDROGENS.get(pair.atom.name, 0)
            and (pair.atom.name != "SG" or len(inner) == 1)
            and len(pair.hetero.template.neighbours(pair.hetero_atom.name) - {a.name for a in outer}) == 0
            and _lacks_neighbour(pair.hetero_atom, outer)
            and has_usual_angles(inner, pair.atom, pair.hetero_atom)
            and has_usual_angles(outer, pair.hetero_atom, pair.atom)
        )

    def _is_known_link(self, pair: Link, outer: Sequence[gemmi.Atom]) -> bool:
        member, name, element = pair.member, pair.atom.name, pair.hetero_atom.element.name
        kinds = KINDS.get((member.name, name), frozenset())
        if SUGAR in kinds and element == "C":
            near = (a for a in outer if a.element.name == "O")
            return any(len([b for b in self._outer(pair.hetero, a) if not b.is_hydrogen()]) > 1 for a in near)
        if name == "N" and id(member) in self.first:
            kinds = _AT_N
        elif name == "C" and id(member) in self.last and not member.atom("OXT"):
            kinds = _AT_C
        return element in kinds

    def _inner(self, member: Member, atom: gemmi.Atom) -> list[gemmi.Atom]:
        """Return neighbours of a protein atom in its residue, and the other sulphur of a disulfide."""
        near = {id(a): a for a in (*member.atoms, *(self.sulphurs if atom.name == "SG" else ()))}
        return [a for a in near.values() if a is not atom and _are_bonded(a, atom)]

    def _outer(self, member: Member, atom: gemmi.Atom) -> list[gemmi.Atom]:
        """Return neighbours of a hetero atom in its own and in other hetero molecules."""
        assert self.tree is not None
        names = member.template.neighbours(atom.name) if member.template else None
        near = (self.hetero_atoms[k] for k in self.tree.query_ball_point(atom.pos.tolist(), _REACH))
        return [
            a
            for owner, a in near
            if a is not atom
            and (a.name in names if owner is member and names is not None else _are_bonded(a, atom))
        ]


def _are_bonded(first: gemmi.Atom, second: gemmi.Atom) -> bool:
    longest = usual_length(first.element.name, second.element.name) + COVALENT_SLACK
    return bool(first.pos.dist(second.pos) <= longest)


def _lacks_neighbour(atom: gemmi.Atom, neighbours: Sequence[gemmi.Atom]) -> bool:
    """Return whether a hetero atom with these neighbours can have one more."""
    element, x = atom.element.name, _places(neighbours) - atom.pos.tolist()
    if element == "C" and len(neighbours) == 3:
        across = np.cross(x[1] - x[0], x[2] - x[0])
        return bool(abs(across @ x[0]) > _PLANAR * np.linalg.norm(across))
    if element == "C" and len(neighbours) == 2:
        return bool(_angle(x[0], x[1]) < _LINEAR)
    if element == "S":
        return len(neighbours) < (4 if any(a.element.name == "O" for a in neighbours) else 2)
    return len(neighbours) < {"C": 4, "N": 3, "P": 4, "B": 4}.get(element, 1)


def has_usual_angles(neighbours: Iterable[gemmi.Atom], middle: gemmi.Atom, end: gemmi.Atom) -> bool:
    """Return whether a bond has usual angles with the other bonds of an atom, except bonds to hydrogens."""
    low, high = _ANGLES
    arm = np.array(end.pos.tolist()) - middle.pos.tolist()
    vectors = _places([a for a in neighbours if not a.is_hydrogen()]) - middle.pos.tolist()
    return all(low <= _angle(v, arm) <= high for v in vectors)


def _places(atoms: Sequence[gemmi.Atom]) -> Floats:
    return np.array([a.pos.tolist() for a in atoms]).reshape(-1, 3)


def _angle(u: Floats, v: Floats) -> float:
    return float(np.arctan2(np.linalg.norm(np.cross(u, v)), u @ v))
