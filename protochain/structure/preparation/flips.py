"""Flips of Asn, Gln and His, and tautomers of His, by one network of hydrogen bonds.

Density does not distinguish the two ways in which an amide or a histidine ring lies. All sites are chosen
together by hydrogen bonds and by contacts with the other atoms, as by Reduce (Word, Lovell, Richardson,
Richardson, J. Mol. Biol. 285:1735, 1999).
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import gemmi
import numpy as np
from scipy.spatial import KDTree

from protochain.core.arrays import Floats, Integers, cross
from protochain.structure.formats.files import places_in_file
from protochain.structure.molecule.member import Member
from protochain.structure.molecule.templates import Template
from protochain.structure.preparation.contacts import POLAR, RADII, Spheres, score, surroundings

_HYDROGEN_BOND = 3.5
"""Angstrom, donor to acceptor, as in OpenMM's Modeller."""
_FULL, _FARTHEST = 3.2, 3.7
"""Angstrom: up to the first a hydrogen bond of an amide counts fully, from the second on not at all."""
_REACH, _PAIR = 6.0, 8.5
"""Angstrom: ends are 2.4 from the pivot at most, and hydrogen bonds 3.7 long. From a pivot, and of two."""
_BONDED = 1.9
"""Angstrom: heavy atoms nearer than this to a donor are bonded to it."""
_UPON = 1e-9
"""Angstrom: least length of a direction."""
_STRAIGHT = np.cos(np.deg2rad(50.0))
_BENT = np.deg2rad(115.0)
"""Angle at a donor with one neighbour, between that and the acceptor."""
_LEAST_DIRECTED, _LEAST_IN_FRONT = 0.5, -0.2
"""Cosines: of a donor's hydrogen to the acceptor, and of the acceptor's bond to the donor."""
_METAL = 2.0
"""What a metal counts at an oxygen or nitrogen of an amide, in hydrogen bonds."""
_RING = {"ND1": ("CG", "CE1"), "NE2": ("CD2", "CE1"), "CD2": ("CG", "NE2"), "CE1": ("ND1", "NE2")}
"""Atoms that have a hydrogen or a pair of electrons, and their neighbours."""
_CARBON = 3.0
"""Angstrom: a carbon of the ring is not as near to an oxygen or nitrogen."""
_AXIS = {"HIS": ("CB", "CG"), "ASN": ("CB", "CG"), "GLN": ("CG", "CD")}
_TURNING = {
    "HIS": ("ND1", "CD2", "CE1", "NE2", "HD2", "HE1"), "ASN": ("OD1", "ND2"), "GLN": ("OE1", "NE2"),
}  # fmt: skip
"""Atoms beyond the axis; of amides the oxygen first."""
TAUTOMERS = {"HID": "ND1", "HIE": "NE2"}
"""The nitrogen that has the hydrogen; of equal ones the first is taken."""
_TURNABLE = 0.75
"""What the bond of a hydroxyl or water to a nitrogen counts, which may turn elsewhere."""
_CONTACTS, _CONTACT_REACH = 1.5, 8.0
"""Hydrogen bonds for a unit of the contact score, and angstrom from a pivot to atoms that touch its ends."""
_WRONG, _PRIOR, _SCALE = 0.1, 4.0, 1.25
"""Usual share of sites that a file has the wrong way round, how many sites it counts as, and hydrogen bonds
for each factor e in the odds. Word et al. find 20 % of amides wrong. To be turned, a site must gain 2.7, and
less if others are wrong, too."""
_SPARED = 1
"""Likeliest mistakes that say nothing of the other sites."""
_ROUNDS = 12
"""Estimates of that share, by expectation and maximisation."""


@dataclass(frozen=True, eq=False)
class Polar:
    """An oxygen, nitrogen or metal, and whether it gives a hydrogen, or a metal's charge, and takes one."""

    x: Floats  # (3,) angstrom.
    gives: bool
    takes: bool
    bonded: Floats  # (n, 3) angstrom: heavy atoms bonded to it.
    is_metal: bool = False


@dataclass(frozen=True, eq=False)
class State:
    """A way in which a site may be."""

    tautomer: str  # Of histidine; empty of amides.
    turned: bool
    at: Mapping[str, Floats]  # Places of the residue's atoms, angstrom.
    polar: tuple[Polar, ...]  # The oxygen and nitrogens that it decides on.

    def energy(self, near: Iterable[Polar]) -> float:
        """Energy beside polar atoms: -1 for a hydrogen bond, 1 for two donors or acceptors together."""
        if not self.tautomer:
            oxygen, nitrogen = self.polar
            return _amide_energy(oxygen, nitrogen, near)
        near = [*near]
        return sum(_energy(near, self.at, name, name == TAUTOMERS[self.tautomer]) for name in _RING)


def settled(of: Iterable[tuple[Member, Template | None]]) -> tuple[dict[int, str], set[int]]:
    """Choose tautomers and flips with the best hydrogen bonds; side chains are turned in place."""
    residues = [*of]
    sites = [member for member, template in residues if template is None or _is_free_amide(member)]
    if not sites:
        return {}, set()
    states = [_states(member) for member in sites]
    ends = {id(member): _TURNING[member.name] for member in sites}
    fixed, owners = _fixed(residues, ends)
    atoms, residue_of = surroundings(residues, ends)
    tree = KDTree([each.x for each in fixed]) if fixed else None
    pivots = np.array([state[0].at[_AXIS[m.name][1]] for m, state in zip(sites, states, strict=True)])
    around = KDTree(atoms.x).query_ball_point(pivots, _CONTACT_REACH)
    own = []
    for member, pivot, choices, touched in zip(sites, pivots, states, around, strict=True):
        # The backbone of an amide itself counts, that of a histidine does not.
        reached = tree.query_ball_point(pivot, _REACH) if tree else []
        beside = [fixed[k] for k in reached if member.name != "HIS" or owners[k] is not member]
        atoms_near = atoms.subset([k for k in touched if residue_of[k] != id(member)])
        contacts = [score(*_surface(member.name, state), atoms_near) for state in choices]
        own.append(np.array([state.energy(beside) for state in choices]) - _CONTACTS * np.array(contacts))
    near = sorted(KDTree(pivots).query_pairs(_PAIR))
    tables = {(i, j): np.array([[_between(a, b) for b in states[j]] for a in states[i]]) for i, j in near}
    pairs = {ends: table for ends, table in tables.items() if table.any()}
    chosen = _chosen(own, pairs, [np.array([state.turned for state in choices]) for choices in states])
    found, turned = dict[int, str](), set[int]()
    for member, choices, k in zip(sites, states, chosen.tolist(), strict=True):
        if choices[k].tautomer:
            found[id(member)] = choices[k].tautomer
        if choices[k].turned:
            turned.add(id(member))
            for a in member.atoms:
                a.pos = gemmi.Position(*choices[k].at[a.name])
    return found, turned


def _between(one: State, other: State) -> float:
    """Energy of two sites, as either of them sees it, on average."""
    return 0.5 * (one.energy(other.polar) + other.energy(one.polar))


def _chosen(
    own: Sequence[Floats], pairs: Mapping[tuple[int, int], Floats], turned: Sequence[np.ndarray]
) -> Integers:
    """States (n,) of lowest energy, in which a turn costs what the share of wrong sites says."""
    # Imported here: it imports numba, which would slow every start of the program.
    from protochain.structure.sidechains.assignment import eliminated

    wrong = _WRONG
    for _ in range(_ROUNDS):
        cost = _SCALE * float(np.log((1.0 - wrong) / wrong))
        states = eliminated([each + cost * its for each, its in zip(own, turned, strict=True)], pairs)
        gains = _gains(own, pairs, turned, states)
        likely = 1.0 / (1.0 + np.exp((cost - gains) / _SCALE))
        others = np.sort(likely)[:-_SPARED]
        wrong = min(0.5, (_WRONG * _PRIOR + float(others.sum())) / (_PRIOR + len(others)))
    return states


def _gains(
    own: Sequence[Floats], pairs: Mapping[tuple[int, int], Floats],
    turned: Sequence[np.ndarray], states: Integers,
) -> Floats:  # fmt: skip
    """(n,): what each site gains by a turn, with the others as they are."""
    beside = [each.copy() for each in own]
    for (i, j), table in pairs.items():
        beside[i] += table[:, states[j]]
        beside[j] += table[states[i]]
    return np.array([e[~its].min() - e[its].min() for e, its in zip(beside, turned, strict=True)])


def _is_free_amide(member: Member) -> bool:
    """Whether it is an amide of the file that shows no hydrogens, and is bonded to nothing else."""
    names = _TURNING.get(member.name, ())
    ends = [a for a in member.atoms if a.name in (*names, *_AXIS.get(member.name, ()))]
    if len(names) != 2 or len(ends) != 4 or member.template is not None:
        return False
    hydrogens = {f"H{names[1][1:]}{k}" for k in (1, 2)}
    bonded = {a.name for a in (*member.links, *member.metals)}
    return not (
        bonded & {*names} or any(a.name in hydrogens for a in member.atoms) or min(places_in_file(ends)) < 0
    )


def _states(member: Member) -> list[State]:
    """States of a site, the one of the file first."""
    at = {a.name: np.array(a.pos.tolist()) for a in member.atoms}
    start, pivot = _AXIS[member.name]
    axis = (at[pivot] - at[start]) / max(float(np.linalg.norm(at[pivot] - at[start])), _UPON)
    arms = {name: at[name] - at[pivot] for name in at.keys() & {*_TURNING[member.name]}}
    over = {**at, **{name: at[pivot] + 2.0 * (arm @ axis) * axis - arm for name, arm in arms.items()}}
    made = []
    for turned, its in ((False, at), (True, over)):
        if member.name == "HIS":
            for tautomer, gives in TAUTOMERS.items():
                polar = [Polar(its[n], n == gives, n != gives, _of_ring(its, n)) for n in TAUTOMERS.values()]
                made.append(State(tautomer, turned, its, tuple(polar)))
        else:
            oxygen, nitrogen = _TURNING[member.name]
            near = np.array([its[pivot], its[start]])
            ends = Polar(its[oxygen], False, True, near), Polar(its[nitrogen], True, False, near)
            made.append(State("", turned, its, ends))
    return made


def _of_ring(at: Mapping[str, Floats], name: str) -> Floats:
    return np.array([at[each] for each in _RING[name]])


def _fixed(
    residues: Sequence[tuple[Member, Template | None]], deciding: Mapping[int, Sequence[str]]
) -> tuple[list[Polar], list[Member]]:
    """Polar atoms that no site decides on, and their residues."""
    heavy = [(a, m, template) for m, template in residues for a in m.heavy]
    x = np.array([a.pos.tolist() for a, _, _ in heavy])
    tree = KDTree(x)
    chosen = [
        k
        for k, (a, member, _) in enumerate(heavy)
        if (a.element.name in ("N", "O") or a.element.is_metal) and a.name not in deciding.get(id(member), ())
    ]
    polar = list[Polar]()
    for k, near in zip(chosen, tree.query_ball_point(x[chosen], _BONDED) if chosen else (), strict=True):
        a, _, template = heavy[k]
        bonded = x[[j for j in near if j != k]]
        polar.append(Polar(x[k], *_role(a, template), bonded, a.element.is_metal))
    return polar, [heavy[k][1] for k in chosen]


def _amide_energy(oxygen: Polar, nitrogen: Polar, near: Iterable[Polar]) -> float:
    """Energy of an amide: bonds that its oxygen takes and its nitrogen gives, and what lies against them."""
    energy = 0.0
    out = {end: end.x - end.bonded[0] for end in (oxygen, nitrogen)}
    for each in near:
        if each.gives and each.takes:
            # A hydroxyl or water is as well beside either.
            continue
        for end in (oxygen, nitrogen):
            way = each.x - end.x
            # Atoms of poor models coincide.
            length = max(float(np.linalg.norm(way)), _UPON)
            share = min(1.0, (_FARTHEST - length) / (_FARTHEST - _FULL))
            if share <= 0.0:
                continue
            if each.is_metal:
                energy += _METAL * share * (1.0 if end.gives else -1.0)
            elif each.gives == end.gives:
                energy += share
            elif end.gives:
                directed = _of_amine(end, way / length)
                energy -= share * directed * (directed > _LEAST_DIRECTED)
            elif out[end] @ way > _LEAST_IN_FRONT * length * np.linalg.norm(out[end]):
                directed = _directed(each, -way / length)
                energy -= share * directed * (directed > _LEAST_DIRECTED)
    return energy


def _of_amine(nitrogen: Polar, way: Floats) -> float:
    """Cosine between a direction and the nearer of the two N-H bonds of an amide."""
    return max(float(direction @ way) for direction in _amine(nitrogen))


def _amine(nitrogen: Polar) -> list[Floats]:
    """Directions (3,) of the two N-H bonds of an amide."""
    pivot, start = nitrogen.bonded
    out = (nitrogen.x - pivot) / max(float(np.linalg.norm(nitrogen.x - pivot)), _UPON)
    aside = cross(out, cross(out, start - pivot))
    aside /= max(float(np.linalg.norm(aside)), _UPON)
    return [0.5 * out + sign * np.sqrt(0.75) * aside for sign in (1.0, -1.0)]


def _surface(name: str, state: State) -> tuple[Spheres, Floats]:
    """Atoms beyond the axis with their hydrogens, and the other atoms (n, 3) of the side chain."""
    at = state.at
    if name != "HIS":
        oxygen, nitrogen = state.polar
        rows = [(oxygen.x, RADII["O"], False, True), (nitrogen.x, RADII["N"], False, False)]
        rows += [(nitrogen.x + 1.01 * way, POLAR, True, False) for way in _amine(nitrogen)]
    else:
        rows = []
        for atom, (first, second) in _RING.items():
            is_carbon, has_hydrogen = atom[0] == "C", atom == TAUTOMERS[state.tautomer]
            rows.append((at[atom], RADII[atom[0]], False, not (is_carbon or has_hydrogen)))
            if is_carbon or has_hydrogen:
                out = 2.0 * at[atom] - at[first] - at[second]
                out = out / max(float(np.linalg.norm(out)), _UPON)
                rows.append((at[atom] + (1.08 if is_carbon else 1.01) * out, POLAR, not is_carbon, False))
    x, radius, gives, takes = (np.array(column) for column in zip(*rows, strict=True))
    stem = [at[atom] for atom in ("CA", "CB", "CG", "CD") if atom in at and atom not in _TURNING[name]]
    return Spheres(x, radius, gives, takes, np.zeros(len(x), dtype=bool)), np.array(stem)


def _directed(donor: Polar, way: Floats) -> float:
    """Cosine between a direction and the hydrogen that a donor turns there; 1 if nothing is bonded to it."""
    arms = [each / max(float(np.linalg.norm(each)), _UPON) for each in donor.bonded - donor.x]
    if len(arms) == 1:
        return float(np.cos(np.arccos(np.clip(arms[0] @ way, -1.0, 1.0)) - _BENT))
    out = -np.sum(arms, axis=0)
    return float(out @ way / max(np.linalg.norm(out), _UPON)) if arms else 1.0


def _energy(near: Iterable[Polar], at: Mapping[str, Floats], name: str, has_hydrogen: bool) -> float:
    """-1 for each hydrogen bond of a nitrogen, 1 for a carbon, or a second hydrogen or pair, in its place."""
    reach = _CARBON if name[0] == "C" else _HYDROGEN_BOND
    first, second = _RING[name]
    out = 2.0 * at[name] - at[first] - at[second]
    out = out / max(float(np.linalg.norm(out)), _UPON)
    energy = 0.0
    for each in near:
        way = each.x - (at[name] + out)
        if np.linalg.norm(each.x - at[name]) > reach or way @ out <= _STRAIGHT * np.linalg.norm(way):
            continue
        if name[0] == "N" and (each.takes if has_hydrogen else each.gives):
            energy -= 1.0 if has_hydrogen or not each.takes else _TURNABLE
        else:
            energy += 1.0
    return energy


def _role(a: gemmi.Atom, template: Template | None) -> tuple[bool, bool]:
    """Whether an atom gives a hydrogen, and takes one, by its template; both if it may be either."""
    if a.element.is_metal:
        return True, False
    if template is None:
        return a.name != "O", a.name != "N"
    gives = bool(template.hydrogens.get(a.name))
    is_open = not (template.hydrogens or template.is_users)
    return gives or is_open, a.element.name == "O" or not (gives or a.name == "N")
