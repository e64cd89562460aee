"""Every residue its template, and every atom of it: heavy atoms that a file lacks are added."""

import io
import random
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

import gemmi
import numpy as np
import openmm
from openmm import unit
from pdbfixer import PDBFixer

from protochain import residues
from protochain.errors import StructureError
from protochain.structure.draft import Draft, Member, atom
from protochain.structure.templates import Template, base_template, rename

_CARBOXYLATE = 1.25
"""Angstrom: C-O of ff14SB's carboxylate."""
_NEIGHBOURHOOD = 15.0
"""Angstrom from backbone to backbone: as far as two side chains reach that could meet."""
_RENAMED_SHOWN = 4


def add_heavy_atoms(draft: Draft, known: Mapping[str, Template]) -> None:
    """Give every atom its PDB name, drop what does not belong, and add heavy atoms that are missing.

    Terminal oxygens by geometry, all others by PDBFixer.

    Raises
    ------
    StructureError
        If a residue has an atom that no template has, or none can rebuild what it lacks.
    """
    renamed: list[str] = []
    open_ended: list[Member] = []
    lacking: list[tuple[Member, list[str]]] = []
    for part in draft.parts:
        for i, member in enumerate(part.members):
            template = base_template(known, part, i)
            if template is None:
                where = "at the end of a chain " if not part.obstacle else ""
                raise StructureError(f"{draft.source}: {member}: {where}no force field knows it; remove it")
            renamed += [f"{change} of {member}" for change in rename(member.atoms, template)]
            _drop_strange(draft, member, template)
            missing = [name for name in template.heavy if not member.atom(name)]
            if "OXT" in missing:
                missing.remove("OXT")
                open_ended.append(member)
            if missing:
                lacking.append((member, missing))
    if renamed:
        more = f" and {len(renamed) - _RENAMED_SHOWN} more" if len(renamed) > _RENAMED_SHOWN else ""
        draft.repairs.append(f"atoms renamed: {', '.join(renamed[:_RENAMED_SHOWN])}{more}")
    _rebuild(draft, lacking)
    for member in open_ended:
        draft.repairs.append(f"{member}: missing OXT added")
        member.atoms.append(_terminal_oxygen(draft, member))


def _drop_strange(draft: Draft, member: Member, template: Template) -> None:
    """Drop a terminal oxygen within a chain; refuse other heavy atoms that the residue does not have."""
    strange = [
        a for a in member.atoms if not a.is_hydrogen() and a.name not in template.element and a.name != "OXT"
    ]
    if strange:
        raise StructureError(
            f"{draft.source}: {member}: its atom {strange[0].name} is not one of a {member.name}; "
            "mend or remove it"
        )
    if "OXT" not in template.element and member.atom("OXT"):
        draft.repairs.append(f"{member}: OXT left out, for the chain goes on")
        member.atoms = [a for a in member.atoms if a.name != "OXT"]


def _terminal_oxygen(draft: Draft, member: Member) -> gemmi.Atom:
    """Return the second oxygen of a carboxylate, in the plane of the first."""
    c, alpha, o = (np.array(own.pos.tolist()) for name in ("C", "CA", "O") if (own := member.atom(name)))
    arms = np.array([alpha - c, o - c])
    away = -(arms / np.maximum(np.linalg.norm(arms, axis=1, keepdims=True), 1e-9)).sum(axis=0)
    length = np.linalg.norm(away)
    if not 1e-3 < length < 1.999:
        raise StructureError(f"{draft.source}: {member}: CA, C and O lie in a line; mend their coordinates")
    return atom("OXT", "O", (c + _CARBOXYLATE * away / length).tolist(), member.atoms[0].b_iso)


def _rebuild(draft: Draft, lacking: list[tuple[Member, list[str]]]) -> None:
    """Build what residues lack, one after the other, each among its neighbours.

    PDBFixer relaxes what it adds against all it is given: all at once would take the square of the time.
    """
    for member, missing in lacking:
        if member.name not in residues.STANDARD:
            raise StructureError(
                f"{draft.source}: {member}: atom {missing[0]} missing; build it, or remove the residue"
            )
    proteins = [m for part in draft.parts if not part.obstacle for m in part.members]
    for member, missing in lacking:
        built = _built(_around(proteins, member), member)
        draft.repairs.append(f"{member}: missing {', '.join(missing)} added")
        b_iso = float(np.mean([own.b_iso for own in member.atoms]))
        for name in missing:
            if name not in built:
                raise StructureError(
                    f"{draft.source}: {member}: atom {name} missing, and it cannot be built; mend the file"
                )
            element, x = built[name]
            member.atoms.append(atom(name, element, x, b_iso))


def _around(proteins: list[Member], member: Member) -> list[Member]:
    """Residues whose first atom is near its own, itself among them."""
    centres = np.array([m.atoms[0].pos.tolist() for m in proteins])
    near = np.linalg.norm(centres - member.atoms[0].pos.tolist(), axis=1) < _NEIGHBOURHOOD
    return [m for m, is_near in zip(proteins, near, strict=True) if is_near]


def _built(neighbours: list[Member], member: Member) -> dict[str, tuple[str, list[float]]]:
    """Element and position, in angstrom, of each atom of a residue that PDBFixer has completed."""
    fixer = PDBFixer(pdbxfile=_as_mmcif(neighbours), platform=openmm.Platform.getPlatform("Reference"))
    place = str(neighbours.index(member) + 1)
    fixer.missingResidues = {}
    with _seeded():
        fixer.findMissingAtoms()
        fixer.missingTerminals = {}
        fixer.missingAtoms = {r: atoms for r, atoms in fixer.missingAtoms.items() if r.id == place}
        fixer.addMissingAtoms(seed=1)
    (found,) = (residue for residue in fixer.topology.residues() if residue.id == place)
    x = fixer.positions.value_in_unit(unit.angstrom)
    return {a.name: (a.element.symbol, list(x[a.index])) for a in found.atoms()}


def _as_mmcif(members: list[Member]) -> io.StringIO:
    """Write heavy atoms, each residue under its place in the list."""
    structure = gemmi.Structure()
    model, chain = gemmi.Model(1), gemmi.Chain("A")
    for i, member in enumerate(members, 1):
        residue = gemmi.Residue()
        residue.name, residue.seqid = member.name, gemmi.SeqId(str(i))
        residue.entity_type = gemmi.EntityType.Polymer
        for own in member.atoms:
            if not own.is_hydrogen():
                residue.add_atom(own)
        chain.add_residue(residue)
    model.add_chain(chain)
    structure.add_model(model)
    structure.setup_entities()
    structure.assign_label_seq_id()
    return io.StringIO(structure.make_mmcif_document().as_string())


@contextmanager
def _seeded() -> Iterator[None]:
    """Run with the global generator that PDBFixer may draw from at a fixed state, then put it back."""
    state = random.getstate()
    random.seed(1)
    try:
        yield
    finally:
        random.setstate(state)
