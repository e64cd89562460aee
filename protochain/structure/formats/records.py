"""Metadata of a file that gemmi does not copy: authors, terms of use, confidence, components, springs.

The header of a structure is mmCIF text with these categories. PDB records are converted to the equivalent
categories. Rows about residues and molecules that are absent from the structure are skipped. Springs between
the protein and hetero molecules are restored from the rows, or from remarks of a PDB file.
"""

import textwrap
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from math import isfinite

import gemmi
import numpy as np

from protochain.core.graph import components
from protochain.ligands import tables
from protochain.structure.molecule.header import Label
from protochain.structure.molecule.member import Address
from protochain.structure.molecule.model import Structure

Rows = list[dict[str, str]]
"""Rows of a category. Values are raw, with quotes."""
Spring = tuple[tuple[Address, ...], float, float]
"""Atoms, rest (nm, rad), stiffness (kJ/mol/nm^2, kJ/mol/rad^2). One atom alone marks a fixed molecule."""

SPRINGS = "_protochain_tie."
_SPRING_REMARK = "REMARK 980"  # Remark number that the PDB does not use.
_SPRING_ENDS = ("auth_asym_id_{}", "auth_seq_id_{}", "PDB_ins_code_{}", "auth_atom_id_{}")
DIGITS = 9
"""Decimals of nm and rad in a remark. All springs are rounded to them, so that reading restores them."""
_START, _WIDTH = 11, 12
"""Columns of a remark: chain, residue number, insertion code and name of three atoms, rest, stiffness."""

_MODIFIED = "_pdbx_struct_mod_residue."
"""Modified residues, which gemmi transfers as ``Structure.mod_residues``."""
_CATEGORIES = (
    "_chem_comp.", "_chem_comp_atom.", "_chem_comp_bond.", "_citation.", "_citation_author.",
    "_pdbx_data_usage.", _MODIFIED, "_database_pdb_remark.", SPRINGS,
    tables.CATEGORY,
)  # fmt: skip
_MODEL_CATEGORIES = ("_ma_", "_audit_author.", "_audit_conform.", "_software.")
"""Categories copied for predicted models only. For experiments they describe the original positions."""
_COMPONENT = {
    "_chem_comp.": "id", "_chem_comp_atom.": "comp_id", "_chem_comp_bond.": "comp_id",
    tables.CATEGORY: "comp_id",
}  # fmt: skip
_NO_VALUE = (".", "?")
_TERMS = 1  # Number of the PDB remark with terms of use, as in the AlphaFold database.
_REMARK_WIDTH, _NAME_WIDTH, _TEXT_WIDTH = 68, 55, 60
_BEFORE_NAMES = ("HELIX", "SHEET", "SSBOND", "LINK", "CISPEP", "CRYST1", "ORIGX", "SCALE", "MTRIX", "MODEL")
_KINDS = {
    gemmi.ResidueKind.AA: "L-peptide linking", gemmi.ResidueKind.AAD: "D-peptide linking",
    gemmi.ResidueKind.PAA: "L-peptide linking", gemmi.ResidueKind.MAA: "L-peptide linking",
    gemmi.ResidueKind.RNA: "RNA linking", gemmi.ResidueKind.DNA: "DNA linking",
    gemmi.ResidueKind.PYR: "saccharide", gemmi.ResidueKind.KET: "saccharide",
}  # fmt: skip
_READ = ("HETNAM", "REMARK", "JRNL", "PARENT", "PFRMAT")
_PLDDT = [{"id": "1", "name": "pLDDT", "type": "pLDDT", "mode": "local"}]
"""B factors of ESMFold and OpenFold, which write PARENT records. CASP models also have PFRMAT records."""
_JOURNAL = {
    "TITL": "title", "REF": "journal_full", "PMID": "pdbx_database_id_PubMed", "DOI": "pdbx_database_id_DOI",
}  # fmt: skip
"""Items of a citation by the names of JRNL records."""
_ORDERS = {1: "sing", 2: "doub", 3: "trip"}


def cif_header(block: gemmi.cif.Block) -> str:
    """Return the mmCIF categories that are copied to written files, as mmCIF text."""
    names = block.get_mmcif_category_names()
    prefixes = _CATEGORIES + (_MODEL_CATEGORIES if any(name.startswith("_ma_") for name in names) else ())
    return _text({name: _rows(block, name) for name in names if name.lower().startswith(prefixes)})


def pdb_header(text: str, structure: gemmi.Structure) -> str:
    """Return the PDB records that are copied to written files, as mmCIF text."""
    lines: dict[str, list[str]] = {}
    for line in text.splitlines():
        if line.startswith(("ATOM", "HETATM", "MODEL")):
            break
        if not line.startswith(_READ):
            continue
        # mmCIF has no control characters.
        plain = line if line.isprintable() else "".join(c if c.isprintable() else " " for c in line)
        lines.setdefault(plain[:6].strip(), []).append(plain.ljust(80))
    names: dict[str, list[str]] = {}
    for line in lines.get("HETNAM", ()):
        names.setdefault(line[11:14].strip(), []).append(line[15:70].strip())
    remarks = [line[10:].strip() for line in lines.get("REMARK", ()) if line[6:10].strip() == f"{_TERMS}"]
    mods = [
        {"id": f"{k}", "auth_asym_id": mod.chain_name or "?", "auth_seq_id": f"{mod.res_id.seqid.num}",
         "PDB_ins_code": mod.res_id.seqid.icode.strip() or "?", "label_comp_id": mod.res_id.name,
         "auth_comp_id": mod.res_id.name, "parent_comp_id": _quote(mod.parent_comp_id),
         "details": _quote(mod.details)}
        for k, mod in enumerate(structure.mod_residues, 1)
        if mod.res_id.seqid.num is not None
    ]  # fmt: skip
    chemistry = tables.of_remarks(lines.get("REMARK", ()))
    return _text(
        {
            "_chem_comp.": [
                {"id": _quote(name), "name": _quote(_join_lines(stated))} for name, stated in names.items()
            ],
            **chemistry,
            "_chem_comp_bond.": [*_conect_bonds(structure, chemistry), *chemistry["_chem_comp_bond."]],
            _MODIFIED: mods,
            "_database_PDB_remark.": [{"id": f"{_TERMS}", "text": _quote("\n".join(remarks))}]
            if remarks
            else [],
            **_journal(lines.get("JRNL", ())),
            SPRINGS: spring_rows(_springs_of_remarks(lines.get("REMARK", ()))),
            "_ma_qa_metric.": _PLDDT if "PARENT" in lines and "PFRMAT" not in lines else [],
        }
    )


def cif_rows(
    header: str, out: gemmi.Structure, label: Mapping[Label, Label], ligands: Mapping[str, Rows]
) -> dict[str, Rows]:
    """Return the categories of a header with the present names, without rows about absent molecules."""
    names = {residue.name: residue for model in out for chain in model for residue in chain}
    renamer = _RowRenamer(out, label, names)
    categories = _merge(ligands, _categories(header))
    result = {}
    for category, entries in categories.items():
        if category not in (SPRINGS, _MODIFIED):
            rows = [new_row for row in entries if (new_row := renamer.rename_row(category, row))]
            if rows:
                result[category] = [*{tuple(row.items()): row for row in rows}.values()]  # Each once.
    sequences = (monomer for entity in out.entities for monomer in entity.full_sequence)
    unseen = {name: gemmi.Residue() for monomer in sequences for name in monomer.split(",")}
    return result | {"_chem_comp.": list(_components(result.get("_chem_comp.", []), unseen | names))}


def _merge(ligands: Mapping[str, Rows], categories: Mapping[str, Rows]) -> dict[str, Rows]:
    """Return categories in which the chemistry of ligands replaces other rows of the same components."""
    replaced = {row["comp_id"] for rows in ligands.values() for row in rows}
    result = {
        category: [row for row in rows if row.get("comp_id") not in replaced] if category in ligands else rows
        for category, rows in categories.items()
    }
    return result | {category: result.get(category, []) + rows for category, rows in ligands.items()}


def with_component(header: str, ligand: Mapping[str, Rows]) -> str:
    """Return a header in which the given tables of a component replace other tables of it."""
    return _text(_merge(ligand, _categories(header)))


def pdb_lines(
    header: str, out: gemmi.Structure, ligands: Mapping[str, Rows], bonded: Collection[str]
) -> tuple[list[str], list[str], set[str]]:
    """Return PDB records of citation, terms and ligand tables, and HETNAM records of ligand names.

    The third value is the set of components in ``bonded`` that have ligand tables in remarks.
    """
    categories = cif_rows(header, out, {}, ligands)
    citation = [
        f"JRNL        {name:<4}{k if k > 1 else '':>2} {line}"
        for name, text in _citation_records(categories)
        for k, line in enumerate(textwrap.wrap(text, _TEXT_WIDTH), 1)
    ]
    terms = [
        line for r in categories.get("_database_PDB_remark.", []) for line in _plain(r["text"]).split("\n")
    ]
    for row in categories.get("_pdbx_data_usage.", []):
        words = [_value(row, item) for item in ("type", "details", "url", "name")]
        terms += textwrap.wrap(" ".join(filter(None, words)), _REMARK_WIDTH)
    het = {
        residue.name for model in out for chain in model for residue in chain
        if residue.entity_type == gemmi.EntityType.NonPolymer
    }  # fmt: skip
    names = [
        f"HETNAM  {k if k > 1 else '':>2} {_plain(row['id']):>3} {line}"
        for row in categories["_chem_comp."]
        if _plain(row["id"]) in het and _has_value(row, "name")
        for k, line in enumerate(textwrap.wrap(_plain(row["name"]), _NAME_WIDTH), 1)
    ]
    stated = [f"REMARK {_TERMS:3} {line}".rstrip() for line in terms]
    components = {_plain(row["comp_id"]) for row in categories.get("_chem_comp_atom.", [])} & {*bonded}
    return [*citation, *stated, *tables.as_remarks(categories, components)], names, components


def orders(header: str, ligands: Mapping[str, Rows]) -> dict[tuple[str, str, str], int]:
    """Return bond orders of components, by component and the two atom names in alphabetic order."""
    order_of = {name: order for order, name in _ORDERS.items()}
    result = {}
    for row in _merge(ligands, _categories(header)).get("_chem_comp_bond.", []):
        first, second = sorted(_plain(row.get(f"atom_id_{k}", "")) for k in (1, 2))
        order = _plain(row.get("value_order", "")).lower()
        result[_plain(row["comp_id"]), first, second] = order_of.get(order[:4], 1)
    return result


def with_names(head: str, names: Sequence[str]) -> str:
    """Return the head of a PDB file with the HETNAM records inserted."""
    lines = head.splitlines()
    at = next((k for k, line in enumerate(lines) if line.startswith(_BEFORE_NAMES)), len(lines))
    return "".join(f"{line}\n" for line in (*lines[:at], *names, *lines[at:]))


def put(block: gemmi.cif.Block, categories: Mapping[str, Rows]) -> None:
    """Write categories into a block, replacing categories of the same name."""
    for category, rows in categories.items():
        if rows:
            items = dict.fromkeys(item for row in rows for item in row)
            columns = {item: [row.get(item, "?") for row in rows] for item in items}
            block.set_mmcif_category(category, columns, raw=True)


class _RowRenamer:
    """Translation of rows from the labels of the input file to the labels of the structure written."""

    def __init__(self, out: gemmi.Structure, label: Mapping[Label, Label], names: Collection[str]) -> None:
        self.names, self.entities = names, {entity.name for entity in out.entities}
        self.models = {f"{model.num}" for model in out}
        now = {
            (residue.subchain, residue.label_seq): residue.name
            for model in out for chain in model for residue in chain
        }  # fmt: skip
        self.residue: dict[tuple[str, str], tuple[str, str, str]] = {}
        self.asym: dict[str, str] = {}
        for (asym, seq), new in label.items():
            if new in now:
                self.asym.setdefault(asym, new[0])
                place = (new[0], "." if new[1] is None else f"{new[1]}", now[new])
                self.residue.setdefault((asym, "." if seq is None else f"{seq}"), place)

    def rename_row(self, category: str, row: dict[str, str]) -> dict[str, str] | None:
        """Return a row with the present names, or None if its residue or molecule is absent."""
        if category in _COMPONENT:
            return row if _plain(row.get(_COMPONENT[category], "?")) in self.names else None
        row = dict(row)
        for end in ("", "_1", "_2"):
            if f"label_asym_id{end}" in row:
                seq = row.get(f"label_seq_id{end}", ".")
                asym = _plain(row[f"label_asym_id{end}"])
                key = (asym, "." if seq in _NO_VALUE else seq)
                # Predictors number ligands and ions, which have no place in a sequence.
                now = self.residue.get(key) or self.residue.get((asym, "."))
                if now is None:
                    return None
                values = dict(zip(("asym_id", "seq_id", "comp_id"), now, strict=True))
                if key not in self.residue:
                    del values["seq_id"]
                for item, value in values.items():
                    if f"label_{item}{end}" in row:
                        row[f"label_{item}{end}"] = value if value == "." else _quote(value)
        for item, value in row.items():
            if value in _NO_VALUE:
                continue
            if item in ("asym_id", "target_asym_id"):
                if _plain(value) not in self.asym:
                    return None
                row[item] = _quote(self.asym[_plain(value)])
            is_absent = item in ("entity_id", "target_entity_id") and _plain(value) not in self.entities
            if is_absent or (item == "model_id" and _plain(value) not in self.models):
                return None
        return row


def _components(rows: Rows, names: Mapping[str, gemmi.Residue]) -> Iterator[dict[str, str]]:
    """Yield rows of ``_chem_comp``, from the file, or else with a type from gemmi's tables or the sugar."""
    row_of = {_plain(row["id"]): row for row in rows}
    for name in sorted(names):
        row = row_of.get(name, {})
        kind = row["type"] if _has_value(row, "type") else _quote(component_type(name, names[name]))
        yield {"id": _quote(name), "type": kind, **{k: v for k, v in row.items() if k not in ("id", "type")}}


def component_type(name: str, residue: gemmi.Residue) -> str:
    """Return the type of a component, a value of ``_chem_comp.type`` of the PDB's dictionary."""
    if name == "GLY":
        return "peptide linking"
    info = gemmi.find_tabulated_residue(name)
    if not info.found() and residue.entity_type == gemmi.EntityType.Polymer and residue.find_atom("C1'", "*"):
        return "RNA linking" if residue.find_atom("O2'", "*") else "DNA linking"
    return _KINDS.get(info.kind, "non-polymer")


def _conect_bonds(structure: gemmi.Structure, stated: Mapping[str, Rows]) -> Iterator[dict[str, str]]:
    """Yield bonds of components with repeated CONECT records (bond orders), unless remarks have the bonds."""
    with_tables = tables.complete_components(stated[tables.CATEGORY])
    complete = {_plain(row["comp_id"]) for row in stated["_chem_comp_bond."]}
    at = {
        place.atom.serial: (place.residue.name, str(place.residue.seqid), place.chain.name, place.atom.name)
        for place in structure[0].all()
    } if len(structure) else {}  # fmt: skip
    bond_orders: dict[str, dict[tuple[str, str], int]] = {}
    for serial, ends in structure.conect_map.items():
        for neighbour in dict.fromkeys(ends):
            if serial in at and neighbour in at and at[serial][:3] == at[neighbour][:3]:
                pair = (at[serial][3], at[neighbour][3])
                if pair[::-1] not in bond_orders.setdefault(at[serial][0], {}):
                    bond_orders[at[serial][0]].setdefault(pair, ends.count(neighbour))
    for name, bonds in bond_orders.items():
        if name not in complete and (name in with_tables or max(bonds.values()) > 1):
            for (first, second), order in bonds.items():
                yield {
                    "comp_id": _quote(name), "atom_id_1": _quote(first), "atom_id_2": _quote(second),
                    "value_order": _ORDERS.get(order, "?"),
                }  # fmt: skip


def _journal(lines: Iterable[str]) -> dict[str, Rows]:
    record_lines: dict[str, list[str]] = {}
    for line in lines:
        record_lines.setdefault(line[12:16].strip(), []).append(line[19:79].strip())
    if not record_lines:
        return {}
    text = {name: _join_lines(stated) for name, stated in record_lines.items()}
    items = {"id": "primary"} | {item: text.get(name, "") for name, item in _JOURNAL.items()}
    authors = [name.strip() for name in text.get("AUTH", "").split(",") if name.strip()]
    return {
        "_citation.": [{item: _quote(value) for item, value in items.items()}],
        "_citation_author.": [
            {"citation_id": "primary", "name": _quote(name), "ordinal": f"{k}"}
            for k, name in enumerate(authors, 1)
        ],
    }


def _citation_records(categories: Mapping[str, Rows]) -> Iterator[tuple[str, str]]:
    """Yield names and texts of the JRNL records of the primary citation, or of the first one."""
    rows = sorted(categories.get("_citation.", []), key=lambda row: _plain(row.get("id", "")) != "primary")
    for row in rows[:1]:
        authors = [
            # PDB format: J.Doe.
            "".join(reversed(_plain(author["name"]).split(", ", 1)))
            for author in categories.get("_citation_author.", [])
            if author.get("citation_id") == row.get("id") and _has_value(author, "name")
        ]  # fmt: skip
        journal = ("journal_full",) if _has_value(row, "journal_full") else (
            "journal_abbrev", "journal_volume", "page_first", "year")  # fmt: skip
        stated = {"AUTH": ",".join(authors)}
        stated |= {name: _value(row, item) for name, item in _JOURNAL.items()}
        stated["REF"] = " ".join(filter(None, (_value(row, item) for item in journal)))
        yield from ((name, text) for name, text in stated.items() if text)


def _categories(header: str) -> dict[str, Rows]:
    block = gemmi.cif.read_string(header).sole_block() if header else gemmi.cif.Block("")
    prefixes = (*_CATEGORIES, *_MODEL_CATEGORIES)
    names = [name for name in block.get_mmcif_category_names() if name.lower().startswith(prefixes)]
    return {name: _rows(block, name) for name in names}


def _rows(block: gemmi.cif.Block, category: str) -> Rows:
    columns = block.get_mmcif_category(category, raw=True)
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]


def _text(categories: Mapping[str, Rows]) -> str:
    document = gemmi.cif.Document()
    put(document.add_new_block("records"), categories)
    return str(document.as_string())


def _join_lines(lines: Iterable[str]) -> str:
    """Join the lines of a record by spaces, but without a space after a hyphen or comma."""
    text: list[str] = []
    for line in lines:
        space = text and not text[-1].endswith(("-", ","))
        text += [piece] if (piece := f"{' ' if space else ''}{line}") else []
    return "".join(text)


def _quote(value: str) -> str:
    # A semicolon at the start of a line would end a multi-line text.
    return str(gemmi.cif.quote(value.replace("\n;", "\n ;"))) if value else "?"


def _plain(value: str) -> str:
    return gemmi.cif.as_string(value)


def _has_value(row: Mapping[str, str], item: str) -> bool:
    return row.get(item, "?") not in _NO_VALUE


def _value(row: Mapping[str, str], item: str) -> str:
    return _plain(row[item]) if _has_value(row, item) else ""


def springs(records: str) -> Mapping[tuple[Address, ...], tuple[float, float]]:
    """Return rest and stiffness of the springs in a file, by their atoms."""
    block = gemmi.cif.read_string(records).sole_block() if SPRINGS in records else gemmi.cif.Block("")
    constants: dict[tuple[Address, ...], tuple[float, float]] = {}
    for raw in _rows(block, SPRINGS):
        row = {item: _plain(value) for item, value in raw.items()}
        ends = [[row.get(item.format(k), "") for item in _SPRING_ENDS] for k in (1, 2, 3)]
        atoms = tuple((chain, number + code, name) for chain, number, code, name in ends if name)
        r0, stiffness = (_number(row.get(item, "")) for item in ("rest", "stiffness"))
        if atoms and isfinite(r0) and isfinite(stiffness) and r0 >= 0.0 and stiffness >= 0.0:
            constants[atoms] = (r0, stiffness)
    return constants


def springs_of(structure: Structure) -> list[Spring]:
    """Return springs, and one atom of each fixed or free hetero molecule except waters and glycosides."""
    residue = structure.atom_residue

    def address(atom: int) -> Address:
        place = structure.residue(int(residue[atom]))
        return place.chain, place.number, str(structure.atom_name[atom])

    records: list[Spring] = [
        (tuple(address(atom) for atom in tie.atoms), tie.rest, tie.stiffness) for tie in structure.ties
    ]
    restrained = {int(residue[tie.atoms[1]]) for tie in structure.ties if len(tie.atoms) == 2}
    waters = set(np.flatnonzero(structure.residue_name == "HOH").tolist())
    molecule = components(structure.bonds[~structure.coordination], structure.n_atoms)
    glycosides = structure.mobile & np.isin(molecule, molecule[~structure.kept])
    is_candidate = structure.kept & (structure.atom_element != "H") & ~glycosides
    residues, first = np.unique(residue[is_candidate], return_index=True)
    for r, k in zip(residues.tolist(), np.flatnonzero(is_candidate)[first].tolist(), strict=True):
        if r not in waters and (structure.obstacle[k] or r not in restrained):
            records.append(((address(k),), 0.0, 0.0))
    return records


def spring_rows(records: Iterable[Spring]) -> Rows:
    """Return springs as rows of the mmCIF category."""
    items = [item.format(k) for k in (1, 2, 3) for item in _SPRING_ENDS]
    rows = []
    for n, (atoms, r0, stiffness) in enumerate(records, 1):
        row = {"ordinal": f"{n}", **dict.fromkeys(items, ".")}
        cells = [_quote(cell) for chain, number, name in atoms for cell in (chain, *_split(number), name)]
        row |= dict(zip(items, cells, strict=False))
        rows.append(row | {"rest": repr(r0), "stiffness": repr(stiffness)})
    return rows


def spring_remarks(records: Iterable[Spring]) -> list[str]:
    """Return springs as remarks of a PDB file."""
    remarks = []
    for atoms, r0, stiffness in records:
        cells = ""
        for chain, place, name in atoms:
            number, code = _split(place)
            cells += f"{chain:1}{number:>4}{code:1} {name:<4} "
        remarks.append(f"{_SPRING_REMARK} {cells.ljust(3 * _WIDTH)}{r0:12.{DIGITS}f}{stiffness:11.1f}")
    return remarks


def _springs_of_remarks(lines: Iterable[str]) -> Iterator[Spring]:
    for line in lines:
        if line.startswith(_SPRING_REMARK):
            cells = [line[_START + k * _WIDTH : _START + (k + 1) * _WIDTH] for k in range(3)]
            atoms = tuple(
                (cell[:1].strip(), cell[1:6].strip(), cell[7:11].strip()) for cell in cells if cell.strip()
            )
            r0, _, stiffness = line[_START + 3 * _WIDTH :].strip().partition(" ")
            yield atoms, _number(r0), _number(stiffness)


def _number(text: str) -> float:
    return float(gemmi.cif.as_number(text.strip() or "?", float("nan")))


def _split(number: str) -> tuple[str, str]:
    """Return a residue number and its insertion code."""
    code = number[-1:] if number[-1:].isalpha() else ""
    return number.removesuffix(code), code
