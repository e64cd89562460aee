"""Side chains of Asn, Gln and His put back, which were turned at random in crystals.

    python analysis/benchmarks/flips.py [-o DIR] [--quick] [--more FOLDER]

Hydrogens are removed. Each side chain is turned with probability 1/2 by exchanging the names of its ends, and
`load` prepares the file. Structures are the crystals of sidechains.py and three more, in the order of their
names. The constants of `load` were chosen on every other structure, from the first on (half "chosen"). The
others are held out (half "held out").

sites: side chains that are bonded to nothing else. put_back: sites that end as in the file. deciding: sites
whose contact score (Word et al., J. Mol. Biol. 285:1735, 1999) is better by 1 or more as in the file, beside
the file as `load` prepares it. turned: sites that `load` turns in the file as it is. wrongly_turned: deciding
sites among those.

The score: dots on the atoms beyond the axis, 16 a square angstrom, at hydrogens of the protein, too. A dot
counts exp(-(gap / 0.25)^2) at a gap to the nearest atom, -5 times an overlap, and 2 times that of a hydrogen
bond. Hydroxyl groups and ammonium turn to an acceptor.
"""

import argparse
import random
from collections.abc import Iterator
from pathlib import Path

import gemmi
import made
import numpy as np
import pandas as pd
from scipy.spatial import KDTree
from sidechains import CRYSTALS, place, read

import protochain as pc

STRUCTURES = sorted(
    {*CRYSTALS, "astex/1KZK_JE2_protein.pdb", "astex/1T40_ID5_protein.pdb", "1mj5_H.pdb"}
    - {"3al1_caps_altloc.pdb"},  # It has no site.
    key=lambda name: Path(name).name.lower(),
)
QUICK = ("1ubq_ubiquitin.pdb", "4pti_bpti.pdb")
ENDS = {
    "ASN": ("CB", "CG", {"OD1": "ND2", "ND2": "OD1"}),
    "GLN": ("CG", "CD", {"OE1": "NE2", "NE2": "OE1"}),
    "HIS": ("CB", "CG", {"ND1": "CD2", "CD2": "ND1", "NE2": "CE1", "CE1": "NE2"}),
}
"""Axis, and names that are exchanged."""
RING = {"ND1": ("CG", "CE1"), "NE2": ("CD2", "CE1"), "CD2": ("CG", "NE2"), "CE1": ("ND1", "NE2")}
RADII = {"C": 1.70, "N": 1.55, "O": 1.40, "S": 1.80, "P": 1.80, "F": 1.30, "CL": 1.77, "BR": 1.95}
METAL, POLAR, OTHER = 1.0, 1.05, 1.22
"""Angstrom: radii of metals, of hydrogens of nitrogen, oxygen and aromatic rings, of other hydrogens."""
WIDTH, REACH, BUMP, BOND, DEEPEST = 0.25, 0.5, 5.0, 2.0, 0.6
DENSITY = 16.0
CLEAR = 1.0
SEED = 1
Site = tuple[str, str]


def unit(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v)


class Contacts:
    """Contact scores of the sites of a prepared structure."""

    def __init__(self, s: pc.Structure) -> None:
        self.s, self.x = s, 10.0 * s.positions
        self.elements = [str(each).upper() for each in s.atom_element]
        self.names = [str(each) for each in s.atom_name]
        self.bonded: list[list[int]] = [[] for _ in self.names]
        for i, j in s.bonds.tolist():
            self.bonded[i].append(j)
            self.bonded[j].append(i)
        parts = [self.atom(k) for k in range(len(self.x))]
        self.radius, self.gives, self.takes, self.turns, self.counts = map(np.array, zip(*parts, strict=True))
        self.tree = KDTree(self.x)

    def atom(self, k: int) -> tuple[float, bool, bool, bool, bool]:
        """Radius; whether it gives, takes, has hydrogens that turn, and counts."""
        element, near = self.elements[k], [self.elements[j] for j in self.bonded[k]]
        if element == "H":
            polar = bool({*near} & {"N", "O", "S"})
            parent = self.bonded[k][0] if near else -1
            turns = bool({*near} & {"O", "S"}) or (polar and self.hydrogens(parent) == 3)
            return POLAR if polar else OTHER, polar, False, False, not turns
        if gemmi.Element(element).is_metal:
            return METAL, True, False, False, True
        radius = 1.65 if element == "C" and "O" in near else RADII.get(element, 1.8)
        takes = element in ("O", "S") or (element == "N" and "H" not in near and len(near) == 2)
        turns = (element == "O" and "H" in near) or (element == "N" and self.hydrogens(k) == 3)
        return radius, False, takes, turns, True

    def hydrogens(self, k: int) -> int:
        """Return the number of hydrogens that are bonded to an atom."""
        return sum(self.elements[j] == "H" for j in self.bonded[k])

    def sites(self) -> Iterator[tuple[Site, float]]:
        """Chain and number of each site, and what its score is above that of the other way."""
        s = self.s
        for r, name in enumerate(s.residue_name.tolist()):
            name = "HIS" if name in ("HID", "HIE", "HIP") else name
            own = np.flatnonzero(s.atom_residue == r).tolist()
            at = {self.names[k]: self.x[k] for k in own}
            if name not in ENDS or not {*ENDS[name][:2], *ENDS[name][2]} <= at.keys():
                continue
            if self.is_bonded(own, ENDS[name][2]):
                continue
            start, pivot, ends = ENDS[name]
            axis = unit(at[pivot] - at[start])
            arms = {end: at[end] - at[pivot] for end in ends}
            over = {**at, **{end: at[pivot] + 2 * (arm @ axis) * axis - arm for end, arm in arms.items()}}
            number = f"{s.residue_number[r]}{str(s.residue_insertion_code[r]).strip()}"
            scores = [max(self.score(own, name, its, state) for state in _states(name)) for its in (at, over)]
            yield (str(s.residue_chain[r]).strip(), number), scores[0] - scores[1]

    def is_bonded(self, own: list[int], ends: dict[str, str]) -> bool:
        """Whether one of its ends is bonded to another residue or a metal."""
        for k in own:
            for j in self.tree.query_ball_point(self.x[k], 2.8) if self.names[k] in ends else ():
                far = 2.8 if self.gives[j] and self.elements[j] != "H" else 1.8
                if j not in own and self.elements[j] != "H" and np.linalg.norm(self.x[j] - self.x[k]) < far:
                    return True
        return False

    def score(self, own: list[int], name: str, at: dict[str, np.ndarray], state: tuple[str, ...]) -> float:
        """Return the contact score of a side chain in one orientation."""
        _, pivot, ends = ENDS[name]
        spheres = list(_spheres(name, at, state))
        near = [k for k in self.tree.query_ball_point(at[pivot], 8.0) if k not in own and self.counts[k]]
        # Atoms of the backbone and of the stem cover dots, but are no contacts.
        stem = [at[each] for each in ("CA", "CB", "CG", "CD") if each in at and each not in ends]
        total = 0.0
        for m, (x, radius, gives, takes) in enumerate(spheres):
            dots = x + radius * _sphere(radius)
            covers = [(each, r) for k, (each, r, *_) in enumerate(spheres) if k != m]
            for each, r in (*covers, *((each, 1.6) for each in stem)):
                if np.linalg.norm(each - x) < 2.7:
                    dots = dots[np.linalg.norm(dots - each, axis=1) > r]
            if not len(dots) or not near:
                continue
            centres, radii = self.x[near].copy(), self.radius[near].copy()
            turned = self.turns[near] & takes
            way = x - centres[turned]
            centres[turned] += way / np.linalg.norm(way, axis=1)[:, None]
            radii[turned] = POLAR
            gaps = np.linalg.norm(dots[:, None] - centres, axis=2) - radii
            nearest = np.argmin(gaps, axis=1)
            gap = gaps[np.arange(len(dots)), nearest]
            bond = ((gives & self.takes[near]) | (takes & (self.gives[near] | turned)))[nearest]
            depth = np.maximum(-gap, 0.0)
            within = np.where(bond, np.minimum(depth, DEEPEST), 0.0)
            overlap = BOND * within - BUMP * (depth - within)
            total += float(np.where(gap > 0, np.exp(-((gap / WIDTH) ** 2)), overlap)[gap < REACH].sum())
        return total / DENSITY


def _sphere(radius: float) -> np.ndarray:
    """Evenly spread points of a unit sphere."""
    n = round(4.0 * np.pi * radius**2 * DENSITY)
    k = np.arange(n) + 0.5
    z, turn = 1.0 - 2.0 * k / n, np.pi * (1.0 + np.sqrt(5.0)) * k
    return np.stack([np.sqrt(1.0 - z**2) * np.cos(turn), np.sqrt(1.0 - z**2) * np.sin(turn), z], axis=1)


def _states(name: str) -> tuple[tuple[str, ...], ...]:
    """Nitrogens of a ring that have a hydrogen."""
    return (("ND1",), ("NE2",), ("ND1", "NE2")) if name == "HIS" else ((),)


def _spheres(
    name: str, at: dict[str, np.ndarray], state: tuple[str, ...]
) -> Iterator[tuple[np.ndarray, float, bool, bool]]:
    """Place, radius, and whether it gives and takes, of each atom beyond the axis."""
    start, pivot, ends = ENDS[name]
    if name != "HIS":
        oxygen, nitrogen = ends
        yield at[oxygen], RADII["O"], False, True
        yield at[nitrogen], RADII["N"], False, False
        out = unit(at[nitrogen] - at[pivot])
        aside = at[start] - at[pivot]
        aside = unit(aside - (aside @ out) * out)
        for sign in (1.0, -1.0):
            yield at[nitrogen] + 1.01 * (0.5 * out + sign * np.sqrt(0.75) * aside), POLAR, True, False
        return
    for end, (one, other) in RING.items():
        is_carbon = end[0] == "C"
        yield at[end], RADII[end[0]], False, not is_carbon and end not in state
        if is_carbon or end in state:
            out = unit(2 * at[end] - at[one] - at[other])
            yield at[end] + (1.08 if is_carbon else 1.01) * out, POLAR, not is_carbon, False


def load(structure: gemmi.Structure, name: str) -> tuple[pc.Structure, set[Site]]:
    """A prepared structure, and what was turned in it."""
    s = pc.as_structure(structure, name)
    turned = [r.facts["residue"] for r in s.repairs if r.kind.name in ("AMIDE_TURNED", "RING_TURNED")]
    return s, {(r.chain, r.number) for r in turned}


def shuffled(structure: gemmi.Structure, name: str, sites: set[Site]) -> tuple[gemmi.Structure, set[Site]]:
    """A copy in which sites are turned at random, and those that are."""
    draw, copy, flipped = random.Random(f"{name} {SEED}"), structure.clone(), set()
    for chain in copy[0]:
        for residue in chain:
            site = chain.name.strip(), str(residue.seqid).strip()
            if site not in sites or residue.name not in ENDS or draw.random() < 0.5:
                continue
            flipped.add(site)
            for atom in residue:
                atom.name = ENDS[residue.name][2].get(atom.name, atom.name)
                if atom.name in ENDS[residue.name][2]:
                    atom.element = gemmi.Element(atom.name[0])
    return copy, flipped


def measured(options: argparse.Namespace, name: str, half: str) -> dict[str, object]:
    """The row of a structure."""
    structure = read(place(options, name))
    structure.remove_hydrogens()
    code = Path(name).name[:4].lower()
    s, turned = load(structure, code)
    above = {site: -gain if site in turned else gain for site, gain in Contacts(s).sites()}
    copy, flipped = shuffled(structure, code, {*above})
    _, again = load(copy, code)
    back, deciding = {*above} - (flipped ^ again), {site for site, gain in above.items() if gain >= CLEAR}
    return {
        "structure": code, "half": half, "sites": len(above), "put_back": len(back),
        "deciding": len(deciding), "deciding_put_back": len(deciding & back), "turned": len(turned),
        "wrongly_turned": len(turned & deciding),
    }  # fmt: skip


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command."""
    return made.parser(__doc__ or "", more=True)


def main() -> None:
    options = parser().parse_args()
    halves = {name: ("chosen", "held out")[k % 2] for k, name in enumerate(STRUCTURES)}
    names = QUICK if options.quick else STRUCTURES
    rows = pd.DataFrame([measured(options, name, halves[name]) for name in names])
    totals = rows.drop(columns="structure").groupby("half", sort=False).sum().reset_index()
    table = pd.concat([rows, totals.assign(structure="all")], ignore_index=True)
    table["percent"] = (100.0 * table["deciding_put_back"] / table["deciding"]).round(1)
    print(made.markdown(table))
    if options.output:
        made.write(table, options.output / "flips.csv", [place(options, name) for name in names])


if __name__ == "__main__":
    main()
