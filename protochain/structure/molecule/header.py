"""Header of a file, from reading to writing: title, cell, sequences, secondary structure.

It is stored as mmCIF text of gemmi, because gemmi's objects are mutable and cannot be pickled.
"""

from collections.abc import Iterable

import gemmi

from protochain.structure.molecule.residues import CAPS

Label = tuple[str, int | None]
"""``label_asym_id`` of a residue, and its place in the sequence of its entity, from 1.

Without label ids, as in the PDB format, gemmi assigns them: ``Axp`` for the polymer of chain A.
"""

NO_LABEL: Label = ("", None)

_CATEGORIES = (
    "cell", "symmetry", "title_keywords", "entity", "entity_poly", "entity_poly_seq", "struct_asym",
    "struct_conf", "struct_sheet", "conn",
)  # fmt: skip
_SPECIAL = tuple(";#'\"_$[]")  # First characters that no plain mmCIF value has.
_INFO = ("_struct.title", "_cell.Z_PDB")
"""Retained entry metadata of gemmi. A computed structure has other experiments and dates."""


def read_header(structure: gemmi.Structure, records: str = "") -> str:
    """Assign missing label ids to residues and return the header of the file."""
    structure.setup_entities()
    structure.assign_label_seq_id()
    groups = gemmi.MmcifOutputGroups(False)
    for category in _CATEGORIES:
        setattr(groups, category, True)
    document = gemmi.cif.Document()
    block = document.add_copied_block(structure.make_mmcif_block(groups))
    quote_names(block)
    for item in gemmi.cif.read_string(records).sole_block() if records else ():
        block.add_item(item)
    return str(document.as_string())


def quote_names(block: gemmi.cif.Block) -> None:
    """Quote names that are empty, have blanks, or begin as a text, comment, quotation or tag."""
    for loop in (item.loop for item in block if item.loop is not None):
        for k, value in enumerate(loop.values):
            quoted = value[-1:] == value[:1] != value or "\n" in value
            needs_quotes = not value or " " in value or value.startswith(_SPECIAL)
            if needs_quotes and not (quoted and value[0] in "'\";"):
                loop[divmod(k, loop.width())] = gemmi.cif.quote(value)


def with_header(header: str) -> gemmi.Structure:
    """Return a structure without models from a header."""
    if not header:
        return gemmi.Structure()
    out = gemmi.make_structure_from_block(gemmi.cif.read_string(header).sole_block())
    for name in [name for name in out.info if name not in _INFO]:
        del out.info[name]
    return out


def update_entities(out: gemmi.Structure, *, complete: bool) -> None:
    """Restrict entities and secondary structure to the present residues."""
    residues_of: dict[str, list[gemmi.Residue]] = {}
    present = [residue for model in out for chain in model for residue in chain]
    for residue in present:
        residues_of.setdefault(residue.subchain, []).append(residue)
    entities = []
    for entity in out.entities:
        entity.subchains = [label for label in dict.fromkeys(entity.subchains) if label in residues_of]
        if entity.subchains and _fits(entity, residues_of, complete):
            entities.append(entity)
            for label in entity.subchains:
                del residues_of[label]
    entities += [_entity(name, residues, complete) for name, residues in residues_of.items()]
    _make_names_unique(entities)
    out.entities = gemmi.EntityList(entities)
    # The list has copies, and the previous entities no longer exist.
    info = {label: (entity.name, entity.entity_type) for entity in out.entities for label in entity.subchains}
    for residue in present:
        residue.entity_id, residue.entity_type = info[residue.subchain]
    _filter_annotations(out)


def _fits(entity: gemmi.Entity, residues_of: dict[str, list[gemmi.Residue]], complete: bool = True) -> bool:
    """Whether an entity has a place for each residue. Its sequence is updated to the present names."""
    residues = [residue for subchain in entity.subchains for residue in residues_of[subchain]]
    is_polymer = entity.entity_type == gemmi.EntityType.Polymer
    if any(is_polymer != (residue.entity_type == gemmi.EntityType.Polymer) for residue in residues):
        return False
    if not is_polymer:
        return True
    names: dict[int, dict[str, None]] = {}
    for residue in residues:
        if residue.name in CAPS and not complete:  # PDB files have no numbers in the sequence.
            continue
        if residue.label_seq is None or not 1 <= residue.label_seq <= len(entity.full_sequence):
            return False
        names.setdefault(residue.label_seq, {})[residue.name] = None
    sequence = list(entity.full_sequence)
    for place, present in names.items():
        sequence[place - 1] = ",".join(present)
    entity.full_sequence = sequence
    return True


def _entity(subchain: str, residues: list[gemmi.Residue], complete: bool) -> gemmi.Entity:
    """Make the entity of a subchain without a fitting entity in the file."""
    entity = gemmi.Entity(subchain)
    entity.subchains = [subchain]
    entity.entity_type = residues[0].entity_type
    if entity.entity_type != gemmi.EntityType.Polymer:
        water = all(residue.is_water() for residue in residues)
        entity.entity_type = gemmi.EntityType.Water if water else entity.entity_type
        return entity
    entity.polymer_type = _polymer_type(residues)
    places: dict[tuple[str, str], int] = {}
    for residue in residues:
        place = places.setdefault((str(residue.seqid), residue.name), len(places) + 1)
        residue.label_seq = place if complete else None
    if complete:
        entity.full_sequence = [name for _, name in places]
    return entity


def _polymer_type(residues: list[gemmi.Residue]) -> gemmi.PolymerType:
    """DNA, RNA or both by the sugars of its nucleotides, or a polypeptide."""
    sugars = [residue for residue in residues if residue.find_atom("C1'", "*")]
    if 2 * len(sugars) <= len(residues):
        return gemmi.PolymerType.PeptideL
    kinds = {bool(residue.find_atom("O2'", "*")) for residue in sugars}
    if len(kinds) == 2:
        return gemmi.PolymerType.DnaRnaHybrid
    return gemmi.PolymerType.Rna if kinds == {True} else gemmi.PolymerType.Dna


def _make_names_unique(entities: list[gemmi.Entity]) -> None:
    used: set[str] = set()
    for entity in entities:
        name, n = entity.name, 1
        while entity.name in used:
            n += 1
            entity.name = f"{name}{n}"
        used.add(entity.name)


def _filter_annotations(out: gemmi.Structure) -> None:
    """Remove helices, strands and modified residues that are absent, and update residue names."""
    names = {
        (chain.name.strip(), str(residue.seqid)): residue.name
        for model in out for chain in model for residue in chain
    }  # fmt: skip

    def rename_ends(ends: Iterable[gemmi.AtomAddress]) -> bool:
        for end in ends:
            name = names.get((end.chain_name.strip(), str(end.res_id.seqid)))
            if name is None:
                return False
            end.res_id.name = name
        return True

    out.mod_residues = [
        modified for modified in out.mod_residues
        if names.get((modified.chain_name.strip(), str(modified.res_id.seqid))) == modified.res_id.name
    ]  # fmt: skip
    out.helices = gemmi.HelixList([helix for helix in out.helices if rename_ends((helix.start, helix.end))])
    sheets = []
    for sheet in out.sheets:
        strands = [strand for strand in sheet.strands if rename_ends((strand.start, strand.end))]
        for strand in strands:
            bond = (strand.hbond_atom1, strand.hbond_atom2)
            if strand.hbond_atom1.atom_name and not rename_ends(bond):
                strand.hbond_atom1 = strand.hbond_atom2 = gemmi.AtomAddress()
        if strands:
            strands[0].sense = 0
            sheet.strands = gemmi.Sheet.StrandList(strands)
            sheets.append(sheet)
    out.sheets = gemmi.SheetList(sheets)
