"""Flips of Asn, Gln and His, and tautomers of His, by one network of hydrogen bonds.

Density does not show the orientation of an amide or histidine ring. All sites are chosen together by hydrogen
bonds and contacts, as by Reduce (Word, Lovell, Richardson, Richardson, J. Mol. Biol. 285:1735, 1999).
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

_HYDROGEN_BOND = 3.5  # Angstrom, donor to acceptor, as in OpenMM's Modeller.
_FULL, _FARTHEST = 3.2, 3.7
"""Angstrom: a hydrogen bond of an amide counts fully up to the first, and not at all from the second."""
_REACH, _PAIR = 6.0, 8.5
"""Angstrom: search radii around a pivot, and between two. Ends are within 2.4 of it, bonds within 3.7."""
_BONDED = 1.9  # Angstrom: heavy atoms nearer than this to a donor are bonded to it.
_TINY = 1e-9  # Angstrom: least length of a direction.
_STRAIGHT = np.cos(np.deg2rad(50.0))
_DONOR_ANGLE = np.deg2rad(115.0)  # Rad: angle at a donor between its only neighbour and the acceptor.
_MIN_DONOR_COSINE, _MIN_ACCEPTOR_COSINE = 0.5, -0.2
"""Least cosines: of a donor's hydrogen with the acceptor, and of the acceptor's bond with the donor."""
_METAL_WEIGHT = 2.0  # Weight of a metal near an oxygen or nitrogen of an amide, in hydrogen bonds.
_RING = {"ND1": ("CG", "CE1"), "NE2": ("CD2", "CE1"), "CD2": ("CG", "NE2"), "CE1": ("ND1", "NE2")}
"""Ring atoms that have a hydrogen or a lone pair, and their neighbours."""
_CARBON = 3.0  # Angstrom: a ring carbon nearer than this to an oxygen or nitrogen is penalised.
_AXIS = {"HIS": ("CB", "CG"), "ASN": ("CB", "CG"), "GLN": ("CG", "CD")}
_TURNING = {
    "HIS": ("ND1", "CD2", "CE1", "NE2", "HD2", "HE1"), "ASN": ("OD1", "ND2"), "GLN": ("OE1", "NE2"),
}  # fmt: skip
"""Atoms beyond the axis. The oxygen of an amide comes first."""
TAUTOMERS = {"HID": "ND1", "HIE": "NE2"}
"""The nitrogen that has the hydrogen. The first of two equal tautomers is chosen."""
_HYDROXYL_WEIGHT = 0.75
"""Weight of a bond of a hydroxyl or water to a nitrogen, because the hydroxyl may turn elsewhere."""
_CONTACT, _CONTACT_REACH = 1.5, 8.0
"""Hydrogen bonds per unit of the contact score, and angstrom from a pivot to atoms that touch its ends."""
_PRIOR_SHARE, _PRIOR_SITES, _SCALE = 0.1, 4.0, 1.25
"""Prior share of wrong orientations, its weight in sites, and hydrogen bonds per factor e in the odds. Word
et al. find 20 % of amides wrong. A site is flipped for a gain of 2.7, or less if other sites are wrong."""
_IGNORED_SITES = 1  # Number of the likeliest errors that the estimate of the share ignores.
_ROUNDS = 12  # Iterations of the estimate, by expectation and maximisation.


@dataclass(frozen=True, eq=False)
class Polar:
    """An oxygen, nitrogen or metal as a donor and acceptor of hydrogen bonds. A metal is a donor."""

    x: Floats  # (3,) angstrom.
    is_donor: bool
    is_acceptor: bool
    bonded: Floats  # (n, 3) angstrom: heavy atoms bonded to it.
    is_metal: bool = False


@dataclass(frozen=True, eq=False)
class State:
    """An orientation of a site, with its tautomer."""

    tautomer: str  # Of a histidine. Empty for an amide.
    turned: bool
    at: Mapping[str, Floats]  # Positions of the residue's atoms, angstrom.
    polar: tuple[Polar, ...]  # The oxygen and nitrogens that it moves.

    def energy(self, near: Iterable[Polar]) -> float:
        """Return the energy near polar atoms: -1 per hydrogen bond, 1 per pair of donors or of acceptors."""
        if not self.tautomer:
            oxygen, nitrogen = self.polar
            return _amide_energy(oxygen, nitrogen, near)
        near = [*near]
        return sum(_ring_energy(near, self.at, name, name == TAUTOMERS[self.tautomer]) for name in _RING)


def choose_flips(templated: Iterable[tuple[Member, Template | None]]) -> tuple[dict[int, str], set[int]]:
    """Choose tautomers and flips by hydrogen bonds and contacts, and flip the side chains in place."""
    residues = [*templated]
    sites = [member for member, template in residues if template is None or _is_free_amide(member)]
    if not sites:
        return {}, set()
    states = [_states(member) for member in sites]
    ends = {id(member): _TURNING[member.name] for member in sites}
    fixed, owners = _fixed_polar_atoms(residues, ends)
    atoms, residue_of = surroundings(residues, ends)
    tree = KDTree([atom.x for atom in fixed]) if fixed else None
    pivots = np.array([state[0].at[_AXIS[m.name][1]] for m, state in zip(sites, states, strict=True)])
    around = KDTree(atoms.x).query_ball_point(pivots, _CONTACT_REACH)
    energies = []
    for member, pivot, choices, touched in zip(sites, pivots, states, around, strict=True):
        # An amide's own backbone counts, a histidine's does not.
        reached = tree.query_ball_point(pivot, _REACH) if tree else []
        polar = [fixed[k] for k in reached if member.name != "HIS" or owners[k] is not member]
        atoms_near = atoms.subset([k for k in touched if residue_of[k] != id(member)])
        # Contacts choose between orientations, and hydrogen bonds alone between tautomers.
        contacts = np.array([score(*_surface(member.name, state), atoms_near) for state in choices])
        contacts = contacts.reshape(2, -1).max(axis=1).repeat(len(choices) // 2)
        energies.append(np.array([state.energy(polar) for state in choices]) - _CONTACT * contacts)
    near = sorted(KDTree(pivots).query_pairs(_PAIR))
    # The energy of a pair is the mean of both, each near the other.
    tables = {
        (i, j): np.array(
            [[0.5 * (a.energy(b.polar) + b.energy(a.polar)) for b in states[j]] for a in states[i]]
        )
        for i, j in near
    }
    pairs = {ends: table for ends, table in tables.items() if table.any()}
    chosen = _choose_states(energies, pairs, [np.array([s.turned for s in choices]) for choices in states])
    tautomers, turned = dict[int, str](), set[int]()
    for member, choices, k in zip(sites, states, chosen.tolist(), strict=True):
        if choices[k].tautomer:
            tautomers[id(member)] = choices[k].tautomer
        if choices[k].turned:
            turned.add(id(member))
            for a in member.atoms:
                a.pos = gemmi.Position(*choices[k].at[a.name])
    return tautomers, turned


def _choose_states(
    energies: Sequence[Floats], pairs: Mapping[tuple[int, int], Floats], turned: Sequence[np.ndarray]
) -> Integers:
    """Return the states (n,) of lowest energy. The share of wrong sites sets the cost of a flip."""
    # Imported here: it imports numba, which would slow every start of the program.
    from protochain.structure.sidechains.assignment import site_elimination

    choose, share = site_elimination(pairs, [len(energy) for energy in energies]), _PRIOR_SHARE
    for _ in range(_ROUNDS):
        cost = _SCALE * float(np.log((1.0 - share) / share))
        states = choose([e + cost * flip for e, flip in zip(energies, turned, strict=True)])
        gains = _gains(energies, pairs, turned, states)
        probability = 1.0 / (1.0 + np.exp((cost - gains) / _SCALE))
        counted = np.sort(probability)[:-_IGNORED_SITES]
        share = min(0.5, (_PRIOR_SHARE * _PRIOR_SITES + float(counted.sum())) / (_PRIOR_SITES + len(counted)))
    return states


def _gains(
    energies: Sequence[Floats], pairs: Mapping[tuple[int, int], Floats],
    turned: Sequence[np.ndarray], states: Integers,
) -> Floats:  # fmt: skip
    """Return the energy (n,) that each site gains by a flip if the other sites stay."""
    totals = [energy.copy() for energy in energies]
    for (i, j), table in pairs.items():
        totals[i] += table[:, states[j]]
        totals[j] += table[states[i]]
    return np.array([e[~flip].min() - e[flip].min() for e, flip in zip(totals, turned, strict=True)])


def _is_free_amide(member: Member) -> bool:
    """Whether a residue is an amide, complete in the file, without hydrogens or links at its end."""
    names = _TURNING.get(member.name, ())
    ends = [a for a in member.atoms if a.name in (*names, *_AXIS.get(member.name, ()))]
    if len(names) != 2 or len(ends) != 4 or member.template is not None:
        return False
    hydrogens = {f"H{names[1][1:]}{k}" for k in (1, 2)}
    if member.bonded_names & {*names} or any(a.name in hydrogens for a in member.atoms):
        return False
    return min(places_in_file(ends)) >= 0


def _states(member: Member) -> list[State]:
    """Return the states of a site, the file's state first."""
    at = {a.name: np.array(a.pos.tolist()) for a in member.atoms}
    start, pivot = _AXIS[member.name]
    axis = (at[pivot] - at[start]) / max(float(np.linalg.norm(at[pivot] - at[start])), _TINY)
    arms = {name: at[name] - at[pivot] for name in at.keys() & {*_TURNING[member.name]}}
    flipped = {**at, **{name: at[pivot] + 2.0 * (arm @ axis) * axis - arm for name, arm in arms.items()}}
    states = []
    for turned, x in ((False, at), (True, flipped)):
        if member.name == "HIS":
            for tautomer, donor in TAUTOMERS.items():
                bonded = {n: np.array([x[end] for end in _RING[n]]) for n in TAUTOMERS.values()}
                polar = tuple(Polar(x[n], n == donor, n != donor, near) for n, near in bonded.items())
                states.append(State(tautomer, turned, x, polar))
        else:
            oxygen, nitrogen = _TURNING[member.name]
            near = np.array([x[pivot], x[start]])
            ends = Polar(x[oxygen], False, True, near), Polar(x[nitrogen], True, False, near)
            states.append(State("", turned, x, ends))
    return states


def _fixed_polar_atoms(
    residues: Sequence[tuple[Member, Template | None]], ends: Mapping[int, Sequence[str]]
) -> tuple[list[Polar], list[Member]]:
    """Return the polar atoms that no site moves, and their residues."""
    heavy = [(a, m, template) for m, template in residues for a in m.heavy]
    x = np.array([a.pos.tolist() for a, _, _ in heavy])
    tree = KDTree(x)
    indices = [
        k
        for k, (a, member, _) in enumerate(heavy)
        if (a.element.name in ("N", "O") or a.element.is_metal) and a.name not in ends.get(id(member), ())
    ]
    polar = list[Polar]()
    for k, near in zip(indices, tree.query_ball_point(x[indices], _BONDED) if indices else (), strict=True):
        a, _, template = heavy[k]
        bonded = x[[j for j in near if j != k]]
        polar.append(Polar(x[k], *_hydrogen_bonding(a, template), bonded, a.element.is_metal))
    return polar, [heavy[k][1] for k in indices]


def _amide_energy(oxygen: Polar, nitrogen: Polar, near: Iterable[Polar]) -> float:
    """Return the energy of an amide: its hydrogen bonds, metals, and pairs of donors or of acceptors."""
    energy = 0.0
    out = {end: end.x - end.bonded[0] for end in (oxygen, nitrogen)}
    for atom in near:
        if atom.is_donor and atom.is_acceptor:
            # A hydroxyl or water fits either end.
            continue
        for end in (oxygen, nitrogen):
            vector = atom.x - end.x
            # Atoms of poor models coincide.
            length = max(float(np.linalg.norm(vector)), _TINY)
            share = min(1.0, (_FARTHEST - length) / (_FARTHEST - _FULL))
            if share <= 0.0:
                continue
            if atom.is_metal:
                energy += _METAL_WEIGHT * share * (1.0 if end.is_donor else -1.0)
            elif atom.is_donor == end.is_donor:
                energy += share
            elif end.is_donor:
                directed = max(float(way @ (vector / length)) for way in _amine_directions(end))
                energy -= share * directed * (directed > _MIN_DONOR_COSINE)
            elif out[end] @ vector > _MIN_ACCEPTOR_COSINE * length * np.linalg.norm(out[end]):
                directed = _donor_cosine(atom, -vector / length)
                energy -= share * directed * (directed > _MIN_DONOR_COSINE)
    return energy


def _amine_directions(nitrogen: Polar) -> list[Floats]:
    """Return the directions (3,) of the two N-H bonds of an amide."""
    pivot, start = nitrogen.bonded
    out = (nitrogen.x - pivot) / max(float(np.linalg.norm(nitrogen.x - pivot)), _TINY)
    lateral = cross(out, cross(out, start - pivot))
    lateral /= max(float(np.linalg.norm(lateral)), _TINY)
    return [0.5 * out + sign * np.sqrt(0.75) * lateral for sign in (1.0, -1.0)]


def _surface(name: str, state: State) -> tuple[Spheres, Floats]:
    """Return the atoms beyond the axis with their hydrogens, and the other side-chain atoms (n, 3)."""
    at = state.at
    if name != "HIS":
        oxygen, nitrogen = state.polar
        rows = [(oxygen.x, RADII["O"], False, True), (nitrogen.x, RADII["N"], False, False)]
        rows += [(nitrogen.x + 1.01 * way, POLAR, True, False) for way in _amine_directions(nitrogen)]
    else:
        rows = []
        for atom, (first, second) in _RING.items():
            is_carbon, has_hydrogen = atom[0] == "C", atom == TAUTOMERS[state.tautomer]
            rows.append((at[atom], RADII[atom[0]], False, not (is_carbon or has_hydrogen)))
            if is_carbon or has_hydrogen:
                out = 2.0 * at[atom] - at[first] - at[second]
                out = out / max(float(np.linalg.norm(out)), _TINY)
                rows.append((at[atom] + (1.08 if is_carbon else 1.01) * out, POLAR, not is_carbon, False))
    x, radius, is_donor, is_acceptor = (np.array(column) for column in zip(*rows, strict=True))
    stem = [at[atom] for atom in ("CA", "CB", "CG", "CD") if atom in at and atom not in _TURNING[name]]
    return Spheres(x, radius, is_donor, is_acceptor, np.zeros(len(x), dtype=bool)), np.array(stem)


def _donor_cosine(donor: Polar, way: Floats) -> float:
    """Return the cosine between a direction and a donor's nearest hydrogen, or 1 if it has no bonds."""
    arms = [bond / max(float(np.linalg.norm(bond)), _TINY) for bond in donor.bonded - donor.x]
    if len(arms) == 1:
        return float(np.cos(np.arccos(np.clip(arms[0] @ way, -1.0, 1.0)) - _DONOR_ANGLE))
    out = -np.sum(arms, axis=0)
    return float(out @ way / max(np.linalg.norm(out), _TINY)) if arms else 1.0


def _ring_energy(near: Iterable[Polar], at: Mapping[str, Floats], name: str, has_hydrogen: bool) -> float:
    """Return the energy of a ring atom: -1 per hydrogen bond, 1 per polar atom that it cannot bond."""
    reach = _CARBON if name[0] == "C" else _HYDROGEN_BOND
    first, second = _RING[name]
    out = 2.0 * at[name] - at[first] - at[second]
    out = out / max(float(np.linalg.norm(out)), _TINY)
    energy = 0.0
    for atom in near:
        vector = atom.x - (at[name] + out)
        if np.linalg.norm(atom.x - at[name]) > reach or vector @ out <= _STRAIGHT * np.linalg.norm(vector):
            continue
        if name[0] == "N" and (atom.is_acceptor if has_hydrogen else atom.is_donor):
            energy -= 1.0 if has_hydrogen or not atom.is_acceptor else _HYDROXYL_WEIGHT
        else:
            energy += 1.0
    return energy


def _hydrogen_bonding(a: gemmi.Atom, template: Template | None) -> tuple[bool, bool]:
    """Return whether an atom is a donor, and whether it is an acceptor, by its template. Both may be true."""
    if a.element.is_metal:
        return True, False
    if template is None:
        return a.name != "O", a.name != "N"
    is_donor = bool(template.hydrogens.get(a.name))
    is_open = not (template.hydrogens or template.is_users)
    return is_donor or is_open, a.element.name == "O" or not (is_donor or a.name == "N")
