"""What becomes of a file: read, prepared, relaxed a little, written as PDB and mmCIF, read again.

All is measured by places in space against what the file means (a gemmi structure), and by what gemmi reads in
the files written, not by what protochain says; what it says stands beside it.
"""

import contextlib
import io
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import gemmi
import numpy as np
from scipy.spatial import KDTree

import protochain as pc
from protochain.cli.relaxing import print_relaxed
from protochain.relaxation.chirality_restraint import Hands
from protochain.validation.omega import omegas

PLACE = 0.01
"""Angstrom: an atom of the file is there if an atom of its element lies this near its place."""
LARGEST = 3000
"""Atoms of which more are only prepared, written and read again."""
_STATED = 3.3
"""Angstrom: bonds that the file states are expected up to this length."""
_STRETCH = 1.3
"""A bond that no file states has at most this share of the sum of the covalent radii."""
_OF_CHAINS = ({"C", "N"}, {"O3'", "P"}, {"SG"})
"""Bonds between residues that chains and disulfides have, at whatever distance the file has them."""
_TURNED = 5.0
"""Degrees: a peptide that turns by less, across a limit, is as it was."""
Place = tuple[str, str, str, str]
"""Chain, number, residue and atom."""


@dataclass(frozen=True)
class Fate:
    """What became of one file.

    Parameters
    ----------
    refusal : str
        The line, if it was refused; nothing else is known then.
    status : str
    said, changes : tuple of str
        Last lines of the command, after its table; summary of what was changed to prepare the file.
    left_out : mapping of str to int
        ``Structure.left_out``.
    lost : tuple of Place
        Heavy atoms of the file, waters left out, that are in no place of the prepared structure.
    unsaid : tuple of Place
        Those of which nothing is said.
    renamed : mapping of str to str
        Residues whose names changed, and how many atoms of others, as counts.
    added_heavy, added_hydrogens, lost_hydrogens, moved : int
        Atoms. Moved: there under the same name, at another place.
    residues, atoms, molecules : pair of int
        In the file and in the result; molecules beside the protein, without waters.
    charge : triple of int
        Formal charges that the file gives to molecules beside the protein: in the file, and in the PDB and
        the mmCIF file written.
    links, metal : tuple of pairs of Place
        Bonds between residues that are no peptide, disulfide or phosphate bond; those to a metal.
    strange : tuple of str
        Links that nothing states and that cannot be: overlong, or with valences exceeded.
    unmade : tuple of str
        Bonds that the file states between atoms that are there, but which were not made.
    hands : tuple of str
        C-alphas whose hand changed in preparation or relaxation.
    cis, twisted : pair of int
        Peptides in the file and in the result.
    turned : tuple of str
        Peptides that became cis or twisted.
    ids : tuple of str
        Residues of the protein that are missing, or under other ids, in the files written.
    energy : Mapping of str to (float, float)
        By format: of the result at the places written, and of the file read again; kJ/mol.
    stated : float
        Energy in the record, kJ/mol.
    again : mapping of str to str
        By format: what differs when the file is read again; empty if nothing does.
    drift : float
        Largest way of a metal, angstrom.
    """

    refusal: str = ""
    status: str = ""
    said: tuple[str, ...] = ()
    changes: tuple[str, ...] = ()
    left_out: Mapping[str, int] = field(default_factory=dict)
    lost: tuple[Place, ...] = ()
    unsaid: tuple[Place, ...] = ()
    renamed: Mapping[str, int] = field(default_factory=dict)
    added_heavy: int = 0
    added_hydrogens: int = 0
    lost_hydrogens: int = 0
    moved: int = 0
    residues: tuple[int, int] = (0, 0)
    atoms: tuple[int, int] = (0, 0)
    molecules: tuple[int, int] = (0, 0)
    charge: tuple[int, int, int] = (0, 0, 0)
    links: tuple[tuple[Place, Place], ...] = ()
    metal: tuple[tuple[Place, Place], ...] = ()
    strange: tuple[str, ...] = ()
    unmade: tuple[str, ...] = ()
    hands: tuple[str, ...] = ()
    cis: tuple[int, int] = (0, 0)
    twisted: tuple[int, int] = (0, 0)
    turned: tuple[str, ...] = ()
    ids: tuple[str, ...] = ()
    energy: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    stated: float = 0.0
    again: Mapping[str, str] = field(default_factory=dict)
    drift: float = 0.0


def fate(
    path: Path, meant: gemmi.Structure, iterations: int = 100, options: Mapping[str, Any] | None = None
) -> Fate:
    """Follow a file; see Fate."""
    try:
        prepared = pc.load(path, **dict(options or {}))
    except pc.ProtochainError as error:
        return Fate(refusal=str(error), status="refused")
    small = prepared.n_atoms <= LARGEST
    result: Any = None
    said: list[str] = []
    if small:
        try:
            result = pc.relax(prepared, threads=1, max_iterations=iterations, max_outer_iterations=1)
        except pc.ProtochainError as error:
            return Fate(refusal=str(error), status="refused by the energy")
        said = _said(result, path)
    end = result.structure if result else prepared
    source = Meant(meant, prepared)
    lost = source.lost()
    out: dict[str, Any] = {}
    energies: dict[str, tuple[float, float]] = {}
    charge = []
    for suffix in (".pdb", ".cif"):
        target = path.with_name(f"{path.name.split('.')[0]}.out{suffix}")
        differs, energy = _again(result or prepared, end, target, options or {}, small)
        out[suffix] = differs
        if energy:
            energies[suffix] = energy
        charge.append(source.charge(target))
    hands = source.hands(prepared, end)
    cis, twisted, turned = source.peptides(end)
    return Fate(
        status=str(result.status) if result else "prepared",
        said=tuple(said),
        changes=prepared.changes,
        left_out=dict(prepared.left_out),
        lost=tuple(lost),
        unsaid=tuple(source.unsaid()),
        renamed=source.renamed(),
        added_heavy=source.added(False),
        added_hydrogens=source.added(True),
        lost_hydrogens=source.lost_hydrogens(),
        moved=source.moved(),
        residues=source.counts()[0],
        atoms=source.counts()[1],
        molecules=source.counts()[2],
        charge=(source.charge(), *charge),
        links=tuple(pair for pair, is_metal in _links(prepared) if not is_metal),
        metal=tuple(pair for pair, is_metal in _links(prepared) if is_metal),
        strange=tuple(source.strange()),
        unmade=tuple(source.unmade()),
        hands=tuple(hands),
        cis=cis, twisted=twisted, turned=tuple(turned),
        ids=tuple(source.ids(path)),
        energy=energies,
        stated=result.energy_end if result else 0.0,
        again=out,
        drift=_drift(prepared, end),
    )  # fmt: skip


def _said(result: Any, path: Path) -> list[str]:
    told = io.StringIO()
    with contextlib.redirect_stdout(told):
        print_relaxed(result, result.record() | {"output": "out"})
    lines = told.getvalue().splitlines()
    first = next((k for k, line in enumerate(lines) if line.startswith("C-alpha RMSD")), 0)
    return [line for line in lines[first:] if not line.startswith("written")]


def _again(
    result: Any, end: pc.Structure, target: Path, options: Mapping[str, Any], energies: bool
) -> tuple[str, tuple[float, float] | None]:
    """What differs in a file read again, and energies of the places written and of the file."""
    try:
        if result is end:
            pc.save(end, target)
        else:
            result.save(target)
    except pc.ProtochainError as error:
        fits = target.suffix == ".cif" or _fits_pdb(end)
        return f"not written: {error}" if fits else "", None
    try:
        found = pc.load(target, **{**options, "keep": "all"})
    except pc.ProtochainError as error:
        return f"refused: {error}", None
    differs = []
    if found.n_atoms != end.n_atoms:
        return f"{end.n_atoms} atoms became {found.n_atoms}", None
    for name in (
        "atom_name",
        "atom_element",
        "residue_name",
        "residue_number",
        "residue_insertion_code",
        "residue_chain",
    ):
        if (getattr(found, name) != getattr(end, name)).any():
            k = int(np.flatnonzero(getattr(found, name) != getattr(end, name))[0])
            differs.append(f"{name} {getattr(end, name)[k]} became {getattr(found, name)[k]}")
    mine, its = ({tuple(b) for b in s.bonds.tolist()} for s in (end, found))
    if mine != its:
        differs.append(f"{len(mine - its)} bonds lost, {len(its - mine)} new")
    if (found.formal_charge != end.formal_charge).any():
        differs.append(
            f"formal charges {int(end.formal_charge.sum())} became {int(found.formal_charge.sum())}"
        )
    if (found.obstacle != end.obstacle).any():
        differs.append("what stands still differs")
    away = 10 * float(np.abs(found.positions - end.positions).max())
    if away > 0.0006:
        differs.append(f"an atom {away:.3f} angstrom away")
    if not energies:
        return "; ".join(differs), None
    try:
        here = float(pc.energy(end, threads=1)(found.positions)[0])
        there = float(pc.energy(found, threads=1)(found.positions)[0])
    except pc.ProtochainError as error:
        return "; ".join([*differs, f"no energy: {error}"]), None
    return "; ".join(differs), (here, there)


def _fits_pdb(s: pc.Structure) -> bool:
    """Whether all names and ids fit the columns of a PDB file."""
    return all(
        len(str(name)) <= most
        for names, most in (
            (s.atom_name, 4),
            (s.residue_name, 3),
            (s.residue_chain, 1),
            (s.residue_number, 4),
        )
        for name in names
    )


def _links(s: pc.Structure) -> Iterator[tuple[tuple[Place, Place], bool]]:
    for a, b in s.bonds.tolist():
        r, t = int(s.atom_residue[a]), int(s.atom_residue[b])
        names = {str(s.atom_name[a]), str(s.atom_name[b])}
        same_part = s.residue_chain_index[r] == s.residue_chain_index[t]
        if r == t or names == {"SG"} or (same_part and names in ({"C", "N"}, {"O3'", "P"})):
            continue
        is_metal = any(gemmi.Element(str(s.atom_element[k])).is_metal for k in (a, b))
        yield (_place(s, a), _place(s, b)), is_metal


def _place(s: pc.Structure, k: int) -> Place:
    r = int(s.atom_residue[k])
    number = f"{s.residue_number[r]}{s.residue_insertion_code[r]}"
    return str(s.residue_chain[r]), number, str(s.residue_name[r]), str(s.atom_name[k])


def _drift(start: pc.Structure, end: pc.Structure) -> float:
    metal = np.array([gemmi.Element(e).is_metal for e in start.atom_element])
    if not metal.any():
        return 0.0
    return float(10 * np.linalg.norm(end.positions - start.positions, axis=1)[metal].max())


def _hand(atoms: Mapping[str, Any]) -> int:
    if not {"N", "CA", "C", "CB"} <= atoms.keys():
        return 0
    n, ca, c, cb = (np.array(atoms[k]) for k in ("N", "CA", "C", "CB"))
    value = float((n - ca) @ np.cross(c - ca, cb - ca))
    return 0 if abs(value) < 0.5 else int(np.sign(value))


class Meant:
    """What a file means, beside the structure that was prepared from it."""

    def __init__(self, meant: gemmi.Structure, prepared: pc.Structure) -> None:
        self.meant, self.prepared = meant, prepared
        self.atoms: list[tuple[Place, gemmi.Atom]] = []
        self.owner: list[tuple[int, str]] = []
        number = prepared.model_number
        model = next((m for m in meant if m.num == number), meant[0])
        for k, chain in enumerate(model):
            for r in chain:
                for a in r:
                    self.atoms.append(((chain.name.strip(), str(r.seqid).strip(), r.name, a.name), a))
                    self.owner.append((k, str(r.seqid)))
        self.water = {p[:3] for p, _ in self.atoms if _is_water(p[2])}
        x = 10 * prepared.positions
        self.tree = KDTree(x)
        at = np.array([a.pos.tolist() for _, a in self.atoms])
        distance, nearest = self.tree.query(at)
        self.found = np.where(distance <= PLACE, nearest, -1)
        # Atoms in one place, of two chains: their names decide.
        for i, near in enumerate(self.tree.query_ball_point(at, PLACE)):
            if len(near) > 1:
                same = [k for k in near if _place(prepared, k)[:2] == self.atoms[i][0][:2]]
                same = (
                    [k for k in same or near if prepared.atom_name[k] == self.atoms[i][0][3]] or same or near
                )
                self.found[i] = same[0]

    def lost(self) -> list[Place]:
        """Heavy atoms without a place; one of several locations is enough."""
        rows = list(zip(self.atoms, self.owner, self.found, strict=True))
        kept = {(owner, p[3]) for (p, _), owner, k in rows if k >= 0}
        alternate = {owner for (_, a), owner, _ in rows if a.has_altloc()}
        chosen = {(owner, p[2]) for (p, _), owner, k in rows if k >= 0}
        out: dict[Place, None] = {}
        for (p, a), owner, k in rows:
            if a.is_hydrogen() or p[:3] in self.water or k >= 0 or (owner, p[3]) in kept:
                continue
            # Atoms of another residue in the same place, or of a location that was not chosen.
            of_another = owner in alternate and any(o == owner for o, _ in chosen) and a.has_altloc()
            if not of_another:
                out[p] = None
        return list(out)

    def unsaid(self) -> list[Place]:
        """Lost atoms that are not among the losses of the structure, nor left out by number and kind."""
        s = self.prepared
        told = {(loss.chain, loss.number, atom.upper()) for loss in s.losses for atom in loss.atoms}
        left_out = {kind.upper() for kind in s.left_out}
        lost = self.lost()
        return [p for p in lost if (*p[:2], p[3].upper()) not in told and p[2].upper() not in left_out]

    def lost_hydrogens(self) -> int:
        kept = {p for (p, _), k in zip(self.atoms, self.found, strict=True) if k >= 0}
        gone = {p for p, a in self.atoms if a.is_hydrogen() and p[:3] not in self.water and p not in kept}
        return len(gone)

    def renamed(self) -> dict[str, int]:
        """Residues under other names, and atoms under other names, with how many."""
        s, out = self.prepared, Counter[str]()
        seen = set()
        for (p, a), k in zip(self.atoms, self.found, strict=True):
            if k < 0:
                continue
            now = _place(s, int(k))
            if now[2] != p[2] and p[:3] not in seen:
                seen.add(p[:3])
                out[f"{p[2]} to {now[2]}"] += 1
            if now[3] != p[3]:
                out["hydrogens" if a.is_hydrogen() else "atoms"] += 1
            if a.element.name == "Se" != s.atom_element[k]:
                out[f"element {a.element.name} to {s.atom_element[k]}"] += 1
        return dict(out)

    def added(self, hydrogens: bool) -> int:
        is_hydrogen = self.prepared.atom_element == "H"
        new = np.setdiff1d(np.arange(self.prepared.n_atoms), self.found)
        return int((is_hydrogen[new] == hydrogens).sum()) - (0 if hydrogens else self.moved())

    def moved(self) -> int:
        """Heavy atoms of the file that are there under their name, at another place."""
        at = {_place(self.prepared, k) for k in range(self.prepared.n_atoms)}
        lost = self.lost()
        return sum(p in at for p in lost)

    def counts(self) -> tuple[tuple[int, int], tuple[int, int], tuple[int, int]]:
        """Residues, heavy atoms and molecules, in the file and as prepared; waters left out."""
        s = self.prepared
        dry = [(p, a) for p, a in self.atoms if p[:3] not in self.water and not a.is_hydrogen()]
        given = {p[:3] for p, _ in dry}
        water = np.isin(s.residue_name, ["HOH"])
        protein = set(s.atom_residue[~s.kept].tolist())
        beside = len([r for r in range(s.n_residues) if r not in protein and not water[r]])
        n = int(((s.atom_element != "H") & ~water[s.atom_residue]).sum())
        its = {p for p in given if not _is_amino(p[2])}
        return (len(given), int((~water).sum())), (len({p for p, _ in dry}), n), (len(its), beside)

    def charge(self, written: Path | None = None) -> int:
        """Formal charges that the file gives to atoms beside the protein, there or in a file written."""
        kept = set(np.flatnonzero(self.prepared.kept).tolist())
        rows = zip(self.atoms, self.found.tolist(), strict=True)
        given = {_place(self.prepared, k): a.charge for (_, a), k in rows if k in kept and a.charge}
        if written is None or not written.exists():
            return sum(given.values())
        charges = {}
        for at in gemmi.read_structure(str(written))[0].all():
            place = (at.chain.name.strip(), str(at.residue.seqid).strip(), at.residue.name, at.atom.name)
            charges[place] = at.atom.charge
        return sum(charges.get(place, 0) for place in given)

    def stated(self) -> set[frozenset[tuple[str, str, str]]]:
        ends = [
            (c.partner1, c.partner2) for c in self.meant.connections if c.type != gemmi.ConnectionType.Hydrog
        ]
        return {
            frozenset((e.chain_name.strip(), str(e.res_id.seqid).strip(), e.atom_name) for e in pair)
            for pair in ends
        }

    def strange(self) -> Iterator[str]:
        """Links that no file states and that chemistry does not know, in words."""
        s, stated = self.prepared, self.stated()
        degree = Counter(k for b in s.bonds.tolist() for k in b)
        most = {"C": 4, "N": 4, "O": 2, "S": 4, "P": 5}
        radius = {e: gemmi.Element(e).covalent_r for e in set(s.atom_element)}
        for a, b in s.bonds.tolist():
            elements = str(s.atom_element[a]), str(s.atom_element[b])
            p, q = _place(s, a), _place(s, b)
            if p[:3] == q[:3] or frozenset(((*p[:2], p[3]), (*q[:2], q[3]))) in stated:
                continue
            if any(gemmi.Element(e).is_metal for e in elements) or {p[3], q[3]} in _OF_CHAINS:
                continue
            far = 10 * float(np.linalg.norm(s.positions[a] - s.positions[b]))
            over = [k for k in (a, b) if degree[k] > most.get(str(s.atom_element[k]), 9)]
            usual = radius[elements[0]] + radius[elements[1]]
            if over or far > _STRETCH * usual or far < 0.75 * usual:
                yield f"{'-'.join(map(_word, (p, q)))} {far:.2f}"

    def unmade(self) -> Iterator[str]:
        s = self.prepared
        at = {(p[0], p[1], p[3]): k for k in range(s.n_atoms) for p in [_place(s, k)]}
        made = {frozenset(b) for b in s.bonds.tolist()}
        for pair in self.stated():
            ends = [at[e] for e in pair if e in at]
            if len(ends) == 2 and frozenset(ends) not in made and not s.kept[ends].all():
                far = 10 * float(np.linalg.norm(s.positions[ends[0]] - s.positions[ends[1]]))
                if far < _STATED:
                    yield f"{'-'.join(_word(_place(s, k)) for k in ends)} {far:.2f}"

    def backbones(self) -> dict[tuple[str, str], dict[str, list[float]]]:
        out: dict[tuple[str, str], dict[str, list[float]]] = {}
        for p, a in self.atoms:
            if p[:3] not in self.water and p[3] in ("N", "CA", "C", "CB", "O"):
                out.setdefault(p[:2], {}).setdefault(p[3], a.pos.tolist())
        return out

    def hands(self, prepared: pc.Structure, end: pc.Structure) -> Iterator[str]:
        """Residues whose C-alpha has another hand, unless it was the wrong one."""
        given = self.backbones()
        wrong = {_place(prepared, int(k))[:2] for k in Hands.of(prepared).wrong(prepared.positions)}
        for s in (prepared, end):
            mine: dict[tuple[str, str], dict[str, Any]] = {}
            for k in np.flatnonzero(np.isin(s.atom_name, ["N", "CA", "C", "CB"])).tolist():
                p = _place(s, k)
                mine.setdefault(p[:2], {})[p[3]] = 10 * s.positions[k]
            for place, atoms in given.items():
                if place in mine and place not in wrong and _hand(atoms) * _hand(mine[place]) < 0:
                    yield f"{place[0]}:{place[1]}{' relaxed' if s is end else ''}"

    def peptides(self, end: pc.Structure) -> tuple[tuple[int, int], tuple[int, int], list[str]]:
        """Cis and twisted peptides in the file and at the end, and those that became so."""
        first, last = omegas(self.prepared), omegas(end)
        new = [
            f"{_word(_place(end, int(np.flatnonzero(end.atom_residue == r)[0]))[:3])} {a:.0f} to {b:.0f}"
            for r, a, b, c, t, c0, t0 in zip(
                first.residue,
                first.omega,
                last.omega,
                last.cis,
                last.twisted,
                first.cis,
                first.twisted,
                strict=True,
            )
            if ((c and not c0) or (t and not t0)) and abs((b - a + 180) % 360 - 180) > _TURNED
        ]
        return (
            (int(first.cis.sum()), int(last.cis.sum())),
            (int(first.twisted.sum()), int(last.twisted.sum())),
            new,
        )

    def ids(self, path: Path) -> Iterator[str]:
        """Residues of the file that are not in the mmCIF file written under their chain and number."""
        target = path.with_name(f"{path.name.split('.')[0]}.out.cif")
        if not target.exists():
            return
        out = gemmi.read_structure(str(target))
        there = {(c.name.strip(), str(r.seqid).strip()) for c in out[0] for r in c}
        lost = {p[:3] for p in self.lost()}
        for p in dict.fromkeys(p[:3] for p, _ in self.atoms if p[:3] not in self.water):
            if p[:2] not in there and p not in lost:
                yield "/".join(p)


def _word(place: tuple[str, ...]) -> str:
    return "/".join(place)


def _is_water(name: str) -> bool:
    info = gemmi.find_tabulated_residue(name)
    return info.is_water() or name in ("WAT", "TIP3", "SOL", "TIP", "T3P", "DOD")


def _is_amino(name: str) -> bool:
    return gemmi.find_tabulated_residue(name).is_amino_acid()


def faults(found: Fate, name: str, refused: str = "", links: int = 0, keeps: bool = True) -> list[str]:
    """What is wrong with what became of a file.

    Parameters
    ----------
    found : Fate
    name : str
        Of the file.
    refused : str
        Word of the refusal that is expected; empty for none.
    links : int
        Bonds to molecules beside the protein that are expected, those of metals left out; any number below 0.
    keeps : bool
        Whether all heavy atoms are expected to stay.
    """
    if refused or found.refusal:
        line = found.refusal
        if not refused or not line:
            return [f"refused: {line}" if line else "not refused"]
        wrong = [] if refused.lower() in line.lower() else [f"refused for another reason: {line}"]
        return wrong + (
            [] if "\n" not in line and name in line and len(line) < _LINE else [f"no such line: {line}"]
        )
    out = [f"lost and not said: {_word(place)}" for place in found.unsaid]
    left_out = {kind.upper() for kind in found.left_out}
    lost = [place for place in found.lost if place[2].upper() not in left_out]
    if found.said and lost and not any(f"{lost[0][1]} {lost[0][2]}" in line for line in found.said):
        out.append(f"not in the last lines: {_word(lost[0])} is lost")
    out += [f"lost: {_word(place)}" for place in found.lost if keeps]
    if len(found.links) != links and links >= 0:
        out.append(f"{len(found.links)} bonds beside the protein, not {links}: {found.links}")
    out += [
        f"{what}: {each}" for what in ("strange", "unmade", "hands", "ids") for each in getattr(found, what)
    ]
    out += [f"turned and not said: {each}" for each in found.turned if found.status == "converged"]
    out += [f"read again from {suffix}: {differs}" for suffix, differs in found.again.items() if differs]
    for suffix, (here, there) in found.energy.items():
        if abs(here - there) > READ_AGAIN * max(abs(here), 1.0):
            out.append(f"energy of {suffix}: {here:.4f}, read again {there:.4f}")
    if ".cif" in found.energy and abs(found.energy[".cif"][1] - found.stated) > READ_AGAIN * abs(
        found.stated
    ):
        out.append(f"energy stated {found.stated:.4f}, read again {found.energy['.cif'][1]:.4f}")
    if len(set(found.charge)) > 1:
        out.append(f"formal charges {found.charge[0]}, written {found.charge[1:]}")
    if found.drift > DRIFT:
        out.append(f"a metal moved by {found.drift:.2f} angstrom")
    return out


_LINE = 400
"""Characters of the longest line that refuses a file."""
DRIFT = 0.1
"""Angstrom."""
READ_AGAIN = 1e-6
"""Relative. Columns of a PDB file hold an angstrom's third decimal: its energy is that of these places."""
