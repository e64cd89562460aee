"""Rebuild side chains on rotamers, for the same or for substituted residues."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import gemmi
import numpy as np

from protochain.core import defaults
from protochain.core.errors import StructureError, refusal
from protochain.core.markup import abridge
from protochain.structure.formats.files import number_atoms
from protochain.structure.molecule.model import Structure
from protochain.structure.molecule.repairs import Kind, Repair
from protochain.structure.molecule.residues import CAPS, LETTERS, STANDARD, name_in_file
from protochain.structure.preparation.prepare import READING, prepare, reading_of, run
from protochain.structure.preparation.structure_draft import Draft
from protochain.structure.select import select
from protochain.structure.write import as_gemmi

_BACKBONE = ("N", "CA", "C", "O", "OXT")


def substitute(structure: Structure, names: Mapping[int, str], **settings: Any) -> Structure:
    """Rebuild side chains on rotamers, all at once, under new names by residue. Other atoms stay."""
    model, sources, sites, notes = as_gemmi([structure]), list[int](), set[tuple[str, str]](), list[Repair]()
    first = np.searchsorted(structure.atom_residue, np.arange(structure.n_residues + 1))
    places = ((chain, residue) for chain in model[0] for residue in chain)
    for r, (chain, residue) in enumerate(places):
        atoms = range(first[r], first[r + 1])
        if r not in names:
            sources += atoms
            continue
        staying = [k for k in atoms if structure.atom_name[k] in _BACKBONE]
        sources += staying
        sites.add((chain.name, str(residue.seqid)))
        for k in reversed([k - first[r] for k in atoms if k not in staying]):
            del residue[k]
        before = structure.residue(r)
        residue.name = name_in_file(names[r], bool(structure.mirrored[r]))
        is_same = residue.name == before.name
        kind = Kind.SIDE_CHAIN_BUILT if is_same else Kind.MUTATED
        notes.append(Repair(kind, {"residue": before} | ({} if is_same else {"name": residue.name})))
    # Bonds of the removed side chains are removed.
    model.connections = gemmi.ConnectionList(
        bond
        for bond in model.connections
        if not any(
            (end.chain_name, str(end.res_id.seqid)) in sites and end.atom_name not in _BACKBONE
            for end in (bond.partner1, bond.partner2)
        )
    )
    # The rest is prepared with the chemistry of its ligands, and the missing side chains are built.
    number_atoms(model)
    chemistry = {
        str(structure.residue_name[structure.atom_residue[ligand.atoms[0]]]): (
            replace(ligand.ligand.molecule, names=tuple(structure.atom_name[ligand.atoms].tolist())),
            ligand.ligand.charged,
        )
        for ligand in structure.ligands
    }
    used = ("forcefield", "ph", "ligand_charges", "disulfide")
    reading = reading_of(keep=("all",), **{name: settings[name] for name in used if name in settings})
    reading = replace(reading, chemistry=replace(reading.chemistry, posed=chemistry))
    draft = run(Draft(structure.name, structure.name, reading=reading, file=model), READING)
    for r in names:
        # If the name stays, arrays and energies of the new residue have the order of the old one.
        if draft.members[r].name == structure.residue_name[r]:
            draft.members[r].order = tuple(structure.atom_name[structure.atom_residue == r].tolist())
    new = prepare(draft)
    return _with_history(new, structure, np.array(sources), notes)


def _with_history(new: Structure, old: Structure, sources: np.ndarray, notes: list[Repair]) -> Structure:
    """Return the new structure with the origin, repairs and header of the old one."""
    assert new.origin is not None
    place = np.where(new.origin.place < 0, -1, sources[new.origin.place])
    is_old, x, built = place >= 0, np.array(new.positions), np.array(new.built)
    # Conversion to angstrom and back changes bits.
    x[is_old], built[is_old] = old.positions[place[is_old]], old.built[place[is_old]]
    origin = old.origin and replace(
        new.origin, atoms=old.origin.atoms, place=np.where(is_old, old.origin.place[place], -1)
    )
    repairs = *old.repairs, *notes, *(r for r in new.repairs if r.kind is Kind.NOT_PROVEN)
    return replace(
        new, positions=x, built=built, origin=origin, repairs=repairs, left_out=old.left_out,
        header=old.header, residue_label=old.residue_label, model_number=old.model_number,
    )  # fmt: skip


def rebuild(structure: Structure, selection: str, sequence: str, **settings: Any) -> Structure:
    """Thread another sequence onto the backbone, and rebuild the side chains of a selection, or all."""
    names = thread_sequence(structure, sequence) if sequence else {}
    if selection:
        chosen = ~structure.kept
        chosen = chosen if selection == defaults.MOVE else chosen & select(structure, selection)
        for r in np.unique(structure.atom_residue[chosen]).tolist():
            if structure.residue_name[r] in STANDARD:
                names.setdefault(r, str(structure.residue_name[r]))
        if not names:
            raise refusal("rebuild_side_chains", repr(selection), "has no side chain of a standard residue")
    return substitute(structure, names, **settings) if names else structure


def thread_sequence(structure: Structure, sequence: str) -> dict[int, str]:
    """New names, by index, of the residues whose letters in the sequences differ."""
    (amino,) = np.nonzero(np.bincount(structure.atom_residue, ~structure.kept) > 0)
    amino = amino[~np.isin(structure.residue_name[amino], [*CAPS])]
    chain = structure.residue_chain[amino]
    chains = list(dict.fromkeys(chain.tolist()))
    texts = [(name, letters) for part in sequence.split("/") for name, _, letters in [part.rpartition("=")]]
    if not {name for name, _ in texts} <= {*chains}:
        if len(texts) != len(chains):
            raise StructureError(
                f"{structure.name}: sequence: {len(texts)} given, of {abridge([n or '-' for n, _ in texts])}"
                f"; its chains are {', '.join(chains)}: give one for each, or name them so"
            )
        texts = [(chain, letters) for chain, (_, letters) in zip(chains, texts, strict=True)]
    names = {}
    for chain_id, letters in texts:
        residues = amino[chain == chain_id].tolist()
        if len(letters) - letters.count("X") == len(residues):  # ProteinMPNN writes X for missing residues.
            letters = letters.replace("X", "")
        if len(letters) != len(residues):
            raise StructureError(
                f"{structure.name}: sequence: {len(letters)} letters for chain {chain_id}, which has "
                f"{len(residues)} residues; give one for each, - for one that stays"
            )
        for r, letter in zip(residues, letters, strict=True):
            now = str(structure.residue_name[r])
            # X stands for a residue without a letter.
            if letter == "-" or letter == STANDARD.get(now, "X"):
                continue
            if letter not in LETTERS:
                raise StructureError(
                    f"{structure.name}: sequence: {letter!r} at {structure.describe_residue(r)}; "
                    "use the 20 codes, or - for one that stays"
                )
            names[r] = LETTERS[letter]
    return names
