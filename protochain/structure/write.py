"""Write structures to PDB or mmCIF files, completely or not at all."""

import textwrap
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from copy import deepcopy
from dataclasses import replace
from itertools import chain as chained
from itertools import count, groupby
from operator import itemgetter
from pathlib import Path
from string import ascii_uppercase
from typing import Any

import gemmi
import numpy as np
from numpy.typing import NDArray

from protochain.core.checks import flag
from protochain.core.checks import path as as_path
from protochain.core.errors import ProtochainError, StructureError
from protochain.core.markup import abridge
from protochain.core.storage import write_atomically
from protochain.core.units import ANGSTROM_PER_NM
from protochain.ligands.sources import from_dictionary, of_residue
from protochain.ligands.tables import ORDERS, heavy_rows, rows
from protochain.structure.convert import as_structure, final_structure
from protochain.structure.formats import records
from protochain.structure.formats.files import PACKINGS, SUFFIXES, format_of, split_name
from protochain.structure.molecule.header import NO_LABEL, Label, quote_names, update_entities, with_header
from protochain.structure.molecule.links import is_metal
from protochain.structure.molecule.member import address_of
from protochain.structure.molecule.model import Structure
from protochain.structure.molecule.residues import NUCLEOTIDES

_REMARK_WIDTH = 68
_PDB_LOWEST, _PDB_HIGHEST = -999.999, 9999.999  # Angstrom: range of eight columns with three decimals.
_PDB_NAME = 3  # Letters of a residue name.
_PDB_SERIALS = 99_999  # Largest serial number of an atom in five columns. The end of each chain has one, too.
_Lines = Iterable[str]
_ATOMS, _BONDS = "_chem_comp_atom.", "_chem_comp_bond."
_CIS = 30.0
"""Degrees: a peptide bond with an omega below this is cis, as in the PDB archive's CISPEP records."""
_LINK_NAMES = {
    gemmi.ConnectionType.Disulf: "disulf", gemmi.ConnectionType.Covale: "covale",
    gemmi.ConnectionType.MetalC: "metalc", gemmi.ConnectionType.Hydrog: "hydrog",
}  # fmt: skip


def save(structure: Any, path: str | Path, remarks: Iterable[str] = (), *, hydrogens: bool = True) -> None:
    """Write a structure to a file, with the header of its source.

    Chain ids, numbers, insertion codes, occupancies, B factors, title, unit cell, sequences, helices and
    strands are from the source, cis peptides from the coordinates. The structure's repairs are written as
    REMARK 3, or in the category ``_protochain_repair``.

    Parameters
    ----------
    structure : Structure, Chain, Solution, or anything that :func:`protochain.as_structure` accepts
        Structure to write. A list or tuple of structures of one source becomes the models of one file.
    path : path-like
        PDB for ``.pdb`` and ``.ent``, mmCIF for ``.cif``, ``.mmcif`` and ``.pdbx``, compressed if ``.gz``,
        ``.bz2`` or ``.xz`` follows. PDB rounds positions to 0.001 angstrom, which changes the energy of a
        protein by tenths of a kJ/mol. mmCIF rounds to 1e-7.
    remarks : iterable of str
        Lines of provenance, written as REMARK 3 or in the category ``_protochain_provenance``.
    hydrogens : bool
        Whether to write hydrogens.

    Raises
    ------
    StructureError
        If no model is passed, the suffix is unknown, or the structure does not fit the format.

    Examples
    --------
    >>> pc.save(pc.from_sequence("GAG"), "gag.pdb")
    >>> pc.load("gag.pdb").n_atoms
    27
    """
    path, hydrogens = as_path(path, "path"), flag(hydrogens, "hydrogens")
    check_format(path)
    several = isinstance(structure, list | tuple) and final_structure(structure) is None
    models = [as_structure(model) for model in (structure if several else [structure])]
    if not models:
        raise StructureError(f"{path}: no models are given; give at least one structure")
    for model in models:
        check_fits(model, path)
    _, suffix, packing = split_name(path)
    _write_packed(as_text(models, suffix, remarks, hydrogens=hydrogens), packing, path)


def save_proteins(complexes: Iterable[tuple[Path, Sequence[str]]], path: Path) -> None:
    """Write files without some of their residues, named as ``B/1``, as models. Equal models are one."""
    models = gemmi.Structure()
    for source, residues in complexes:
        structure = gemmi.read_structure(str(source))
        for residue in residues:
            gemmi.Selection(f"//{residue}").remove_selected(structure)
        structure.remove_empty_chains()
        x = [atom.atom.pos.tolist() for atom in structure[0].all()]
        if not len(models):
            models = structure
        elif x != [atom.atom.pos.tolist() for atom in models[-1].all()]:
            models.add_model(structure[0])
    models.renumber_models()
    models.setup_entities()
    models.raw_remarks = []  # Of the first complex.
    _, suffix, packing = split_name(path)
    options = gemmi.PdbWriteOptions(cryst1_record=models.cell.is_crystal())
    is_pdb = SUFFIXES[suffix.lower()] == "PDB"
    text = models.make_pdb_string(options) if is_pdb else models.make_mmcif_document().as_string()
    _write_packed(text, packing, path)


def _write_packed(text: str, packing: str, path: Path) -> None:
    data = PACKINGS[packing.lower()](text.encode()) if packing else text.encode()
    write_atomically(path, lambda target: target.write_bytes(data))


def as_text(
    structure: Structure | Sequence[Structure],
    suffix: str,
    remarks: Iterable[str] = (),
    *,
    hydrogens: bool = True,
) -> str:
    """Return the text that :func:`save` writes, in the format of the suffix."""
    models = [structure] if isinstance(structure, Structure) else list(structure)
    format_ = SUFFIXES[suffix.lower()]
    if format_ == "PDB" and (short := short_names(models)):
        remarks = [*remarks, *map(_short_name, *zip(*short.items(), strict=True))]
        models = [_with_names(model, short) for model in models]
    out = as_gemmi(models)
    update_entities(out, complete=format_ == "mmCIF")
    if not hydrogens:
        out.remove_hydrogens()
    repairs = dict.fromkeys(str(repair) for model in models for repair in model.repairs)
    return _WRITERS[format_](out, models, remarks, repairs)


def short_names(structures: Iterable[Structure]) -> dict[str, str]:
    """Three-letter names in a PDB file of components with longer names."""
    used = {str(name) for s in structures for name in s.residue_name_in_file}
    short: dict[str, str] = {}
    for name in sorted(name for name in used if len(name) > _PDB_NAME):
        tried = (f"{name[:k]}{n or ''}" for n in range(1000) for k in [_PDB_NAME - len(f"{n or ''}")])
        short[name] = next(code for code in tried if code not in used)
        used.add(short[name])
    return short


def _short_name(name: str, short: str) -> str:
    return f"component {name} is called {short} here: PDB files have names of three letters"


def _with_names(structure: Structure, names: Mapping[str, str]) -> Structure:
    topology = deepcopy(structure.topology)
    for residue in topology.residues():
        residue.name = names.get(residue.name, residue.name)
    header = structure.header
    # No source has the chemistry of a bonded component under the short name.
    for name in sorted(_without_template(structure) & names.keys()):
        header = records.with_component(header, heavy_rows(names[name], of_residue(name, structure.header)))
    return replace(structure, topology=topology, header=header)


def check_format(path: Path) -> None:
    """Refuse an unknown suffix."""
    if format_of(path) not in _WRITERS:
        suffix = split_name(path)[1]
        raise StructureError(f"{path}: unknown suffix {suffix!r}; use {' or '.join(SUFFIXES)}")


def check_fits(structure: Structure, path: Path) -> list[str]:
    """Refuse a structure that does not fit the columns of a PDB file. It would be truncated or misread."""
    if format_of(path) != "PDB":
        now = (label for label, _ in _labels(structure)[0])
        pairs = dict.fromkeys(zip((label for label, _ in structure.residue_label), now, strict=False))
        # Label ids with an x are from gemmi, if the file has none.
        changed = [f"{old} is {new}" for old, new in pairs if old not in ("", new) and old[:-1] != f"{new}x"]
        return [f"{path}: label ids that differ from the file's: {abridge(changed, 6)}"] if changed else []
    for field, values, width in (
        ("chain id", structure.residue_chain, 1),
        ("residue number", structure.residue_number, 4),
        ("atom name", structure.atom_name, 4),
        ("formal charge", np.abs(structure.formal_charge).astype(str), 1),
    ):
        long = [str(value) for value in values if len(value) > width]
        if long:
            raise StructureError(f"{path}: {field} {long[0]!r} does not fit a PDB file; write .cif instead")
    if structure.n_atoms + structure.topology.getNumChains() > _PDB_SERIALS:
        raise StructureError(f"{path}: {structure.n_atoms} atoms do not fit a PDB file; write .cif instead")
    x = ANGSTROM_PER_NM * structure.positions
    far = np.flatnonzero(((x < _PDB_LOWEST) | (x > _PDB_HIGHEST)).any(axis=1))
    if len(far):
        raise StructureError(
            f"{path}: the coordinates of {structure.describe(int(far[0]))} do not fit a PDB file; write .cif"
        )
    return [f"{path}: {_short_name(*names)}" for names in short_names([structure]).items()]


def common_suffix(structures: Iterable[Structure]) -> str:
    """Return ``.pdb`` if all structures fit that format under their names, else ``.cif``."""
    try:
        changed = [line for structure in structures for line in check_fits(structure, Path("x.pdb"))]
    except StructureError:
        return ".cif"
    return ".cif" if changed else ".pdb"


def as_gemmi(structures: Sequence[Structure]) -> gemmi.Structure:
    """Structures of one source as the models of a gemmi Structure, atoms in the same order."""
    first = structures[0]
    out = with_header(first.header)
    out.name = first.name
    numbers = [s.model_number for s in structures]
    if len(set(numbers)) < len(numbers):
        numbers = list(range(1, len(numbers) + 1))
    for number, structure in zip(numbers, structures, strict=True):
        labels, renamed = _labels(structure)
        out.add_model(_model(structure, number, labels))
    for entity in out.entities:
        entity.subchains = [new for old in entity.subchains for new in sorted(renamed.get(old, {old}))]
    out.connections = gemmi.ConnectionList(_connections(first, out.connections))
    numbered = zip(structures, numbers, strict=True)
    out.cispeps = [peptide for model in numbered for peptide in _cis_peptides(*model)]
    return out


def _model(structure: Structure, number: int, labels: Sequence[Label]) -> gemmi.Model:
    model, strands = gemmi.Model(number), _in_strands(structure)
    for chain in structure.topology.chains():
        # Parts of a broken chain share its id. gemmi ends each part.
        gemmi_chain = gemmi.Chain(chain.id)
        for residue in chain.residues():
            new_residue = gemmi.Residue()
            new_residue.name = str(structure.residue_name_in_file[residue.index])
            new_residue.seqid = _seqid(structure, residue.index)
            is_hetero = structure.kept[next(residue.atoms()).index]
            is_polymer = not is_hetero or residue.name in NUCLEOTIDES or residue.index in strands
            new_residue.entity_type = gemmi.EntityType.Polymer if is_polymer else gemmi.EntityType.NonPolymer
            new_residue.subchain, new_residue.label_seq = labels[residue.index]
            for atom in residue.atoms():
                new_atom = gemmi.Atom()
                new_atom.name, new_atom.element = atom.name, gemmi.Element(atom.element.symbol)
                new_atom.occ = float(structure.occupancy[atom.index])
                new_atom.b_iso = float(structure.b_factor[atom.index])
                new_atom.charge = int(structure.formal_charge[atom.index])
                new_atom.pos = gemmi.Position(*(ANGSTROM_PER_NM * structure.positions[atom.index]))
                new_residue.add_atom(new_atom)
            gemmi_chain.add_residue(new_residue)
        model.add_chain(gemmi_chain)
    return model


def _in_strands(structure: Structure) -> set[int]:
    """Residues with phosphodiester bonds to other residues, whatever their names."""
    ends = np.vstack([structure.bonds, structure.links])
    names, residue = structure.atom_name[ends], structure.atom_residue[ends]
    along = (names == ["O3'", "P"]).all(axis=1) | (names == ["P", "O3'"]).all(axis=1)
    return {*residue[along & (residue[:, 0] != residue[:, 1])].ravel().tolist()}


def _labels(structure: Structure) -> tuple[list[Label], dict[str, set[str]]]:
    """Label ids of each residue, and renamed ids. Without ids in the file, parts of chains have their own."""
    filed = structure.residue_label or (NO_LABEL,) * structure.n_residues
    hetero = {int(r) for r in structure.atom_residue[structure.kept]}
    chains = [str(chain_id) for chain_id in structure.residue_chain]
    of_chain: dict[str, set[str]] = {}
    parts: dict[str, list[int]] = {}
    for r, (chain_id, part) in enumerate(zip(chains, structure.residue_chain_index.tolist(), strict=True)):
        if r not in hetero:
            of_chain.setdefault(chain_id, set()).add(filed[r][0])
            if part not in parts.setdefault(chain_id, []):
                parts[chain_id].append(part)
    labels: list[Label] = []
    renamed: dict[str, set[str]] = {}
    known_names = {name for name, _ in filed}
    n_parts = Counter(name for name, _ in {*zip(chains, structure.residue_chain_index.tolist(), strict=True)})
    blank = next(letter for letter in chained(ascii_uppercase, map(str, count())) if letter not in n_parts)
    for r, (chain_id, part) in enumerate(zip(chains, structure.residue_chain_index.tolist(), strict=True)):
        name, place = filed[r]
        if r in hetero:
            # OpenMM reads label ids as chain ids if there are as many of both.
            is_alone = name in ("", f"{chain_id}x1", f"{chain_id}xp") and chain_id and n_parts[chain_id] == 1
            is_alone = is_alone and chain_id not in known_names
            labels.append((chain_id if is_alone else name or f"{chain_id}x{part}", place))
            continue
        is_one = len(of_chain[chain_id]) == 1
        if is_one and name not in ("", f"{chain_id}xp"):
            labels.append(filed[r])
            continue
        number = parts[chain_id].index(part) + 1
        new = (chain_id or blank) + (str(number) if number > 1 else "")
        labels.append((new, place if is_one else None))
        if is_one:
            renamed.setdefault(name, set()).add(new)
    return labels, renamed


def _seqid(structure: Structure, residue: int) -> gemmi.SeqId:
    code = str(structure.residue_insertion_code[residue])
    return gemmi.SeqId(int(structure.residue_number[residue]), code or " ")


def _address(structure: Structure, atom: int) -> gemmi.AtomAddress:
    residue = int(structure.atom_residue[atom])
    return gemmi.AtomAddress(
        str(structure.residue_chain[residue]), _seqid(structure, residue),
        str(structure.residue_name_in_file[residue]), str(structure.atom_name[atom]),
    )  # fmt: skip


def _connections(structure: Structure, stated: Iterable[gemmi.Connection]) -> Iterator[gemmi.Connection]:
    """Bonds between residues, without bonds along a chain, and stated bonds between hetero molecules."""
    at: dict[tuple[str, str, str], int] = {}
    for k, (r, name) in enumerate(zip(structure.atom_residue.tolist(), structure.atom_name, strict=True)):
        at.setdefault((str(structure.residue_chain[r]), str(_seqid(structure, r)).strip(), str(name)), k)
    links: dict[tuple[int, int], gemmi.Connection] = {}
    for link in stated:
        ends = [at.get(address_of(end)) for end in (link.partner1, link.partner2)]
        if None not in ends and ends[0] != ends[1]:
            first, second = sorted(end for end in ends if end is not None)
            links.setdefault((first, second), link)
    pairs = [(i, j) for i, j in structure.bonds[_is_link(structure)].tolist()]
    hetero_pairs = {pair for pair in links if structure.kept[list(pair)].all()} - {*pairs}
    for n, pair in enumerate([*pairs, *sorted(hetero_pairs)], 1):
        link = links.get(pair) or gemmi.Connection()
        if pair not in links:
            link.type = _link_type(structure, pair)
        link.partner1, link.partner2 = (_address(structure, atom) for atom in pair)
        link.name = f"{_LINK_NAMES.get(link.type, 'link')}{n}"
        yield link


def _is_link(structure: Structure) -> NDArray[np.bool_]:
    """(nb,) bool: bonds of LINK records: between residues, except along chains of standard residues."""
    ends = structure.atom_residue[structure.bonds]
    standard = np.array([_is_standard(str(name)) for name in structure.residue_name_in_file])
    first, second = structure.residue_chain[ends].T
    is_along = (np.diff(ends)[:, 0] == 1) & (first == second) & standard[ends].all(axis=1)
    names = np.sort(structure.atom_name[structure.bonds], axis=1)
    is_joint = (names == ["C", "N"]).all(axis=1) | (names == ["O3'", "P"]).all(axis=1)
    return np.asarray((ends[:, 0] != ends[:, 1]) & ~(is_along & is_joint))


def _is_standard(component: str) -> bool:
    return bool(gemmi.find_tabulated_residue(component).is_standard())


def _link_type(structure: Structure, pair: tuple[int, int]) -> gemmi.ConnectionType:
    if any(is_metal(str(structure.atom_element[end])) for end in pair):
        return gemmi.ConnectionType.MetalC
    is_disulfide = all(structure.atom_name[end] == "SG" and not structure.kept[end] for end in pair)
    return gemmi.ConnectionType.Disulf if is_disulfide else gemmi.ConnectionType.Covale


def _cis_peptides(structure: Structure, number: int) -> Iterator[gemmi.CisPep]:
    name, residue = structure.atom_name, structure.atom_residue
    alpha = {int(residue[k]): int(k) for k in structure.alpha_carbons}
    for first, second in structure.bonds.tolist():
        pair = {str(name[first]): first, str(name[second]): second}
        if pair.keys() != {"C", "N"} or residue[first] == residue[second]:
            continue
        c, n = pair["C"], pair["N"]
        if int(residue[c]) not in alpha or int(residue[n]) not in alpha:
            continue
        at = [alpha[int(residue[c])], c, n, alpha[int(residue[n])]]
        places = (gemmi.Position(*structure.positions[k]) for k in at)
        omega = float(np.degrees(gemmi.calculate_dihedral(*places)))
        if abs(omega) < _CIS:
            peptide = gemmi.CisPep()
            peptide.partner_c, peptide.partner_n = _address(structure, c), _address(structure, n)
            peptide.model_num, peptide.reported_angle = number, omega
            yield peptide


def _merge_parts(out: gemmi.Structure) -> gemmi.Structure:
    """Return a copy that joins the parts of a broken chain, which share sequence and label ids."""
    merged = out.clone()
    merged.merge_chain_parts()
    return merged


def _mmcif(out: gemmi.Structure, models: Sequence[Structure], remarks: _Lines, repairs: _Lines) -> str:
    head, atoms = gemmi.MmcifOutputGroups(True), gemmi.MmcifOutputGroups(False)
    head.atoms, atoms.atoms, atoms.group_pdb, atoms.auth_all = False, True, True, True
    # With a cell of 1 angstrom, the placeholder, some programs would treat the chain as periodic.
    head.cell = head.symmetry = out.cell.is_crystal()
    document = _merge_parts(out).make_mmcif_document(head)
    block = document.sole_block()
    quote_names(block)
    chemistry = _chemistry(models[0])
    written = [(residue.subchain, residue.label_seq) for chain in out[0] for residue in chain]
    # Written label ids, by label ids of the file. A chain from a sequence has none.
    filed = models[0].residue_label
    labels = dict(zip(filed, written, strict=bool(filed)))
    about = records.cif_rows(models[0].header, out, labels, chemistry)
    records.put(block, _with_bonds(about, models[0], {row["comp_id"] for row in chemistry.get(_BONDS, ())}))
    records.put(block, {records.SPRINGS: records.spring_rows(_springs(models))})
    for category, lines in (("provenance", remarks), ("repair", repairs)):
        loop = block.init_loop(f"_protochain_{category}.", ["ordinal", "text"])
        for i, line in enumerate(lines, 1):
            loop.add_row([str(i), gemmi.cif.quote(line)])
    out.update_mmcif_block(block, atoms)
    for row in block.find("_atom_site.", ["B_iso_or_equiv"]):
        if row[0] == "NaN":
            row[0] = "?"
    # As in the PDB archive, every category ends with '#', so that a truncated file can be recognised.
    return str(document.as_string(gemmi.cif.WriteOptions(gemmi.cif.Style.Pdbx)))


def _pdb(out: gemmi.Structure, models: Sequence[Structure], remarks: _Lines, repairs: _Lines) -> str:
    chemistry = _chemistry(models[0])
    drawn = {row["comp_id"] for row in chemistry.get(_BONDS, ())}
    bonded = _without_template(models[0]) - drawn
    before, names, complete = records.pdb_lines(models[0].header, out, chemistry, bonded)
    stated = [
        f"REMARK   3 {line}"
        for text in (*remarks, *repairs)
        for line in textwrap.wrap(text, _REMARK_WIDTH, subsequent_indent="  ") or [""]
    ]
    lines = [*before, *stated, *records.spring_remarks(_springs(models))]
    out.raw_remarks = sorted(lines, key=lambda line: int(line[6:10]) if line.startswith("REMARK") else 0)
    order = records.orders(models[0].header, chemistry)
    # Without a remark the dictionary has the orders of a component.
    _connect(out, models[0], {at: n for at, n in order.items() if at[0] not in bonded or at[0] in complete})
    head = gemmi.PdbWriteOptions(
        atom_records=False, end_record=False, cryst1_record=out.cell.is_crystal(), cispep_records=True
    )
    atoms = gemmi.PdbWriteOptions(minimal=True, cryst1_record=False, end_record=True, conect_records=True)
    # Columns 61-66 are blank if the B factor is unknown.
    written = str(out.make_pdb_string(atoms)).replace("   NaN          ", " " * 16)
    return records.with_names(str(_merge_parts(out).make_pdb_string(head)), names) + written


def _connect(out: gemmi.Structure, structure: Structure, order: Mapping[tuple[str, str, str], int]) -> None:
    """Add CONECT records for bonds between residues, and in components that programs may not know."""
    out.assign_serial_numbers(numbered_ter=True)
    residues = [residue for chain in out[0] for residue in chain]
    serial = [{atom.name: atom.serial for atom in residue} for residue in residues]
    drawn = [
        r.entity_type == gemmi.EntityType.NonPolymer
        or (r.entity_type == gemmi.EntityType.Polymer and not _is_standard(r.name))
        for r in residues
    ]
    # Bonded molecules with written chemistry have the orders of the bonded state, in agreement with their
    # hydrogens. Other molecules have the orders of the dictionary.
    bonded, stated = _in_fragments(structure), {component for component, *_ in order}
    for (i, j), is_link in zip(structure.bonds.tolist(), _is_link(structure).tolist(), strict=True):
        first, second = (int(structure.atom_residue[end]) for end in (i, j))
        names = str(structure.atom_name[i]), str(structure.atom_name[j])
        ends = serial[first].get(names[0]), serial[second].get(names[1])
        # Hydrogens may be missing.
        if ends[0] and ends[1] and (is_link or (first == second and drawn[first])):
            component = str(structure.residue_name[first])
            bond_order = order.get((component, min(names), max(names)), 1)
            if component in stated:
                bond_order = bonded.get((i, j), bond_order)
            out.add_conect(ends[0], ends[1], 1 if is_link else bond_order)


def _without_template(structure: Structure) -> set[str]:
    """Names of the residues that no template fits."""
    atoms = [k for fragment in structure.fragments for k in fragment.atoms.tolist() if k >= 0]
    return {str(structure.residue_name[structure.atom_residue[k]]) for k in atoms}


def _in_fragments(structure: Structure) -> dict[tuple[int, int], int]:
    """Order of each bond of the residues that no template fits, by the atoms of the structure."""
    bond_orders: dict[tuple[int, int], int] = {}
    for part in structure.fragments:
        molecule = part.ligand.molecule
        for pair, order in zip(part.atoms[molecule.bonds].tolist(), molecule.orders.tolist(), strict=True):
            bond_orders[min(pair), max(pair)] = order
    return bond_orders


def _chemistry(structure: Structure) -> dict[str, records.Rows]:
    """Tables of the ligands of known chemistry, once for each component."""
    tables: dict[str, records.Rows] = {}
    components: set[str] = set()
    for ligand in structure.ligands:
        component = str(structure.residue_name[structure.atom_residue[ligand.atoms[0]]])
        if component not in components:
            components.add(component)
            names = tuple(structure.atom_name[ligand.atoms].tolist())
            for category, table in rows(component, replace(ligand.ligand.molecule, names=names)).items():
                tables.setdefault(category, []).extend(table)
    return tables


def _with_bonds(
    about: Mapping[str, records.Rows], structure: Structure, complete: set[str]
) -> dict[str, records.Rows]:
    """Add bonds and charges of the mobile components, unless the tables are complete.

    OpenMM reads no other bonds, except in standard residues. Heavy atoms are from the free component, as in
    the tables of the PDB. Hydrogens are from the structure. PyMOL requires the bonds of standard components
    if a file has bonds of other components.
    """
    # Bonds within the mobile components.
    names = structure.residue_name_in_file[structure.atom_residue]
    inside = np.diff(structure.atom_residue[structure.bonds])[:, 0] == 0
    inside &= ~structure.coordination & ~structure.obstacle[structure.bonds].any(axis=1)
    bonds = structure.bonds[inside]
    ends = structure.atom_name[bonds].T.tolist()
    pairs = sorted({*zip(names[bonds[:, 0]].tolist(), *ends, strict=True)})
    light = structure.atom_element == "H"
    atoms, table = (list(about.get(category, ())) for category in (_ATOMS, _BONDS))
    complete = complete | {
        row["comp_id"] for row in table if _is_standard(gemmi.cif.as_string(row["comp_id"]))
    }
    groups = {name: [*map(itemgetter(1, 2), group)] for name, group in groupby(pairs, key=itemgetter(0))}
    for name in sorted(groups, key=_is_standard):
        comp = gemmi.cif.quote(name)
        if comp in complete or (_is_standard(name) and not table):
            continue
        try:
            heavy = heavy_rows(name, from_dictionary(name))
        except ProtochainError:
            heavy = {}
        is_stated = any(row["comp_id"] == comp for row in atoms)
        if not (heavy or is_stated):
            continue
        # Names of hydrogens depend on the pH and on bonds to other residues.
        hydrogens = {gemmi.cif.quote(atom) for atom in structure.atom_name[light & (names == name)].tolist()}
        stated = [row for row in atoms if row["comp_id"] == comp]
        hydrogens |= {row.get("atom_id", "?") for row in stated if row.get("type_symbol") in ("H", "D")}
        atoms = [row for row in atoms if row["comp_id"] != comp or row.get("atom_id", "?") not in hydrogens]
        table = [row for row in table if row["comp_id"] != comp or (is_stated and not _ends(row) & hydrogens)]
        if not (is_stated or _is_standard(name)):
            atoms, table = atoms + heavy[_ATOMS], table + heavy[_BONDS]
        # Bonds of the structure that the tables lack, with orders of the dictionary.
        orders = {_ends(row): row["value_order"] for row in heavy.get(_BONDS, ())}
        drawn = {_ends(row) for row in table if row["comp_id"] == comp}
        for first, second in (map(gemmi.cif.quote, pair) for pair in groups[name]):
            pair = frozenset((first, second))
            if pair not in drawn:
                order = orders.get(pair, ORDERS[1])
                table.append({"comp_id": comp, "atom_id_1": first, "atom_id_2": second, "value_order": order})
    return {**about, _ATOMS: atoms, _BONDS: table}


def _ends(row: Mapping[str, str]) -> frozenset[str]:
    return frozenset(row.get(f"atom_id_{k}", "?") for k in (1, 2))


def _springs(models: Sequence[Structure]) -> list[records.Spring]:
    """Springs of all models, or none if they differ."""
    first, *later = (records.springs_of(model) for model in models)
    return first if all(springs == first for springs in later) else []


_WRITERS = {"PDB": _pdb, "mmCIF": _mmcif}
