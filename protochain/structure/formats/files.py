"""Formats of structure files and their parsing by gemmi. Truncated and damaged files raise errors."""

import bz2
import codecs
import gzip
import io
import lzma
import re
import sys
import zlib
from collections.abc import Callable, Iterable
from functools import lru_cache
from math import isfinite
from pathlib import Path
from typing import Any, BinaryIO

import gemmi
import zstandard

from protochain.core.errors import StructureError
from protochain.core.markup import excerpt
from protochain.core.storage import regular
from protochain.core.timings import part
from protochain.structure.formats import chain_splitting, foreign
from protochain.structure.formats.ions import name_ions
from protochain.structure.formats.pdb_text import add_elements, is_atom, join_segments, remove_indents
from protochain.structure.formats.records import cif_header, pdb_header
from protochain.structure.molecule.repairs import Kind, Repair
from protochain.structure.molecule.residues import STANDARD, Residue
from protochain.structure.molecule.templates import standard_name

MAX_MEGABYTES = 512
"""Largest text after decompression. The largest files of the PDB are smaller."""
MAX_LINES = 8_000_000
"""Largest number of lines. A small compressed file could otherwise contain very many empty lines."""
MAX_ATOMS = 250_000
"""Largest model. Preparation needs about 10 kB per atom, energies without a cutoff quadratic time."""
STANDARD_INPUT = Path("-")
SUFFIXES = {".pdb": "PDB", ".ent": "PDB", ".cif": "mmCIF", ".mmcif": "mmCIF", ".pdbx": "mmCIF"}
"""Format of written files by suffix. For input files, the content determines the format."""
PACKINGS: dict[str, Callable[[bytes], bytes]] = {
    # Without the time of writing: the same structure gives the same bytes.
    ".gz": lambda data: gzip.compress(data, mtime=0),
    ".bz2": bz2.compress,
    ".xz": lzma.compress,
    ".zst": zstandard.compress,
}
"""Compression functions by the last suffix."""

_COORDINATE_COLUMNS = 54
_USED = slice(12, 66)  # Columns of an atom record from the atom name to the B factor.
_RECORDS = ("ATOM", "HETATM", "ANISOU", "SIGATM", "SIGUIJ")
_LONGEST_NAME = 80  # Maximum length of names of chains, residues and atoms. Messages quote these names.
_HEAVIEST = 111  # Atomic number of the last element of OpenMM.
_UNKNOWN = "UNL"  # Residue name of the PDB for unknown ligands. mmCIF does not permit empty names.
_NAMELESS = "X"  # Name of atoms without a name, the symbol of an unknown element.
_FARTHEST = 1e5  # Angstrom. Larger coordinates raise an error.
_STRANGE = re.compile(r"[^\t\n -~]")
_FEW_LINES, _SHORTEST, _LONGEST = 1_000_000, 8, 1_000_000
"""Number of lines above which the mean length is checked, smallest mean length, longest line, in bytes."""
_BYTES = MAX_MEGABYTES << 20
_HEAD = 400  # Number of first bytes that contain the keys of a BinaryCIF file, which is a MessagePack map.
_PACKED: tuple[tuple[bytes, str, Callable[[Any], Any]], ...] = (
    (b"\x1f\x8b", "gzip", gzip.open),
    (b"BZh", "bzip2", bz2.open),
    (b"\xfd7zXZ\0", "xz", lzma.open),
    (b"\x28\xb5\x2f\xfd", "zstd", zstandard.open),
)
"""First bytes of compressed files, name of the compression, and function that opens them."""
_DESCRIPTORS = ("/dev/stdin", "/dev/fd/", "/proc/self/fd/")
"""Paths of open file descriptors, as a shell passes for ``<(zcat x.pdb.gz)``."""
_CHARGE = re.compile(r"(\d?[+-]|[+-]\d)?")
_UPPER = ((0, 6), (12, 16), (17, 20))
"""Columns of record, atom and residue names, which are converted to upper case."""


def split_name(path: Path) -> tuple[str, str, str]:
    """Split a file name: ``1abc.pdb.gz`` gives ``1abc``, ``.pdb`` and ``.gz``."""
    packing = path.suffix if path.suffix.lower() in PACKINGS else ""
    inner = Path(path.name.removesuffix(packing)) if packing else path
    return inner.stem, inner.suffix, packing


def format_of(path: Path) -> str:
    """Return the format of a file from its name without compression suffix. Empty if unknown."""
    return SUFFIXES.get(split_name(path)[1].lower(), "")


def suffix_of(source: Path) -> str:
    """Return the suffix of results in the format of the input, PDB if unknown."""
    return ".cif" if format_of(source) == "mmCIF" else ".pdb"


@part("reading")
def parse(path: Path) -> tuple[gemmi.Structure, list[Repair], bool, str]:
    """Parse a PDB or mmCIF file, optionally compressed. The content determines the format."""
    source = "standard input" if path == STANDARD_INPUT else str(path)
    try:
        source.encode()  # Tables and structures contain the name as UTF-8.
    except UnicodeEncodeError:
        raise StructureError(f"{ascii(source)[1:-1]}: its name is not UTF-8; rename the file") from None
    repairs: list[Repair] = []
    if path.suffix.lower() in foreign.SUFFIXES:
        return _normalise(foreign.by_mdanalysis(path), source, repairs, True, "")
    text = _read_text(path, source)
    try:
        if _is_cif(text):
            text = _ascii(text, source, slice(None))
            block, *other_blocks = _blocks_with_atoms(gemmi.cif.read_string(text), source)
            if other_blocks:
                names = tuple(unused_block.name for unused_block in other_blocks)
                repairs.append(Repair(Kind.BLOCKS_LEFT_OUT, {"used": block.name, "others": names}))
            ends = _is_complete_cif(text, block, source)
            _add_columns(block, source)
            structure, records = gemmi.make_structure_from_block(block), cif_header(block)
        else:
            _refuse_cut_pdb(text, source)
            text, long_names = _correct_pdb(_ascii(text, source, _USED), source, repairs)
            ends = any(line.startswith("END") for line in text.splitlines())
            # The newline: gemmi treats a short last line without it as incomplete.
            # The split at TER: gemmi would join residues of two chains with equal id, number and name.
            structure = gemmi.read_pdb_string(f"{text}\n", split_chain_on_ter=True)
            for residue, chain in ((r, c) for m in structure for c in m for r in c) if long_names else ():
                place = residue.name, chain.name.strip(), str(residue.seqid).strip()
                residue.name = long_names.get(place, residue.name)
            records = pdb_header(text, structure)
    except StructureError:
        raise
    except (RuntimeError, ValueError, IndexError) as error:
        reason = excerpt(" ".join(str(error).replace("string:", "line ").split()))
        raise StructureError(f"{source}: cannot be read: {reason}; correct or download it again") from None
    return _normalise(structure, source, repairs, ends, records)


def _normalise(
    structure: gemmi.Structure, source: str, repairs: list[Repair], ends: bool, records: str
) -> tuple[gemmi.Structure, list[Repair], bool, str]:
    """Number atoms, name ions, join parts of residues, and separate chains, caps and molecule copies."""
    number_atoms(structure)
    name_ions(structure)
    chain_splitting.join_residues(structure)
    chain_splitting.separate_caps(structure)
    repairs += chain_splitting.separate_chains(structure)
    structure.merge_chain_parts()
    _fill_missing(structure)
    check(structure, source)
    repairs += chain_splitting.separate_molecules(structure, source)
    return structure, repairs, ends, records


def _read_text(path: Path, source: str) -> str:
    try:
        data = _standard_input(sys.stdin.buffer) if path == STANDARD_INPUT else _bytes(path)
    except OSError as error:
        raise StructureError(f"{source}: cannot be read ({error.strerror}); check the name") from None
    for magic, name, unpack in _PACKED:
        if data.startswith(magic):
            try:
                with unpack(io.BytesIO(data)) as file:
                    data = file.read(_BYTES + 1)
            except (OSError, EOFError, zlib.error, lzma.LZMAError, zstandard.ZstdError) as error:
                raise StructureError(
                    f"{source}: not a whole {name} file ({error}); download it again"
                ) from None
    if len(data) > _BYTES:
        raise StructureError(f"{source}: larger than {MAX_MEGABYTES} megabytes; give fewer models or chains")
    if b"dataBlocks" in data[:_HEAD]:
        return foreign.text_of_binary(data, source)
    # Windows editors write UTF-16, in which one of the two bytes of each ASCII letter is 0.
    for mark, start, encoding in (codecs.BOM_UTF16_LE, 1, "utf-16-le"), (codecs.BOM_UTF16_BE, 0, "utf-16-be"):
        if data.startswith(mark) or (len(data) > _HEAD and not any(data[start:_HEAD:2])):
            data = data.decode(encoding, errors="replace").removeprefix("\ufeff").encode()
    _refuse_many(data, source)
    if b"\0" in data:
        raise StructureError(f"{source}: is a binary file; give PDB or mmCIF text")
    text = data.decode("utf-8-sig", errors="replace")
    return text.replace("\r\n", "\n").replace("\r", "\n")


def _refuse_many(data: bytes, source: str) -> None:
    """Refuse too many lines or too many atoms per model before parsing, which needs much memory."""
    n_lines = max(data.count(b"\n"), data.count(b"\r"))
    if n_lines > MAX_LINES:
        raise StructureError(
            f"{source}: more than {MAX_LINES // 10**6} million lines; give fewer models or chains"
        )
    if n_lines > _FEW_LINES and len(data) < _SHORTEST * n_lines:
        raise StructureError(f"{source}: {n_lines} lines are nearly all empty; give PDB or mmCIF text")
    if max(map(len, data.splitlines()), default=0) > _LONGEST:
        raise StructureError(f"{source}: a line has over {_LONGEST} characters; give PDB or mmCIF text")
    if n_lines <= MAX_ATOMS:
        return
    n, model, column, in_loop = 0, b"", 0, False
    for line in io.BytesIO(data):
        if line.startswith(b"_atom_site."):
            # Columns are counted from the last one, because quoted values may contain blanks.
            column = -1 if line.strip() == b"_atom_site.pdbx_PDB_model_num" else column - bool(column)
            in_loop = True
        elif line.startswith((b"MODEL", b"END", b"data_", b"loop_", b"_", b"#")):
            n, column, in_loop = 0, 0, False
        elif in_loop or line.startswith((b"ATOM", b"HETATM")):
            row_model = b"".join(line.split()[column : column + 1 or None]) if column else b""
            n, model = (n + 1, model) if row_model == model else (1, row_model)
            if n > MAX_ATOMS:
                raise StructureError(f"{source}: more than {MAX_ATOMS} atoms; give fewer chains")


@lru_cache(maxsize=1)
def _standard_input(stream: BinaryIO) -> bytes:
    """Read standard input. The cache is needed because it can be read only once."""
    return stream.read(_BYTES + 1)


def _bytes(path: Path) -> bytes:
    is_descriptor = str(path).startswith(_DESCRIPTORS)
    with (path if is_descriptor else regular(path)).open("rb") as file:
        return file.read(_BYTES + 1)


def _is_cif(text: str) -> bool:
    """Return whether the first line that is not a comment opens a data block."""
    lines = (line.strip() for line in text.splitlines())
    first = next((line for line in lines if line and not line.startswith("#")), "")
    return first.lower().startswith("data_")


def _blocks_with_atoms(document: gemmi.cif.Document, source: str) -> list[gemmi.cif.Block]:
    item = "_atom_site.Cartn_x"
    blocks = [block for block in document if block.find_loop(item) or block.find_pair(item)]
    if not blocks:
        raise StructureError(f"{source}: no atoms found; give a PDB or mmCIF file with coordinates")
    return blocks


def _add_columns(block: gemmi.cif.Block, source: str) -> None:
    """Add missing columns that gemmi requires, if their values are unambiguous."""
    column = block.find_loop("_atom_site.Cartn_x")
    if not column:
        return
    loop = column.get_loop()
    tags = {tag.lower() for tag in loop.tags}
    if "_atom_site.type_symbol" not in tags:
        raise StructureError(f"{source}: its atoms have no elements; add the item _atom_site.type_symbol")
    for tag in ("id", "label_alt_id", "label_asym_id", "B_iso_or_equiv"):
        if f"_atom_site.{tag}".lower() not in tags:
            loop.add_columns([f"_atom_site.{tag}"], ".")
    for row in block.find("_atom_site.", ["B_iso_or_equiv"]):
        if row[0] in (".", "?"):
            row[0] = "nan"  # gemmi would read 20.
    if "_atom_site.label_asym_id" not in tags and "_atom_site.auth_asym_id" in tags:
        for row in block.find("_atom_site.", ["label_asym_id", "auth_asym_id"]):
            row[0] = row[1]
    if "_atom_site.id" not in tags:
        for number, row in enumerate(block.find("_atom_site.", ["id"]), 1):
            row[0] = str(number)


def _is_complete_cif(text: str, block: gemmi.cif.Block, source: str) -> bool:
    """Return whether an mmCIF file ends with the ``#`` of the PDB or with the last residue of a sequence.

    The grammar does not require a ``#``. A file without it is refused if a listed chain has no atoms.
    """
    lines = text.rstrip().splitlines() or [""]
    if lines[-1].strip() == "#" or not any(line.strip() == "#" for line in lines):
        return True
    last = next((line for line in reversed(lines) if line.startswith("_")), "")
    if not last.lower().startswith("_atom_site."):
        return True
    if set(block.find_values("_struct_asym.id")) - {*block.find_values("_atom_site.label_asym_id")}:
        raise StructureError(
            f"{source}: line {len(lines)}: the file is cut short; download it again, "
            "or add a line with # if it is complete"
        )
    items = ["label_entity_id", "label_seq_id", "label_comp_id"]
    *_, (entity, number, name) = [("", "", "GLY"), *(tuple(row) for row in block.find("_atom_site.", items))]
    sequence = [row[1] for row in block.find("_entity_poly_seq.", ["entity_id", "num"]) if row[0] == entity]
    return number in sequence[-1:] or not gemmi.find_tabulated_residue(name).is_amino_acid()


def _refuse_cut_pdb(text: str, source: str) -> None:
    """Refuse a file that ends within an atom record, or with a full one if it has a header."""
    lines = text.rstrip("\n").splitlines() or [""]
    last, before = lines[-1], lines[-2] if len(lines) > 1 else ""
    in_record_name = bool(last) and any(record.startswith(last) for record in _RECORDS)
    if not last.startswith(_RECORDS) and not in_record_name:
        return
    shorter = not text.endswith("\n") and before.startswith(_RECORDS) and len(last) < len(before)
    has_header = any(line.startswith(("HEADER", "SEQRES")) for line in lines)
    if len(last) < _COORDINATE_COLUMNS or shorter or has_header:
        raise StructureError(
            f"{source}: line {len(lines)}: the file is cut short; download it again, "
            "or add an END record if it is complete"
        )


def _ascii(text: str, source: str, used: slice) -> str:
    """Replace non-ASCII and control characters by question marks. Refuse them in the columns used."""
    if not _STRANGE.search(text):
        return text
    for number, line in enumerate(text.split("\n"), 1):
        if line[:6].upper().startswith(("ATOM", "HETATM")) and (match := _STRANGE.search(line[used])):
            kind = "control character" if match[0].isascii() else "letter that is not ASCII"
            column = (used.start or 0) + match.start() + 1
            raise StructureError(f"{source}: line {number}: column {column} holds a {kind}; correct it")
    return _STRANGE.sub("?", text)


def _correct_pdb(
    text: str, source: str, repairs: list[Repair]
) -> tuple[str, dict[tuple[str, str, str], str]]:
    """Check and correct the columns of a PDB file. Return the text and residue names of four letters."""
    lines = text.split("\n")
    if indented := remove_indents(lines):
        repairs.append(Repair(Kind.INDENTED, {"count": indented}))
    lines, joined = join_segments(lines, source)
    repairs += joined
    long_names = _shorten_names(lines)
    add_elements(lines)
    in_model, unended, lower = False, 0, 0
    strange: list[int] = []
    for i, line in enumerate(lines):
        record = line[:6].upper()
        if record.startswith("MODEL"):
            if in_model:
                unended += 1
                lines[i] = f"ENDMDL\n{line}"
            in_model = True
        elif record.startswith("ENDMDL"):
            in_model = False
        if record.startswith(("ANISOU", "SIGATM", "SIGUIJ")):
            # These records are unused, and gemmi would refuse some orders of them.
            lines[i] = ""
        if not is_atom(line):
            lines[i] = "" if record.startswith("ATOM") else lines[i]
            continue
        if any(line[start:end].upper() != line[start:end] for start, end in _UPPER):
            lower += 1
            for start, end in _UPPER:
                line = line[:start] + line[start:end].upper() + line[end:]
        _refuse_odd_numbers(line, i + 1, source)
        element = line[76:78].strip()
        if element and not 0 < gemmi.Element(element).atomic_number <= _HEAVIEST:
            strange.append(i + 1)
            line = line[:76].rstrip()
        if not _CHARGE.fullmatch(line[78:80].strip()):
            line = line[:78].rstrip()
        if not (line[54:60].strip() and line[60:66].strip()):
            # gemmi would read 0 from empty columns.
            occupancy, b_factor = line[54:60].strip() or "1.00", line[60:66].strip() or "nan"
            line = f"{line[:54]:<54}{occupancy:>6}{b_factor:>6}{line[66:]}"
        lines[i] = line
    if lower:
        repairs.append(Repair(Kind.LOWER_CASE, {"count": lower}))
    if strange:
        repairs.append(Repair(Kind.NO_ELEMENT, {"count": len(strange), "line": strange[0]}))
    if unended:
        repairs.append(Repair(Kind.NO_ENDMDL, {"count": unended}))
    return "\n".join(lines), long_names


def _shorten_names(lines: list[str]) -> dict[tuple[str, str, str], str]:
    """Shorten residue names in columns 18 to 21 to three letters. gemmi reads column 21 as chain id.

    Examples: NASN of Amber, LYSH of GROMACS, GLUP of CHARMM. Return names of other residues than amino
    acids and caps, by place. Column 21 belongs to a chain id if column 22 has a letter, all residues of the
    run have a letter in column 21, and a polymer has this id, or no polymer the id of column 22 alone.
    """
    places = [(i, line[17:27]) for i, line in enumerate(lines) if line[:6].upper() in ("ATOM  ", "HETATM")]
    long_names: dict[tuple[str, str, str], str] = {}
    if all(place[3:4] in " " for _, place in places):
        return long_names
    polymers = {line[20:22] for line in lines if line[:6].upper() == "ATOM  "}
    runs: list[list[tuple[int, str]]] = []
    for i, place in places:
        before = runs[-1][-1] if runs else (-2, "")
        is_next = before[0] == i - 1 and before[1][4:5] == place[4:5]
        if not (is_next and _follows(before[1][5:9], place[5:9])):
            runs.append([])
        runs[-1].append((i, place))
    for run in runs:
        ids = {place[3:5] for _, place in run}
        is_id = all(chain_id[:1].strip() for chain_id in ids) and (
            bool(ids & polymers) or not any(f" {chain_id[1:]}" in polymers for chain_id in ids)
        )
        for i, place in run:
            name = place[:4]
            short, state = standard_name(name)
            if len(name.strip()) == 4 and (short != name or not (is_id and place[4:5].strip())):
                new = (state or short)[:3] if short != name else name[:3]
                lines[i] = f"{lines[i][:17]}{new:<4}{lines[i][21:]}"
                if short == name and new not in STANDARD:
                    long_names[new, place[4:5].strip(), place[5:].strip()] = name
    return long_names


def _follows(before: str, number: str) -> bool:
    """Return whether two residue numbers are equal or consecutive."""
    try:
        return int(number) - int(before) in (0, 1)
    except ValueError:
        return before == number


def _refuse_odd_numbers(line: str, number: int, source: str) -> None:
    for axis, start in zip("xyz", (30, 38, 46), strict=True):
        text = line[start : start + 8]
        try:
            value = float(text)
        except ValueError:
            value = float("nan")
        if not isfinite(value):
            raise StructureError(
                f"{source}: line {number}: {axis} is {text.strip()!r}, not a number; "
                f"correct columns {start + 1}-{start + 8}"
            )
    text = line[22:26]
    is_hybrid36 = len(text) == 4 and text[0].isalpha() and text.isalnum() and text.isascii()
    if not text.strip().lstrip("-").isdigit() and not is_hybrid36:
        raise StructureError(
            f"{source}: line {number}: the residue number is {text.strip()!r}; correct columns 23-26"
        )


def number_atoms(structure: gemmi.Structure) -> None:
    """Number the atoms of each model from 1 in the order of the file. Atoms that are built later have 0."""
    for model in structure:
        atoms = [place.atom for place in model.all()]
        serials = {atom.serial for atom in atoms}
        if structure.input_format == gemmi.CoorFormat.Mmcif and len(serials) == len(atoms):
            atoms.sort(key=lambda atom: atom.serial)
        for place, atom in enumerate(atoms, 1):
            # A field for users of gemmi, exact up to 16 million.
            atom.fraction = place


def places_in_file(atoms: Iterable[gemmi.Atom]) -> list[int]:
    """Return the index of each atom in its model of the file, from 0, or -1 for built atoms."""
    return [round(atom.fraction) - 1 for atom in atoms]


def in_file_order(model: gemmi.Model) -> list[tuple[str, gemmi.Atom]]:
    """Return names (``A/17/GLU/CG``, ``A/17/GLU/CG/B``) and atoms of a model in the order of the file."""
    named_atoms = []
    for p in model.all():
        altloc = [p.atom.altloc] if p.atom.has_altloc() else []
        parts = [p.chain.name, str(p.residue.seqid), p.residue.name, p.atom.name, *altloc]
        named_atoms.append(("/".join(parts), p.atom))
    return sorted(named_atoms, key=lambda named_atom: named_atom[1].fraction)


def _fill_missing(structure: gemmi.Structure) -> None:
    """Fill missing names, residue numbers and insertion codes (NUL), and replace unknown elements by X."""
    for model in structure:
        for chain in model:
            last = max((r.seqid.num or 0 for r in chain), default=0)
            unnumbered = [r for r in chain if r.seqid.num is None and r.get_ca() is None]
            for k, residue in enumerate(unnumbered, last + 1):
                residue.seqid = gemmi.SeqId(k, " ")
        for place in model.all():
            if not place.residue.name.strip():
                place.residue.name = _UNKNOWN
            place.atom.name = place.atom.name.strip() or _NAMELESS
            if place.residue.seqid.icode == "\0":
                place.residue.seqid.icode = " "
            if place.atom.element.atomic_number > _HEAVIEST:
                place.atom.element = gemmi.Element("X")


def check(structure: gemmi.Structure, source: str) -> None:
    """Refuse a structure with no atoms, too many, or invalid coordinates."""
    if len(structure) == 0 or structure[0].count_atom_sites() == 0:
        raise StructureError(f"{source}: no atoms found; give a PDB or mmCIF file with coordinates")
    for model in structure:
        if model.count_atom_sites() > MAX_ATOMS:
            raise StructureError(
                f"{source}: {model.count_atom_sites()} atoms are more than {MAX_ATOMS}; give fewer chains"
            )
        for place in model.all():
            if place.residue.seqid.num is None:
                where = f"{place.residue.name} of chain {place.chain.name or '(blank)'}"
                raise StructureError(f"{source}: a residue {where} has no number; give auth_seq_id")
            for name in (place.chain.name, place.residue.name, place.atom.name):
                if len(name) > _LONGEST_NAME:
                    raise StructureError(
                        f"{source}: the name {excerpt(name)} has {len(name)} letters; "
                        f"give one of {_LONGEST_NAME} at most"
                    )
            x = place.atom.pos.tolist()
            if not all(map(isfinite, x)) or max(map(abs, x)) > _FARTHEST:
                residue = Residue(place.chain.name, str(place.residue.seqid), place.residue.name)
                raise StructureError(
                    f"{source}: the position of atom {place.atom.name} of {residue} is not a number or "
                    f"beyond {_FARTHEST:g} angstrom; correct it"
                )
