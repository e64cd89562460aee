"""Missing heavy atoms: the backbone is built between its neighbours, side chains on rotamers."""

from collections.abc import Generator, Sequence

import gemmi
import numpy as np

from protochain.core.arrays import Floats, dihedral
from protochain.structure.molecule import residues
from protochain.structure.molecule.chirality import centres, chirality, inverted_atoms
from protochain.structure.molecule.member import Member, atom
from protochain.structure.molecule.repairs import AtomRename, Kind, Reason, Repair
from protochain.structure.molecule.templates import Template, rename
from protochain.structure.preparation.structure_draft import Changes, Draft, Part
from protochain.structure.sidechains.ideal import Places, Site, bridge_gaps, ideal, place_points, unit

_TERMINAL_OXYGENS = {"OXT": ("C", ("CA", "O"), 1.25), "OP3": ("P", ("O5'", "OP1", "OP2"), 1.48)}
"""Terminal oxygens: bonded atom, its other neighbours, and bond length (angstrom) in ff14SB and OL15."""
_CARBONYL, _TRIGONAL = 1.23, float(np.deg2rad(120.4))
"""Angstrom, rad: C=O of a peptide bond, and its angle with CA."""
_MIN_AREA = 0.1  # Angstrom^2: N, CA and C are collinear if the cross product of their bonds is smaller.
_DECIMALS = 4
"""Decimals (angstrom) of the positions: sine and cosine differ in the last bit between libraries."""
_BONDS = {
    ("C-", "N"): 1.336, ("N", "CA"): 1.459, ("CA", "C"): 1.525, ("C", "N+"): 1.336, ("C", "O"): 1.229,
    ("CA", "CB"): 1.532,
}  # fmt: skip
"""Angstrom: Engh, Huber, International Tables for Crystallography F, 18.3 (2001)."""
_ANGLE_DISTANCES = {
    ("CA-", "N"): 2.43, ("O-", "N"): 2.25, ("C-", "CA"): 2.43, ("N", "C"): 2.46, ("N", "CB"): 2.46,
    ("C", "CB"): 2.50, ("CA", "O"): 2.40, ("CA", "N+"): 2.43, ("O", "N+"): 2.25, ("C", "CA+"): 2.43,
}  # fmt: skip
"""Angstrom: distances across an angle, from the same source."""
_TRANS_DISTANCES = {("CA-", "CA"): 3.80, ("CA", "CA+"): 3.80}
"""Angstrom: across a trans peptide bond (cis: 2.9). For one missing atom the other distances suffice."""
_MAX_DEVIATION = 0.25  # Angstrom: largest deviation of a bond of a rebuilt atom.
_N_STARTS = 8


def add_heavy_atoms(draft: Draft) -> Changes:
    """Rename atoms to their PDB names, and build missing heavy atoms. Side chains are ideal rotamers."""
    renamed: list[AtomRename] = []
    open_ended: list[Member] = []
    incomplete: list[tuple[Part, int, list[str]]] = []
    for part in draft.parts:
        for i, member in enumerate(part.members):
            template = part.template(draft.templates, i)
            if template is None:
                where = "" if part.obstacle else " at the end of a chain"
                raise draft.error(f"{member}: the force field has no parameters for it{where}; remove it")
            for before, after in rename(member.atoms, template):
                renamed.append(AtomRename(before, residues.Atom(after, member.residue)))
            yield from _check_heavy_atoms(draft, member, template)
            atom_names = {a.name for a in member.atoms}
            missing = [name for name in template.heavy if name not in atom_names]
            if "OXT" in missing:
                missing.remove("OXT")
                open_ended.append(member)
            if "OP3" in missing:
                missing.remove("OP3")
                if not missing:
                    yield Repair.of(Kind.ATOMS_ADDED, residue=member.residue, atoms=("OP3",))
                    member.atoms.insert(1, _terminal_oxygen(draft, member, "OP3"))
            if missing:
                incomplete.append((part, i, missing))
    if renamed:
        yield Repair.of(Kind.ATOMS_RENAMED, changes=tuple(renamed))
    chain_members = [m for part in draft.parts if not part.obstacle for m in part.members]
    # Residues with their own template are checked there. A D-amino acid's may be its mirror image's.
    if inverted := inverted_atoms([m for m in chain_members if m.template is None or m.is_d]):
        yield Repair.of(Kind.INVERTED_IN_FILE, atoms=tuple(inverted))
    yield from _rebuild(draft, incomplete)
    for member in open_ended:
        yield Repair.of(Kind.OXT_ADDED, residue=member.residue)
        member.atoms.append(_terminal_oxygen(draft, member, "OXT"))


def _check_heavy_atoms(draft: Draft, member: Member, template: Template) -> Changes:
    """Remove a terminal oxygen within a chain. Refuse other heavy atoms that the template lacks."""
    extra = [a.name for a in member.heavy if a.name not in template.element and a.name != "OXT"]
    if extra:
        raise draft.error(f"{member}: atom {extra[0]} does not belong to {member.name}; rename or remove it")
    inner = [] if "OXT" in template.element else [a for a in member.atoms if a.name == "OXT"]
    if inner:
        lost = member.losses(inner, Reason.INNER)
        yield Repair.of(Kind.INNER_OXT, lost, residue=member.residue)
        member.atoms = [a for a in member.atoms if a.name != "OXT"]


def _terminal_oxygen(draft: Draft, member: Member, name: str) -> gemmi.Atom:
    """Build the last oxygen of a carboxylate or a 5' phosphate, opposite to the other neighbours."""
    centre, ends, distance = _TERMINAL_OXYGENS[name]
    at, *near = (np.array(a.pos.tolist()) for label in (centre, *ends) if (a := member.atom(label)))
    arms = np.array(near) - at
    direction = -(arms / np.maximum(np.linalg.norm(arms, axis=1, keepdims=True), 1e-9)).sum(axis=0)
    length = np.linalg.norm(direction)
    if not 1e-3 < length < len(arms) - 1e-3:
        raise draft.error(f"{member}: no place for {name} beside {', '.join(ends)}; correct the coordinates")
    return atom(name, "O", (at + distance * direction / length).tolist(), member.atoms[0].b_iso)


def _rebuild(draft: Draft, incomplete: list[tuple[Part, int, list[str]]]) -> Changes:
    """Build missing heavy atoms: oxygens of the backbone, then all side chains together."""
    for part, i, missing in incomplete:
        member = part.members[i]
        if member.name not in residues.STANDARD:
            raise draft.error(f"{member}: atom {missing[0]} missing; build it, or remove the residue")
        _check_backbone(draft, member)
        yield Repair.of(Kind.ATOMS_ADDED, residue=member.residue, atoms=tuple(missing))
    for part, i, missing in incomplete:
        if "O" in missing:
            _add(part.members[i], {"O": _carbonyl_oxygen(draft, part, i)})
    sites: list[tuple[Site, set[str]]] = []
    for part, i, missing in incomplete:
        if missing != ["O"]:
            sites.append(((yield from _site(part, i)), set(missing)))
    for site, _ in sites:
        places = bridge_gaps(site.member.name, site.heavy_positions)
        _add(site.member, {name: site.sign * x for name, x in places.items()})
    open_ended = [site for site, _ in sites if ideal(site.member.name).x.keys() - site.heavy_positions.keys()]
    if open_ended:
        yield from _pack(draft, open_ended)
    for site, added in sites:
        _check_chirality(draft, site, added)


def _pack(draft: Draft, sites: list[Site]) -> Changes:
    # Imported here because complete structures do not need its kernels.
    from protochain.structure.sidechains.packing import pack

    packing = pack(draft.members, sites)
    if not packing.is_proven:
        yield Repair.of(Kind.NOT_PROVEN)
    for site, places in zip(sites, packing.places, strict=True):
        _add(site.member, places)


def _site(part: Part, i: int) -> Generator[Repair, None, Site]:
    """Return a residue with its neighbours. CB, or else the name, determines the configuration."""
    member = part.members[i]
    sign = chirality(member) or (-1 if member.is_d else 1)
    if not chirality(member) and not member.is_d and _is_misnamed(part, i):
        sign = -1
        yield Repair.of(Kind.BUILT_AS_D, residue=member.residue)
    return Site(member, sign, *part.neighbours(i))


def _is_misnamed(part: Part, i: int) -> bool:
    """Whether phi is positive, and most such residues of the chain are D-amino acids with L names."""
    if _phi(part, i) <= 0.0:
        return False
    named_l = [k for k, member in enumerate(part.members) if not member.is_d and _phi(part, k) > 0.0]
    return sum(chirality(part.members[k]) for k in named_l) < 0


def _phi(part: Part, i: int) -> float:
    """Return the dihedral phi (rad), or zero if an atom is missing."""
    before, _ = part.neighbours(i)
    carbon = before.atom("C") if before else None
    atoms = [carbon, *(part.members[i].atom(name) for name in residues.BACKBONE)]
    positions = [np.array(a.pos.tolist()) for a in atoms if a is not None]
    return float(dihedral(*positions)) if len(positions) == 4 else 0.0


def _check_backbone(draft: Draft, member: Member) -> None:
    """Refuse a backbone with missing or collinear atoms."""
    places = {a.name: np.array(a.pos.tolist()) for a in member.atoms if a.name in residues.BACKBONE}
    for name in residues.BACKBONE:
        if name not in places:  # Conversion to a parent can remove an atom of another element.
            raise draft.error(f"{member}: atom {name} missing; build it, or remove the residue")
    n, alpha, c = (places[name] for name in residues.BACKBONE)
    if np.linalg.norm(np.cross(n - alpha, c - alpha)) < _MIN_AREA:
        raise draft.error(f"{member}: N, CA and C are collinear; correct the coordinates")


def _check_chirality(draft: Draft, site: Site, added: set[str]) -> None:
    """Refuse atoms of the file that give built atoms the wrong chirality."""
    member = site.member
    for centre, neighbours in centres(member.name).items():
        if added & {centre, *neighbours} and chirality(member, centre) == -site.sign:
            raise draft.error(
                f"{member}: its atoms leave no place for those missing at {centre}; "
                "correct the coordinates, or remove its side chain"
            )


def _add(member: Member, places: Places) -> None:
    """Add atoms, and remove the hydrogens of the atoms that get a neighbour."""
    bonds = ideal(member.name).bonds
    parents = {neighbour for name in places for neighbour in bonds[name]}
    heavy = [np.array(a.pos.tolist()) for a in member.heavy]
    names = [a.name for a in member.heavy]
    atoms = []
    for a in member.atoms:
        if a.is_hydrogen():
            distances = np.linalg.norm(np.array(heavy) - a.pos.tolist(), axis=1)
            if names[int(np.argmin(distances))] in parents - {"N", "C"}:
                continue
        atoms.append(a)
    b_iso = float(np.mean([a.b_iso for a in member.atoms]))
    atoms += [atom(name, name[0], np.round(x, _DECIMALS).tolist(), b_iso) for name, x in places.items()]
    order = {name: k for k, name in enumerate(member.order)}
    member.atoms = sorted(atoms, key=lambda a: order.get(a.name, len(order)))


def _carbonyl_oxygen(draft: Draft, part: Part, i: int) -> Floats:
    """Return the position (3,), angstrom, of O: in the peptide plane, or in free space at a C terminus."""
    member = part.members[i]
    at = {a.name: np.array(a.pos.tolist()) for a in member.atoms}
    _, after = part.neighbours(i)
    opposite = after.atom("N") if after else member.atom("OXT")
    if opposite is not None:
        arms = unit(at["CA"] - at["C"]) + unit(np.array(opposite.pos.tolist()) - at["C"])
        return at["C"] - _CARBONYL * unit(arms)
    turns = np.deg2rad(np.arange(0.0, 360.0, 10.0))
    places = place_points(at["N"], at["CA"], at["C"], _CARBONYL, _TRIGONAL, turns)
    others = [a.pos.tolist() for m in draft.members if m is not member for a in m.heavy]
    room = np.linalg.norm(places[:, None] - [*others, at["N"].tolist()], axis=-1).min(axis=1)
    # The other oxygen of the carboxylate will be opposite.
    return places[int(np.argmax(np.round(np.minimum(room, np.roll(room, len(turns) // 2)), 4)))]


def complete_backbone(run: Sequence[Member], i: int) -> tuple[str, ...]:
    """Build the backbone atoms that residue i lacks, if its neighbours determine them. Return their names."""
    member = run[i]
    missing = tuple(name for name in residues.BACKBONE if not member.atom(name))
    if not missing or member.is_cap:
        return ()
    at = {a.name: np.array(a.pos.tolist()) for a in member.atoms}
    for step, mark in ((-1, "-"), (1, "+")):
        if 0 <= i + step < len(run):
            at |= {a.name + mark: np.array(a.pos.tolist()) for a in run[i + step].atoms}
    positions = _solve_positions(missing, at)
    if positions is None:
        return ()
    b_iso = float(np.mean([a.b_iso for a in member.atoms]))
    for name, x in zip(missing, positions, strict=True):
        new_atom = atom(name, name[0], np.round(x, _DECIMALS).tolist(), b_iso)
        member.atoms.insert(residues.BACKBONE.index(name), new_atom)
    return missing


def _solve_positions(missing: Sequence[str], at: dict[str, Floats]) -> Floats | None:
    """Return positions (n, 3) at the usual distances from other atoms, or None if bonds deviate too much."""
    ends = {"N": ("C-", "CA-"), "CA": (), "C": ("N+", "CA+")}
    if not {end for name in missing for end in ends[name]} <= at.keys():
        return None
    usual = _BONDS | _ANGLE_DISTANCES | (_TRANS_DISTANCES if len(missing) > 1 else {})
    pairs = [(pair, d) for pair, d in usual.items() if {*pair} & {*missing} and {*pair} <= {*missing, *at}]
    if len(pairs) <= 3 * len(missing):  # Positions are not determined.
        return None
    weight = np.array([1.0 if pair in _BONDS else 0.5 for pair, _ in pairs])

    from scipy.optimize import least_squares

    def deviations(x: Floats) -> Floats:
        positions = at | dict(zip(missing, x.reshape(-1, 3), strict=True))
        return np.array([np.linalg.norm(positions[a] - positions[b]) - d for (a, b), d in pairs])

    def residuals(x: Floats) -> Floats:
        return np.asarray(weight * deviations(x))

    near = np.mean([at[name] for pair, _ in pairs for name in pair if name in at], axis=0)
    starts = near + np.random.default_rng(0).normal(size=(_N_STARTS, len(missing), 3))
    fits = [least_squares(residuals, start.ravel()) for start in starts]
    best = min(fits, key=lambda fit: float(fit.cost))
    bonds = [abs(error) for error, (pair, _) in zip(deviations(best.x), pairs, strict=True) if pair in _BONDS]
    return np.asarray(best.x.reshape(-1, 3)) if max(bonds) < _MAX_DEVIATION else None
