"""Assign templates and add missing heavy atoms."""

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
"""Angstrom between backbones: no further apart, two side chains can touch."""
_RENAMED_SHOWN = 4


def add_heavy_atoms(draft: Draft, known: Mapping[str, Template]) -> None:
    """Rename atoms to their PDB names and add missing heavy atoms.

    Terminal oxygens are placed by geometry, all others by PDBFixer.

    Raises
    ------
    StructureError
        If a residue has no template, has an atom that its template lacks, or cannot be completed.
    """
    renamed: list[str] = []
    open_ended: list[Member] = []
    lacking: list[tuple[Member, list[str]]] = []
    for part in draft.parts:
        for i, member in enumerate(part.members):
            template = base_template(known, part, i)
            if template is None:
                where = "" if part.obstacle else " at the end of a chain"
                raise StructureError(
                    f"{draft.source}: {member}: the force field has no parameters for it{where}; remove it"
                )
            renamed += [f"{change} of {member}" for change in rename(member.atoms, template)]
            _check_heavy_atoms(draft, member, template)
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


def _check_heavy_atoms(draft: Draft, member: Member, template: Template) -> None:
    """Remove a terminal oxygen within a chain; refuse other heavy atoms that the template lacks."""
    strange = [
        a for a in member.atoms if not a.is_hydrogen() and a.name not in template.element and a.name != "OXT"
    ]
    if strange:
        raise StructureError(
            f"{draft.source}: {member}: atom {strange[0].name} does not belong to {member.name}; "
            "rename or remove it"
        )
    if "OXT" not in template.element and member.atom("OXT"):
        draft.repairs.append(f"{member}: OXT left out: the chain continues")
        member.atoms = [a for a in member.atoms if a.name != "OXT"]


def _terminal_oxygen(draft: Draft, member: Member) -> gemmi.Atom:
    """Build the second oxygen of a carboxylate, in the plane of CA, C and O."""
    c, alpha, o = (np.array(a.pos.tolist()) for name in ("C", "CA", "O") if (a := member.atom(name)))
    arms = np.array([alpha - c, o - c])
    away = -(arms / np.maximum(np.linalg.norm(arms, axis=1, keepdims=True), 1e-9)).sum(axis=0)
    length = np.linalg.norm(away)
    if not 1e-3 < length < 1.999:
        raise StructureError(f"{draft.source}: {member}: CA, C and O are collinear; correct the coordinates")
    return atom("OXT", "O", (c + _CARBOXYLATE * away / length).tolist(), member.atoms[0].b_iso)


def _rebuild(draft: Draft, lacking: list[tuple[Member, list[str]]]) -> None:
    """Build missing heavy atoms residue by residue, each among its neighbours.

    PDBFixer relaxes new atoms against all it is given: the whole protein at once takes quadratic time.
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
        b_iso = float(np.mean([a.b_iso for a in member.atoms]))
        for name in missing:
            if name not in built:
                raise StructureError(
                    f"{draft.source}: {member}: atom {name} is missing and cannot be built; add it there"
                )
            element, x = built[name]
            member.atoms.append(atom(name, element, x, b_iso))


def _around(proteins: list[Member], member: Member) -> list[Member]:
    """Residues whose first atoms are near that of a residue, which is included."""
    centres = np.array([m.atoms[0].pos.tolist() for m in proteins])
    near = np.linalg.norm(centres - member.atoms[0].pos.tolist(), axis=1) < _NEIGHBOURHOOD
    return [m for m, is_near in zip(proteins, near, strict=True) if is_near]


def _built(neighbours: list[Member], member: Member) -> dict[str, tuple[str, list[float]]]:
    """Element and position (angstrom) of each atom of a residue as PDBFixer completes it."""
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
    """Write heavy atoms as mmCIF, residues numbered by their place in the list."""
    structure = gemmi.Structure()
    model, chain = gemmi.Model(1), gemmi.Chain("A")
    for i, member in enumerate(members, 1):
        residue = gemmi.Residue()
        residue.name, residue.seqid = member.name, gemmi.SeqId(str(i))
        residue.entity_type = gemmi.EntityType.Polymer
        for a in member.atoms:
            if not a.is_hydrogen():
                residue.add_atom(a)
        chain.add_residue(residue)
    model.add_chain(chain)
    structure.add_model(model)
    structure.setup_entities()
    structure.assign_label_seq_id()
    return io.StringIO(structure.make_mmcif_document().as_string())


@contextmanager
def _seeded() -> Iterator[None]:
    """Seed Python's global random generator, which PDBFixer may use, and restore its state afterwards."""
    state = random.getstate()
    random.seed(1)
    try:
        yield
    finally:
        random.setstate(state)
