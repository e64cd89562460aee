"""Chemistry, hydrogens and parameters of mobile ligands.

Bond orders and charges are never derived from distances. A molecule without a source of its chemistry, or
without parameters in the force field of small molecules, is fixed, and its repair contains the reason.
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
    Chemistry,
    Draft,
    Evidence,
    MoleculeAtPh,
    Part,
)

_BONDED = 1.5  # Angstrom. Hydrogens further than this from all heavy atoms of their residue are ignored.
_DECIMALS = 5  # Decimals of coordinates in angstrom, because libraries differ in the last bits.


def with_pose(chemistry: Chemistry, path: str, chains: set[str], names: set[str]) -> tuple[Chemistry, Member]:
    """Read a pose from a file. Return the chemistry that includes it, and its residue."""
    pose = of_residue("", source=Path(path))
    if pose.positions is None:
        raise StructureError(f"{path}: has no coordinates in space; dock it first")
    molecule, charged = _charge_for_ph(chemistry, pose, is_given=True)
    assert molecule.positions is not None
    name = next(label for k in count() if (label := f"L{k:02d}" if k else "LIG") not in names)
    chain = next((label for label in ascii_uppercase + ascii_lowercase + digits if label not in chains), "Z")
    atoms = []
    for atom_name, z, charge, x in zip(
        molecule.names, molecule.elements, molecule.formal_charges, molecule.positions, strict=True
    ):
        atoms.append(atom(atom_name, gemmi.Element(int(z)).name, (x * ANGSTROM_PER_NM).tolist()))
        atoms[-1].charge = int(charge)
    posed = {**chemistry.posed, name: (molecule, charged)}
    return replace(chemistry, posed=posed), Member(name, "1", "", chain, atoms, raw_name=name)


class LigandChemistry:
    """Assignment of chemistry to the molecules of a draft. Results are cached by residue name."""

    def __init__(self, draft: Draft) -> None:
        self.draft, self.chemistry, self.templates = draft, draft.reading.chemistry, draft.templates
        self.molecule_cache: dict[str, MoleculeAtPh] = dict(self.chemistry.posed)
        self.ligand_cache: dict[tuple[object, ...], Ligand] = {}

    @cached_property
    def metals(self) -> list[tuple[Member, gemmi.Atom]]:
        """Metals of the draft."""
        return [(m, a) for m in self.draft.members for a in m.atoms if is_metal(a.element.name)]

    def parametrise(self, part: Part) -> Changes:
        """Make a molecule mobile if its chemistry is known, or yield a repair with the reason."""
        (member,) = part.members
        name = member.raw_name or member.name
        try:
            library("rdkit.Chem")
            molecule, charged = self._at_ph(name, member)
            at = _place(molecule, member, by_name=name not in self.chemistry.user_sources)
            new_names = dict(zip(molecule.names, at.molecule.names, strict=True))
            charged = tuple(replace(change, atom=new_names[change.atom]) for change in charged)
            molecule = _with_file_hydrogens(at.molecule, member)
            shows_charges = any(a.is_hydrogen() for a in member.atoms)
            if name in self.chemistry.posed or not shows_charges:
                molecule, charged = self._deprotonate(molecule, charged, member)
            molecule = _in_file_order(molecule, member)
            # Do not attribute charges to the pH if they come from the file's hydrogens.
            now = dict(zip(molecule.names, molecule.formal_charges.tolist(), strict=True))
            charged = tuple(change for change in charged if change.after == now[change.atom])
            part.ligand = self._parametrise(molecule, charged)
            if not shows_charges and _uses_ph(self._read_source(member), name in self.chemistry.user_sources):
                part.ligand = replace(part.ligand, unsure=unsure(molecule, self.chemistry.ph))
        except ProtochainError as error:
            # Raise errors for chemistry that the user has requested.
            if name in self.chemistry.moving or self.chemistry.charges not in CHARGE_RULES:
                raise self.draft.error(f"{member}: ", *error.parts) from None
            yield Repair.of(Kind.STAYS_UNKNOWN, residue=member.residue, why=error)
            yield from self._assign_dictionary_charges(name, member)
            return
        part.inverted, part.posed = at.inverted, name in self.chemistry.posed
        part.evidence = Evidence.CHEMISTRY

    def _assign_dictionary_charges(self, name: str, member: Member) -> Changes:
        """Assign the dictionary's charges to a fixed inorganic ion, unless the file has charges."""
        formal = {} if any(a.charge or a.element.name == "C" for a in member.atoms) else charges(name)
        for a in member.atoms:
            a.charge = formal.get(a.name, 0) or a.charge
        if total := sum(a.charge for a in member.atoms if a.name in formal):
            yield Repair.of(Kind.CHARGES_OF_DICTIONARY, residue=member.residue, charge=f"{total:+d}")

    def _parametrise(self, molecule: Molecule, charged: tuple[Charged, ...]) -> Ligand:
        """Return the molecule with parameters. Copies share the parameters."""
        fields = vars(replace(molecule, positions=None, source="")).values()
        key = tuple(value.tobytes() if isinstance(value, np.ndarray) else value for value in fields)
        if key not in self.ligand_cache:
            self.ligand_cache[key] = assign_parameters(molecule, self.chemistry.charges)
        return replace(self.ligand_cache[key], molecule=molecule, charged=charged)

    def _deprotonate(self, molecule: Molecule, charged: tuple[Charged, ...], member: Member) -> MoleculeAtPh:
        """Return the molecule without protons displaced by metals. Removes these from the residue, too."""
        metals = [metal for metal in self.metals if metal[0] is not member]
        holding = {a.name for a in member.atoms if any(Link(member, a, *m).is_coordinated for m in metals)}
        released, added = at_metal(molecule, [k for k, name in enumerate(molecule.names) if name in holding])
        member.atoms = [a for a in member.atoms if not a.is_hydrogen() or a.name in released.names]
        before = {change.atom: change.before for change in charged}
        added = tuple(replace(change, before=before.get(change.atom, change.before)) for change in added)
        changed = {change.atom: change for change in (*charged, *added)}.values()
        return released, tuple(change for change in changed if change.before != change.after)

    def name(self, member: Member) -> str:
        """Return the name with which the chemistry of a residue is looked up."""
        return member.name if member.name in STANDARD else member.raw_name or member.name

    def lookup(self, member: Member) -> Molecule:
        """Return the molecule of a residue as in its source, with the atom names of the file."""
        molecule = self._read_source(member)
        atoms = _atoms_of(molecule, member)
        names, is_given = tuple(a.name for a in atoms), self.name(member) in self.chemistry.moving
        if not is_given and {*names} <= {*molecule.names}:
            return molecule
        x = np.array([a.pos.tolist() for a in atoms]) / ANGSTROM_PER_NM
        try:
            return copy_names(molecule, [a.element.atomic_number for a in atoms], names, x)
        except ProtochainError:
            if is_given:
                raise
            return molecule

    def _read_source(self, member: Member) -> Molecule:
        name = self.name(member)
        atoms = {a.name: (a.element.name, int(a.charge)) for a in member.atoms}
        return of_residue(name, self.draft.header, atoms, self.chemistry.user_sources.get(name))

    def _at_ph(self, name: str, member: Member) -> MoleculeAtPh:
        """Return the molecule of a residue at the pH, by name."""
        if name not in self.molecule_cache:
            free, is_given = self._read_source(member), name in self.chemistry.user_sources
            self.molecule_cache[name] = _charge_for_ph(self.chemistry, free, is_given, inner_donors(member))
        return self.molecule_cache[name]


def _charge_for_ph(
    chemistry: Chemistry, molecule: Molecule, is_given: bool, donors: Collection[str] = ()
) -> MoleculeAtPh:
    """Protonate a molecule for the pH, unless its source determines its charges, as for SO4."""
    by_ph = _uses_ph(molecule, is_given)
    return at_ph(molecule, chemistry.ph, donors) if by_ph else (molecule, ())


def _uses_ph(molecule: Molecule, is_given: bool) -> bool:
    """Return whether the pH determines the charges of a molecule. It does not for SO4 or user charges."""
    # The neighbouring charges of nitro groups and oxides do not count.
    shown = {*np.flatnonzero(molecule.formal_charges).tolist()}
    pairs = (pair for pair in molecule.bonds.tolist() if not molecule.formal_charges[pair].sum())
    shown -= {atom for pair in pairs if {*pair} <= shown for atom in pair}
    return bool(np.isin(molecule.elements, (6, 15)).any()) and not (is_given and shown)


def inner_donors(member: Member) -> set[str]:
    """Return the names of atoms that coordinate a metal of the same residue."""
    metals = [(member, a) for a in member.heavy if is_metal(a.element.name)]
    return {a.name for a in member.heavy if any(Link(member, a, *metal).is_coordinated for metal in metals)}


def report_metals(member: Member, metals: Sequence[gemmi.Atom]) -> Changes:
    """Report metals whose bonds are springs."""
    if metals:
        atoms = tuple(f"{a.name} {a.charge:+d}" for a in metals)
        yield Repair.of(Kind.COMPLEX, residue=member.residue, atoms=atoms)


def charged_metals(member: Member, name: str, names: Collection[str]) -> list[gemmi.Atom]:
    """Return metals of a residue outside its molecule. Sets oxidation states if the file has no charges."""
    metals = [a for a in member.heavy if a.element.is_metal and a.name not in names]
    for a in metals:
        a.charge = a.charge or oxidation_state(name, a.element.name)
    return metals


def _place(molecule: Molecule, member: Member, by_name: bool) -> Placed:
    """Place a molecule at the coordinates of the file."""
    atoms = _atoms_of(molecule, member)
    hydrogens = _hydrogens(member)
    n = [len(hydrogens[a.name]) for a in atoms]
    names, x = tuple(a.name for a in atoms), np.array([a.pos.tolist() for a in atoms]) / ANGSTROM_PER_NM
    elements = [a.element.atomic_number for a in atoms]
    return place_on_model(molecule, elements, names, x, n if any(n) else None, by_name=by_name)


def _atoms_of(molecule: Molecule, member: Member) -> list[gemmi.Atom]:
    """Return the heavy atoms of a residue, without metals if the molecule has none."""
    has_metal = any(gemmi.Element(int(z)).is_metal for z in {*molecule.elements.tolist()})
    return [a for a in member.heavy if has_metal or not a.element.is_metal]


def _with_file_hydrogens(molecule: Molecule, member: Member) -> Molecule:
    """Return the molecule with the file's hydrogens, if complete. Their number at N or O sets its charge."""
    hydrogens = _hydrogens(member)
    if not any(hydrogens.values()):
        return _rename_hydrogens(molecule)
    count = {i: len(hydrogens[molecule.names[i]]) for i in molecule.heavy.tolist()}
    new = with_hydrogens(molecule, count)
    if new is None:
        return _rename_hydrogens(molecule)
    names, x = list(new.names), np.array(new.positions)
    for i in new.heavy.tolist():
        near = [k for pair in new.bonds.tolist() if i in pair for k in pair if new.elements[k] == 1]
        for k, hydrogen in zip(near, hydrogens[new.names[i]], strict=True):
            names[k] = hydrogen.name
            x[k] = np.array(hydrogen.pos.tolist()) / ANGSTROM_PER_NM
    return _rename_hydrogens(replace(new, names=tuple(names), positions=read_only(x)))


def _in_file_order(molecule: Molecule, member: Member) -> Molecule:
    """Reorder heavy atoms as in the file, because SMIRNOFF impropers depend on the order."""
    heavy = (a.name for a in member.heavy)
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
    """Return the file's hydrogens by the name of the nearest heavy atom, in the order of the file."""
    heavy = member.heavy
    hydrogens: dict[str, list[gemmi.Atom]] = {a.name: [] for a in heavy}
    for hydrogen in (a for a in member.atoms if a.is_hydrogen()):
        nearest = min(heavy, key=lambda a: a.pos.dist(hydrogen.pos))
        if nearest.pos.dist(hydrogen.pos) <= _BONDED:
            hydrogens[nearest.name].append(hydrogen)
    return hydrogens


def _rename_hydrogens(molecule: Molecule) -> Molecule:
    """Return the molecule with unique names of hydrogens."""
    used = {molecule.names[i] for i in molecule.heavy}
    names, number = list(molecule.names), 1
    for k in np.flatnonzero(molecule.elements == 1).tolist():
        while names[k] in used:
            names[k], number = f"H{number}", number + 1
        used.add(names[k])
    return replace(molecule, names=tuple(names))


def parametrise_ligands(draft: Draft) -> Changes:
    """Parametrise small molecules of known chemistry, which makes them mobile."""
    chemist = LigandChemistry(draft)
    for part in draft.parts:
        if part.evidence is Evidence.SMALL:
            yield from chemist.parametrise(part)


def assign_ligand_templates(draft: Draft) -> Changes:
    """Report the mobile ligands of a draft, and assign their templates."""
    ph = draft.reading.chemistry.ph
    for part in draft.parts:
        part.ligand = part.ligand if part.mobile else None
        if part.ligand is None:
            continue
        (member,), molecule = part.members, part.ligand.molecule
        site, metals = member.residue, charged_metals(member, member.raw_name or member.name, molecule.names)
        member.source = template_of(member.name, part.ligand, dict(enumerate(molecule.names)), metals)
        charge = dict(zip(molecule.names, molecule.formal_charges.tolist(), strict=True))
        charge |= {a.name: a.charge for a in metals}
        for a in member.atoms:
            a.charge = charge.get(a.name, 0)
        yield Repair.of(Kind.BOUND, residue=site, source=molecule.source, charge=f"{sum(charge.values()):+d}")
        yield from report_metals(member, metals)
        if part.ligand.outside:
            yield Repair.of(Kind.CHARGES_OF_MMFF94, residue=site, atoms=part.ligand.outside)
        if part.ligand.charged:
            atoms = tuple(f"{change.atom} {change.after:+d}" for change in part.ligand.charged)
            yield Repair.of(Kind.CHARGED, residue=site, ph=ph, atoms=atoms)
        if part.ligand.unsure:
            yield Repair.of(Kind.CHARGE_UNSURE, residue=site, ph=ph, atoms=part.ligand.unsure)
        if part.inverted:
            yield Repair.of(Kind.INVERTED, residue=site, atoms=part.inverted)


def put_hydrogens(draft: Draft) -> tuple[()]:
    """Place ligand hydrogens as in their molecules, except at O and S, which are oriented later."""
    for part in draft.parts:
        if part.ligand is None:
            continue
        molecule = part.ligand.molecule
        assert molecule.positions is not None
        (member,), parent = part.members, ""
        for a in member.atoms:
            if not a.is_hydrogen():
                parent = a.element.name
            elif np.isnan(a.pos.x) and parent not in ("O", "S"):
                x = ANGSTROM_PER_NM * molecule.positions[molecule.names.index(a.name)]
                a.pos = gemmi.Position(*np.round(x, _DECIMALS))
    return ()


def template_of(
    name: str, ligand: Ligand, names: Mapping[int, str], metals: Sequence[gemmi.Atom] = ()
) -> Template:
    """Return the template of a residue from atoms of a molecule, their names there, and added metals."""
    molecule, charge = ligand.molecule, ligand.parameters.charge
    bonds = ([names[i], names[j]] for i, j in molecule.bonds.tolist() if i in names and j in names)
    elements = {n: gemmi.Element(int(molecule.elements[i])).name for i, n in names.items()}
    elements |= {a.name: a.element.name for a in metals}
    charges = {n: float(charge[i]) for i, n in names.items()} | {a.name: float(a.charge) for a in metals}
    # Sorted by name, so that a written file gives the same result.
    in_order = tuple(sorted((min(bond), max(bond)) for bond in bonds))
    return Template(name, elements, charges, in_order, is_users=True)
