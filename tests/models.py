"""Damaged models of real structures, for tests and benchmarks, reproduced by their seeds.

A model is a Structure with other positions and the same atoms. Damage is like that of predicted and rebuilt
models: atoms and dihedrals off, side chains in wrong rotamers, peptide bonds broken, and bonds threaded
through rings.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

import protochain as pc
from protochain.structure.residues import CHI

RINGS = {
    "PHE": (("CG", "CD1", "CE1", "CZ", "CE2", "CD2"),),
    "TYR": (("CG", "CD1", "CE1", "CZ", "CE2", "CD2"),),
    "TRP": (("CG", "CD1", "NE1", "CE2", "CD2"), ("CD2", "CE2", "CZ2", "CH2", "CZ3", "CE3")),
    "HIS": (("CG", "ND1", "CE1", "NE2", "CD2"),),
    "PRO": (("N", "CA", "CB", "CG", "CD"),),
}
"""Atoms of the rings of a residue, in order around each."""
_PLANAR = ("CD", "NE", "CZ", "NH1")
"""The last dihedral of arginine, which does not turn."""


def shaken(structure: pc.Structure, angstrom: float, seed: int) -> pc.Structure:
    """Heavy atoms moved by Gaussian noise of a standard deviation in each direction, hydrogens with them.

    From 0.3 angstrom on, some bonded atoms coincide and some chiral atoms change hand.
    """
    noise = np.random.default_rng(seed).normal(scale=angstrom / 10.0, size=structure.positions.shape)
    parent = np.arange(structure.n_atoms)
    is_hydrogen = structure.atom_element == "H"
    for i, j in structure.bonds[is_hydrogen[structure.bonds].any(axis=1)].tolist():
        parent[i if is_hydrogen[i] else j] = j if is_hydrogen[i] else i
    return structure.with_positions(structure.positions + noise[parent])


def turned(structure: pc.Structure, degrees: float, seed: int, hinges: str = "phi psi chi") -> pc.Structure:
    """Every dihedral changed by Gaussian noise; the first chain's errors add up along it."""
    chain = pc.build_chain(structure, hinges=hinges)
    turn = np.random.default_rng(seed).normal(scale=np.deg2rad(degrees), size=chain.n_hinges)
    q = chain.q0.copy()
    q[chain.tree.q_start[chain.hinge_body]] += turn
    return structure.with_positions(pc.pose(chain, q).x)


def with_random_side_chains(
    structure: pc.Structure, seed: int, chis: int | None = None, share: float = 1.0
) -> pc.Structure:
    """Side chains turned to random dihedrals, hydrogens with them.

    The first ``chis`` dihedrals of each are drawn (1: chi1 only; None: all), in a share of the residues;
    not those of residues bonded elsewhere by their side chains, such as cystines.
    """
    random = np.random.default_rng(seed)
    x = structure.positions.copy()
    for residue in range(structure.n_residues):
        axes = _axes(structure, residue)[:chis]
        if random.random() < share:
            turns = random.uniform(-np.pi, np.pi, size=len(axes))
            x = _posed(x, axes, turns[None])[0]
    return structure.with_positions(x)


def broken(structure: pc.Structure, angstrom: float, seed: int, n: int = 1, longest: int = 8) -> pc.Structure:
    """Segments of at most ``longest`` residues shifted as they are: the peptide bonds at both ends break.

    The shift is within 60 degrees of the first of the two bonds, which becomes longer.
    """
    random = np.random.default_rng(seed)
    x = structure.positions.copy()
    at = _backbone(structure)
    free = [r for r in at if r - 1 in at and _follows(structure, r)]
    for _ in range(n):
        first = int(random.choice(free))
        last = first
        while last - first + 1 < longest and last + 1 in free and (last == first or random.random() < 0.7):
            last += 1
        bond = x[at[first]["N"]] - x[at[first - 1]["C"]]
        away = bond / np.linalg.norm(bond)
        direction = np.zeros(3)
        while direction @ away <= 0.5:
            direction = random.normal(size=3)
            direction /= np.linalg.norm(direction)
        moved = np.isin(structure.atom_residue, np.arange(first, last + 1))
        x[moved] += direction * angstrom / 10.0
    return structure.with_positions(x)


@dataclass(frozen=True)
class Planted:
    """A model with one threaded ring.

    Parameters
    ----------
    structure : Structure
    ring : tuple of int
        Atoms of the ring, in order around it.
    bond : tuple of int
        The two atoms whose bond passes through it.
    ring_residue, threading_residue : int
    """

    structure: pc.Structure
    ring: tuple[int, ...]
    bond: tuple[int, int]
    ring_residue: int
    threading_residue: int


def planted_rings(structures: Sequence[pc.Structure], n: int, seed: int) -> list[Planted]:
    """n models, each with one bond of a side chain through one ring beside it, each ring and bond once.

    Dihedrals of the two side chains are drawn until a bond of heavy atoms passes near the centre of the ring.
    Of the conformers that do, the one that keeps farthest from other residues is taken, if it threads no
    other ring. The structures take turns.

    Raises
    ------
    ValueError
        If the structures have fewer places.
    """
    random = np.random.default_rng(seed)
    streams = [_plants(structure, random) for structure in structures]
    found: list[Planted] = []
    while streams and len(found) < n:
        for stream in list(streams):
            plant = next(stream, None)
            if plant is None:
                streams.remove(stream)
            elif len(found) < n:
                found.append(plant)
    if len(found) < n:
        raise ValueError(f"the structures have {len(found)} places for a threaded ring, not {n}")
    return found


def threadings(structure: pc.Structure) -> list[tuple[tuple[int, ...], tuple[int, int]]]:
    """Rings of side chains and the bonds of heavy atoms that pass through them."""
    x = structure.positions
    bonds = _heavy_bonds(structure)
    found = []
    for residue in range(structure.n_residues):
        for ring in _rings(structure, residue):
            apart = bonds[~np.isin(bonds, ring).any(axis=1)]
            near = np.linalg.norm(x[apart[:, 0]] - x[ring[0]], axis=1) < 0.6
            i, j = apart[near].T
            through = _passes(x[None, list(ring)], x[i], x[j])
            found += [(ring, (int(a), int(b))) for a, b in zip(i[through], j[through], strict=True)]
    return found


def nmr_models(path: Path, models: Sequence[int]) -> list[pc.Structure]:
    """Models of an NMR ensemble, by their numbers."""
    return [pc.load(path, model=model) for model in models]


def damaged(structures: Sequence[pc.Structure], n: int, seed: int) -> Iterator[tuple[str, pc.Structure]]:
    """n damaged models with their names: the kinds and the structures take turns."""
    kinds = {
        "shaken01": lambda s, k: shaken(s, 0.1, k),
        "chi1": lambda s, k: with_random_side_chains(s, k, chis=1),
        "broken": lambda s, k: broken(s, 0.5 + 1.0 * (k % 5) / 4.0, k, n=1 + k % 2),
        "turned": lambda s, k: turned(s, 2.0, k),
        "chis": lambda s, k: with_random_side_chains(s, k),
        "shaken025": lambda s, k: shaken(s, 0.25, k),
        "mixed": lambda s, k: broken(with_random_side_chains(shaken(s, 0.1, k), k, share=0.3), 1.0, k),
    }
    names = list(kinds)
    for k in range(n):
        structure = structures[(k // len(names)) % len(structures)]
        kind = names[k % len(names)]
        yield f"{structure.name}-{kind}-{k:04}", kinds[kind](structure, seed + k)


def _plants(structure: pc.Structure, random: np.random.Generator) -> Iterator[Planted]:
    """Threaded rings of a structure, each pair of residues once, in random order."""
    x = structure.positions
    heavy = structure.atom_element != "H"
    pairs = []
    for residue in range(structure.n_residues):
        for ring in _rings(structure, residue):
            centre = x[list(ring)].mean(axis=0)
            near = np.flatnonzero((np.linalg.norm(x - centre, axis=1) < 0.9) & heavy & ~structure.kept)
            for other in sorted(set(structure.atom_residue[near].tolist()) - {residue}):
                pairs.append((ring, residue, other))
    known = len(threadings(structure))
    for k in random.permutation(len(pairs)):
        ring, residue, other = pairs[k]
        for bond, x in _threaded(structure, ring, other, random).items():
            model = structure.with_positions(x)
            if len(threadings(model)) == known + 1:
                yield Planted(model, ring, bond, residue, other)


def _threaded(
    structure: pc.Structure, ring: tuple[int, ...], other: int, random: np.random.Generator, tries: int = 1500
) -> dict[tuple[int, int], np.ndarray]:
    """Positions with a bond of a residue's side chain through a ring, for each bond for which it finds some.

    The dihedrals of both side chains are drawn; the ring stays where it is half of the times.
    """
    residue = int(structure.atom_residue[ring[0]])
    own, axes = _axes(structure, residue), _axes(structure, other)
    if not axes:
        return {}
    turns = random.uniform(-np.pi, np.pi, size=(tries, len(own) + len(axes)))
    turns[: tries // 2, : len(own)] = 0.0
    here = np.flatnonzero(np.isin(structure.atom_residue, [residue, other]))
    place = {int(atom): k for k, atom in enumerate(here)}
    local = [(place[i], place[j], [place[k] for k in moved]) for i, j, moved in own + axes]
    x = _posed(structure.positions[here], local, turns)
    turning = set(axes[0][2])
    loose = [place[atom] for atom in turning if structure.atom_element[atom] != "H"]
    beside = np.flatnonzero(
        (structure.atom_element != "H") & ~np.isin(structure.atom_residue, [residue, other])
    )
    distances = cKDTree(structure.positions[beside])
    found = {}
    for i, j in _heavy_bonds(structure).tolist():
        if i not in turning or j not in turning:
            continue
        passing = _passes(x[:, [place[k] for k in ring]], x[:, place[i]], x[:, place[j]], within=0.8)
        if passing.any():
            passed = x[passing]
            room = distances.query(passed[:, loose])[0].min(axis=1)
            found[i, j] = structure.positions.copy()
            found[i, j][here] = passed[np.argmax(room)]
    return found


def _passes(ring: np.ndarray, first: np.ndarray, second: np.ndarray, within: float = 1.0) -> np.ndarray:
    """(n,) bool: whether segments cross the mean plane of rings (n or 1, m, 3) inside, shrunk by a factor."""
    centre = ring.mean(axis=1, keepdims=True)
    normal = np.linalg.svd(ring - centre)[2][:, 2]
    a, b = (((end - centre[:, 0]) * normal).sum(axis=1) for end in (first, second))
    crossing = a * b < 0
    share = np.where(crossing, a / np.where(crossing, a - b, 1.0), 0.0)
    point = (first + share[:, None] * (second - first) - centre[:, 0])[:, None]
    edge = within * (ring - centre)
    side = (np.cross(np.roll(edge, -1, axis=1) - edge, point - edge) * normal[:, None]).sum(axis=2)
    return crossing & ((side > 0).all(axis=1) | (side < 0).all(axis=1))


def _rings(structure: pc.Structure, residue: int) -> list[tuple[int, ...]]:
    at = _names(structure, residue)
    rings = RINGS.get(str(structure.residue_name[residue]), ())
    return [tuple(at[name] for name in ring) for ring in rings if at.keys() >= set(ring)]


def _names(structure: pc.Structure, residue: int) -> dict[str, int]:
    atoms = np.flatnonzero(structure.atom_residue == residue)
    return {str(structure.atom_name[i]): int(i) for i in atoms}


def _heavy_bonds(structure: pc.Structure) -> np.ndarray:
    heavy = structure.atom_element != "H"
    return structure.bonds[heavy[structure.bonds].all(axis=1)]


def _backbone(structure: pc.Structure) -> dict[int, dict[str, int]]:
    """Atoms by name of the residues that have N, CA and C."""
    each = {residue: _names(structure, residue) for residue in range(structure.n_residues)}
    return {residue: at for residue, at in each.items() if at.keys() >= {"N", "CA", "C"}}


def _follows(structure: pc.Structure, residue: int) -> bool:
    return bool(structure.residue_chain_index[residue] == structure.residue_chain_index[residue - 1])


def _axes(structure: pc.Structure, residue: int) -> list[tuple[int, int, list[int]]]:
    """Bonds about which a side chain turns, from the backbone outward: two atoms, and those that turn."""
    at = _names(structure, residue)
    inside = set(at.values())
    bonded: dict[int, set[int]] = {atom: set() for atom in inside}
    elsewhere = set()
    for i, j in structure.bonds[np.isin(structure.bonds, list(inside)).any(axis=1)].tolist():
        if i in inside and j in inside:
            bonded[i].add(j)
            bonded[j].add(i)
        else:
            elsewhere |= {i, j} & inside
    axes = []
    for quartet in CHI.get(str(structure.residue_name[residue]), ()):
        if quartet == _PLANAR or not at.keys() >= set(quartet):
            continue
        first, second = at[quartet[1]], at[quartet[2]]
        beyond, ahead = {second}, [second]
        while ahead:
            new = bonded[ahead.pop()] - beyond - {first}
            beyond |= new
            ahead += new
        if beyond & elsewhere:
            return []
        axes.append((first, second, sorted(beyond - {second})))
    return axes


def _posed(x: np.ndarray, axes: list[tuple[int, int, list[int]]], turns: np.ndarray) -> np.ndarray:
    """(n, na, 3): positions with the atoms beyond each axis turned by angles (n, n_axes)."""
    x = np.repeat(x[None], len(turns), axis=0)
    for (first, second, moved), turn in zip(axes, turns.T, strict=True):
        axis = x[:, second] - x[:, first]
        axis = (axis / np.linalg.norm(axis, axis=1, keepdims=True))[:, None]
        arm = x[:, moved] - x[:, None, second]
        cos, sin = np.cos(turn)[:, None, None], np.sin(turn)[:, None, None]
        along = (arm * axis).sum(axis=2, keepdims=True) * axis
        turned = along + cos * (arm - along) + sin * np.cross(axis, arm)
        x[:, moved] = x[:, None, second] + turned
    return x
