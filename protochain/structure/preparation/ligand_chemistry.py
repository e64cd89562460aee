"""Ligands that move: chemistry of the molecules kept with the protein, with hydrogens and parameters.

Orders of bonds and charges are never taken from distances. A molecule whose chemistry no source has, or to
which the force field of small molecules has no parameters, stays in place, and its repair says why.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from itertools import count
from pathlib import Path
from string import ascii_lowercase, ascii_uppercase, digits

import gemmi
import numpy as np

from protochain.core.arrays import read_only
from protochain.core.checks import CHARGE_RULES
from protochain.core.errors import ProtochainError, StructureError
from protochain.core.optional_libraries import library
from protochain.core.units import ANGSTROM_PER_NM
from protochain.ligands import Ligand, assign_parameters
from protochain.ligands.dictionary import charges
from protochain.ligands.matching import Placed, copy_names, place_on_model
from protochain.ligands.molecule import Molecule
from protochain.ligands.protonation import Charged, at_metal, at_ph, unsure, with_hydrogens
from protochain.ligands.sources import of_residue
from protochain.structure.formats.ions import oxidation_state
from protochain.structure.molecule.links import Link, is_metal
from protochain.structure.molecule.member import Member, atom
from protochain.structure.molecule.repairs import Kind, Repair
from protochain.structure.molecule.residues import STANDARD
from protochain.structure.molecule.templates import Template
from protochain.structure.preparation.structure_draft import (
    Changes,
    ChargedMolecule,
    Chemistry,
    Draft,
    Evidence,
    Part,
)

_BONDED = 1.5
"""Angstrom: a hydrogen further than this from every heavy atom of its residue is not taken."""
_DECIMALS = 5
"""Of angstrom: libraries differ in the last bits."""


def with_pose(chemistry: Chemistry, path: str, chains: set[str], names: set[str]) -> tuple[Chemistry, Member]:
    """Return the molecule of a file as a residue outside the protein, and the chemistry with it."""
    given = of_residue("", source=Path(path))
    if given.positions is None:
        raise StructureError(f"{path}: has no coordinates in space; dock it first")
    molecule, charged = _charged(chemistry, given, is_given=True)
    assert molecule.positions is not None
    name = next(each for k in count() if (each := f"L{k:02d}" if k else "LIG") not in names)
    chain = next((each for each in ascii_uppercase + ascii_lowercase + digits if each not in chains), "Z")
    atoms = []
    for called, z, charge, x in zip(
        molecule.names, molecule.elements, molecule.formal_charges, molecule.positions, strict=True
    ):
        atoms.append(atom(called, gemmi.Element(int(z)).name, (x * ANGSTROM_PER_NM).tolist()))
        atoms[-1].charge = int(charge)
    posed = {**chemistry.posed, name: (molecule, charged)}
    return replace(chemistry, posed=posed), Member(name, "1", "", chain, atoms, raw_name=name)


class LigandChemistry:
    """Gives molecules of a draft their chemistry; those of one name share what is looked up."""

    def __init__(self, draft: Draft) -> None:
        self.draft, self.chemistry, self.templates = draft, draft.reading.chemistry, draft.templates
        self.known: dict[str, ChargedMolecule] = dict(self.chemistry.posed)
        self.made: dict[tuple[object, ...], Ligand] = {}

    @cached_property
    def metals(self) -> list[tuple[Member, gemmi.Atom]]:
        """Metals of the draft."""
        return [(m, a) for m in self.draft.members for a in m.atoms if is_metal(a.element.name)]

    def settle(self, part: Part) -> Changes:
        """Let a molecule move if its chemistry is known; a repair says why one is not."""
        (member,) = part.members
        name = member.raw_name or member.name
        try:
            library("rdkit.Chem")
            molecule, charged = self._looked_up(name, member)
            at = _placed(molecule, member, by_name=name not in self.chemistry.user_sources)
            called = dict(zip(molecule.names, at.molecule.names, strict=True))
            charged = tuple(replace(each, atom=called[each.atom]) for each in charged)
            molecule = _as_shown(at.molecule, member)
            shows_charges = any(a.is_hydrogen() for a in member.atoms)
            if name in self.chemistry.posed or not shows_charges:
                molecule, charged = self._at_metals(molecule, charged, member)
            molecule = _as_filed(molecule, member)
            # What the file's hydrogens show, the pH has not done.
            now = dict(zip(molecule.names, molecule.formal_charges.tolist(), strict=True))
            charged = tuple(each for each in charged if each.after == now[each.atom])
            part.ligand = self._parametrised(molecule, charged)
            if not shows_charges and _depends_on_ph(
                self._of_source(member), name in self.chemistry.user_sources
            ):
                part.ligand = replace(part.ligand, unsure=unsure(molecule, self.chemistry.ph))
        except ProtochainError as error:
            # What the user gives is not left aside.
            if name in self.chemistry.moving or self.chemistry.charges not in CHARGE_RULES:
                raise StructureError(f"{self.draft.source}: {member}: ", *error.parts) from None
            yield Repair.of(Kind.STAYS_UNKNOWN, residue=member.residue, why=error)
            yield from self._charge_as_known(name, member)
            return
        part.inverted, part.posed = at.inverted, name in self.chemistry.posed
        part.evidence = Evidence.CHEMISTRY

    def _charge_as_known(self, name: str, member: Member) -> Changes:
        """Give an inorganic ion that stays in place the dictionary's charges, unless the file has charges."""
        known = {} if any(a.charge or a.element.name == "C" for a in member.atoms) else charges(name)
        for each in member.atoms:
            each.charge = known.get(each.name, 0) or each.charge
        if total := sum(each.charge for each in member.atoms if each.name in known):
            yield Repair.of(Kind.CHARGES_OF_DICTIONARY, residue=member.residue, charge=f"{total:+d}")

    def _parametrised(self, molecule: Molecule, charged: tuple[Charged, ...]) -> Ligand:
        """The molecule with its parameters, which copies of it share."""
        of = vars(replace(molecule, positions=None, source="")).values()
        alike = tuple(its.tobytes() if isinstance(its, np.ndarray) else its for its in of)
        if alike not in self.made:
            self.made[alike] = assign_parameters(molecule, self.chemistry.charges)
        return replace(self.made[alike], molecule=molecule, charged=charged)

    def _at_metals(self, molecule: Molecule, charged: tuple[Charged, ...], member: Member) -> ChargedMolecule:
        """The molecule without the protons that metals displace; their places are left out of the residue."""
        metals = [metal for metal in self.metals if metal[0] is not member]
        holding = {a.name for a in member.atoms if any(Link(member, a, *m).is_coordinated for m in metals)}
        released, more = at_metal(molecule, [k for k, name in enumerate(molecule.names) if name in holding])
        member.atoms = [a for a in member.atoms if not a.is_hydrogen() or a.name in released.names]
        before = {each.atom: each.before for each in charged}
        more = tuple(replace(each, before=before.get(each.atom, each.before)) for each in more)
        changed = {each.atom: each for each in (*charged, *more)}.values()
        return released, tuple(each for each in changed if each.before != each.after)

    def name(self, member: Member) -> str:
        """Name by which the chemistry of a residue is looked up."""
        return member.name if member.name in STANDARD else member.raw_name or member.name

    def free(self, member: Member) -> Molecule:
        """Chemistry of a residue as its source has it, under the names of its atoms in the file."""
        found = self._of_source(member)
        atoms = _atoms_of(found, member)
        names, is_given = tuple(a.name for a in atoms), self.name(member) in self.chemistry.moving
        if not is_given and {*names} <= {*found.names}:
            return found
        x = np.array([a.pos.tolist() for a in atoms]) / ANGSTROM_PER_NM
        try:
            return copy_names(found, [a.element.atomic_number for a in atoms], names, x)
        except ProtochainError:
            if is_given:
                raise
            return found

    def _of_source(self, member: Member) -> Molecule:
        name = self.name(member)
        atoms = {a.name: (a.element.name, int(a.charge)) for a in member.atoms}
        return of_residue(name, self.draft.header, atoms, self.chemistry.user_sources.get(name))

    def _looked_up(self, name: str, member: Member) -> ChargedMolecule:
        """Chemistry of a residue by name, charged for the pH."""
        if name not in self.known:
            free, is_given = self._of_source(member), name in self.chemistry.user_sources
            self.known[name] = _charged(self.chemistry, free, is_given, inner_donors(member))
        return self.known[name]


def _charged(
    chemistry: Chemistry, molecule: Molecule, is_given: bool, donors: Collection[str] = ()
) -> ChargedMolecule:
    """Charge a molecule for the pH, unless its source shows its charges, as of SO4."""
    by_ph = _depends_on_ph(molecule, is_given)
    return at_ph(molecule, chemistry.ph, donors) if by_ph else (molecule, ())


def _depends_on_ph(molecule: Molecule, given: bool) -> bool:
    """Whether the pH decides the charges of a molecule: not of SO4, nor if a user gives charges."""
    # A nitro group or an oxide, whose two charges are neighbours, says nothing of acids and bases.
    shown = {*np.flatnonzero(molecule.formal_charges).tolist()}
    pairs = (pair for pair in molecule.bonds.tolist() if not molecule.formal_charges[pair].sum())
    shown -= {atom for pair in pairs if {*pair} <= shown for atom in pair}
    return bool(np.isin(molecule.elements, (6, 15)).any()) and not (given and shown)


def inner_donors(member: Member) -> set[str]:
    """Names of the atoms of a residue that hold a metal of the same residue."""
    metals = [(member, a) for a in member.heavy if is_metal(a.element.name)]
    return {a.name for a in member.heavy if any(Link(member, a, *metal).is_coordinated for metal in metals)}


def report_metals(member: Member, metals: Sequence[gemmi.Atom]) -> Changes:
    """Report metals whose bonds are springs."""
    if metals:
        atoms = tuple(f"{a.name} {a.charge:+d}" for a in metals)
        yield Repair.of(Kind.COMPLEX, residue=member.residue, atoms=atoms)


def charged_metals(member: Member, name: str, names: Collection[str]) -> list[gemmi.Atom]:
    """Metals of a residue beside its molecule, with their oxidation states unless the file has charges."""
    metals = [a for a in member.heavy if a.element.is_metal and a.name not in names]
    for a in metals:
        a.charge = a.charge or oxidation_state(name, a.element.name)
    return metals


def _placed(molecule: Molecule, member: Member, by_name: bool) -> Placed:
    """The molecule where the file has it."""
    atoms = _atoms_of(molecule, member)
    there = _hydrogens(member)
    n = [len(there[a.name]) for a in atoms]
    names, x = tuple(a.name for a in atoms), np.array([a.pos.tolist() for a in atoms]) / ANGSTROM_PER_NM
    elements = [a.element.atomic_number for a in atoms]
    return place_on_model(molecule, elements, names, x, n if any(n) else None, by_name=by_name)


def _atoms_of(molecule: Molecule, member: Member) -> list[gemmi.Atom]:
    """Heavy atoms of a residue but the metals, if its chemistry has none."""
    has_metal = any(gemmi.Element(int(z)).is_metal for z in {*molecule.elements.tolist()})
    return [a for a in member.heavy if has_metal or not a.element.is_metal]


def _as_shown(molecule: Molecule, member: Member) -> Molecule:
    """The molecule with the file's hydrogens, if it has all; one more or less at N or O is its charge."""
    there = _hydrogens(member)
    if not any(there.values()):
        return _named_apart(molecule)
    count = {i: len(there[molecule.names[i]]) for i in molecule.heavy.tolist()}
    made = with_hydrogens(molecule, count)
    if made is None:
        return _named_apart(molecule)
    names, x = list(made.names), np.array(made.positions)
    for i in made.heavy.tolist():
        near = [k for pair in made.bonds.tolist() if i in pair for k in pair if made.elements[k] == 1]
        for k, hydrogen in zip(near, there[made.names[i]], strict=True):
            names[k] = hydrogen.name
            x[k] = np.array(hydrogen.pos.tolist()) / ANGSTROM_PER_NM
    return _named_apart(replace(made, names=tuple(names), positions=read_only(x)))


def _as_filed(molecule: Molecule, member: Member) -> Molecule:
    """The molecule with its heavy atoms in the order of the file, on which SMIRNOFF's impropers depend."""
    heavy = (each.name for each in member.heavy)
    place = {name: k for k, name in enumerate(heavy)}
    order = sorted(
        range(molecule.n_atoms), key=lambda i: (place.get(molecule.names[i], len(place)), molecule.names[i])
    )
    now = np.argsort(order)
    assert molecule.positions is not None
    double = molecule.double_bonds.copy()
    double[:, :4] = now[double[:, :4]]
    return replace(
        molecule,
        names=tuple(molecule.names[i] for i in order),
        elements=molecule.elements[order],
        formal_charges=molecule.formal_charges[order],
        bonds=read_only(now[molecule.bonds], np.int64),
        handedness=molecule.handedness[order],
        double_bonds=read_only(double, np.int64),
        positions=read_only(molecule.positions[order]),
    )


def _hydrogens(member: Member) -> dict[str, list[gemmi.Atom]]:
    """Hydrogens of a file by the name of the nearest heavy atom, in the order of the file."""
    heavy = member.heavy
    found: dict[str, list[gemmi.Atom]] = {a.name: [] for a in heavy}
    for hydrogen in (a for a in member.atoms if a.is_hydrogen()):
        nearest = min(heavy, key=lambda a: a.pos.dist(hydrogen.pos))
        if nearest.pos.dist(hydrogen.pos) <= _BONDED:
            found[nearest.name].append(hydrogen)
    return found


def _named_apart(molecule: Molecule) -> Molecule:
    """The molecule with names of hydrogens that no other atom has."""
    used = {molecule.names[i] for i in molecule.heavy}
    names, number = list(molecule.names), 1
    for k in np.flatnonzero(molecule.elements == 1).tolist():
        while names[k] in used:
            names[k], number = f"H{number}", number + 1
        used.add(names[k])
    return replace(molecule, names=tuple(names))


def parametrise_ligands(draft: Draft) -> Changes:
    """Let the small molecules move whose chemistry is known."""
    chemist = LigandChemistry(draft)
    for part in draft.parts:
        if part.evidence is Evidence.SMALL:
            yield from chemist.settle(part)


def assign_ligand_templates(draft: Draft) -> Changes:
    """Report the ligands of a draft that move, and give them their templates."""
    ph = draft.reading.chemistry.ph
    for part in draft.parts:
        part.ligand = part.ligand if part.mobile else None
        if part.ligand is None:
            continue
        (member,), molecule = part.members, part.ligand.molecule
        its, metals = member.residue, charged_metals(member, member.raw_name or member.name, molecule.names)
        member.source = template_of(member.name, part.ligand, dict(enumerate(molecule.names)), metals)
        charge = dict(zip(molecule.names, molecule.formal_charges.tolist(), strict=True))
        charge |= {a.name: a.charge for a in metals}
        for each in member.atoms:
            each.charge = charge.get(each.name, 0)
        yield Repair.of(Kind.BOUND, residue=its, source=molecule.source, charge=f"{sum(charge.values()):+d}")
        yield from report_metals(member, metals)
        if part.ligand.outside:
            yield Repair.of(Kind.CHARGES_OF_MMFF94, residue=its, atoms=part.ligand.outside)
        if part.ligand.charged:
            atoms = tuple(f"{each.atom} {each.after:+d}" for each in part.ligand.charged)
            yield Repair.of(Kind.CHARGED, residue=its, ph=ph, atoms=atoms)
        if part.ligand.unsure:
            yield Repair.of(Kind.CHARGE_UNSURE, residue=its, ph=ph, atoms=part.ligand.unsure)
        if part.inverted:
            yield Repair.of(Kind.INVERTED, residue=its, atoms=part.inverted)


def put_hydrogens(draft: Draft) -> tuple[()]:
    """Put hydrogens of ligands where their molecules have them; those at O and S turn later, as others do."""
    for part in draft.parts:
        if part.ligand is None:
            continue
        molecule = part.ligand.molecule
        assert molecule.positions is not None
        (member,), parent = part.members, ""
        for each in member.atoms:
            if not each.is_hydrogen():
                parent = each.element.name
            elif np.isnan(each.pos.x) and parent not in ("O", "S"):
                x = ANGSTROM_PER_NM * molecule.positions[molecule.names.index(each.name)]
                each.pos = gemmi.Position(*np.round(x, _DECIMALS))
    return ()


def template_of(
    name: str, ligand: Ligand, called: Mapping[int, str], metals: Sequence[gemmi.Atom] = ()
) -> Template:
    """Template of a residue: atoms of a molecule, the names that they have there, and metals beside it."""
    molecule, charge = ligand.molecule, ligand.parameters.charge
    bonds = ([called[i], called[j]] for i, j in molecule.bonds.tolist() if i in called and j in called)
    return Template(
        name,
        {each: gemmi.Element(int(molecule.elements[i])).name for i, each in called.items()}
        | {a.name: a.element.name for a in metals},
        {each: float(charge[i]) for i, each in called.items()} | {a.name: float(a.charge) for a in metals},
        # By name, so that a file written of it gives the same again.
        tuple(sorted((min(bond), max(bond)) for bond in bonds)),
        {},
        is_users=True,
    )
