"""Texts of files, line by line and column by column: what is corrected or refused, and in which words."""

import gzip
import io
from pathlib import Path
from types import SimpleNamespace

import gemmi
import pytest

import protochain as pc
from protochain.structure.formats import files
from protochain.structure.formats.files import check, parse
from protochain.structure.molecule.repairs import Kind

ATOM = "ATOM      1  CA  ALA A   1       1.000   2.000   3.000  1.00  0.00           C  "
"""80 columns."""
END = "END\n"


def parsed(tmp_path, text):
    path = tmp_path / "x"
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return parse(path)


def refusal(tmp_path, text):
    """The message without the file's name."""
    with pytest.raises(pc.ProtochainError) as refused:
        parsed(tmp_path, text)
    name, message = str(refused.value).split(": ", 1)
    assert name == str(tmp_path / "x")
    return message


CUT = "the file is cut short; download it again"
CUT_PDB = f"{CUT}, or add an END record if it is complete"
NO_ATOMS = "no atoms found; give a PDB or mmCIF file with coordinates"
COLUMNS = "group_PDB id type_symbol label_atom_id label_alt_id label_comp_id label_asym_id auth_seq_id"
LOOP = "".join(
    ["data_b\nloop_\n", *(f"_atom_site.{name}\n" for name in f"{COLUMNS} Cartn_x Cartn_y Cartn_z".split())]
)
ROW = "ATOM 1 C CA . ALA A 1 2 3 4\n"
PAIRS = "".join(f"{name} {value}\n" for name, value in zip(LOOP.split()[2:], ROW.split(), strict=True))
"""The same atom without a loop."""


@pytest.mark.parametrize(
    ("text", "ends"),
    [
        (f"{ATOM}\n{END}", True),
        (f"MODEL        1\n{ATOM}\nENDMDL\n", True),
        (f"{ATOM}\nTER\n", False),
        (f"{ATOM}\n", False),
        (ATOM, False),
        (f"{ATOM[:54]}\n", False),
        (f"{ATOM}\n{ATOM[:54]}\n", False),
        (f"REMARK{ATOM}\n{ATOM[:60]}", False),
        (f"{LOOP}{ROW}", True),
        (f"# a remark\n\n  DATA_{LOOP[5:]}{ROW}# \n", True),
        (f"data_a\n_cell.length_a 1\n{LOOP}{ROW}", True),
        (f"data_a\n{PAIRS}", True),
    ],
)
def test_what_is_whole_is_taken_and_whether_it_marks_its_end_is_told(text, ends, tmp_path):
    structure, overlooked, told, _ = parsed(tmp_path, text)
    assert overlooked == [] and told is ends
    assert {atom.name for atom in structure[0][0][0]} == {"CA"}


@pytest.mark.parametrize("record", ["ATOM", "HETATM", "ANISOU", "SIGATM", "SIGUIJ"])
@pytest.mark.parametrize("length", [1, 4, 6, 53])
def test_a_pdb_file_that_ends_within_a_record_is_refused(record, length, tmp_path):
    last = f"{record:6s}{ATOM[6:]}"[:length].rstrip("\n")
    assert refusal(tmp_path, f"{ATOM}\n{last}") == f"line 2: {CUT_PDB}"
    assert refusal(tmp_path, f"{last}\n\n\n") == f"line 1: {CUT_PDB}"


def test_a_pdb_file_that_ends_too_soon_is_refused(tmp_path):
    assert refusal(tmp_path, f"{ATOM}\n{ATOM[:79]}") == f"line 2: {CUT_PDB}"
    assert parsed(tmp_path, f"{ATOM}\n{ATOM[:79]}\n")[2] is False
    for header in ("HEADER", "SEQRES"):
        assert refusal(tmp_path, f"{header}  x\nREMARK\n{ATOM}\n") == f"line 3: {CUT_PDB}"
        assert parsed(tmp_path, f"{header}  x\n{ATOM}\n{END}")[2] is True
    assert refusal(tmp_path, "") == NO_ATOMS


def test_an_mmcif_file_of_the_archive_ends_in_a_hash(tmp_path):
    assert parsed(tmp_path, f"data_a\n#\n{LOOP}{ROW}\n\n")[2] is False
    listed = LOOP.replace("loop_\n", "loop_\n_struct_asym.id\nA B\n#\nloop_\n", 1)
    last = refusal(tmp_path, f"{listed}{ROW}\n\n")
    assert last == f"line 18: {CUT}, or add a line with # if it is complete"
    assert parsed(tmp_path, f"data_a\n#\n{LOOP}{ROW}#")[2] is True
    assert refusal(tmp_path, "data_a\n_cell.length_a 1\n") == NO_ATOMS
    assert refusal(tmp_path, "data_a\nloop_\n1 2\n").startswith("cannot be read: line 3")
    assert files._is_cif("\n  \n# data_a\n") is False and files._is_cif("ATOM data_a") is False


def test_what_gemmi_makes_of_odd_values_is_made_usual(tmp_path):
    """An empty insertion code is a NUL, no force field has oganesson, and mmCIF has no empty names."""
    text = LOOP + "_atom_site.pdbx_PDB_ins_code\n" + ROW.replace(" C ", " Og ", 1).rstrip() + " ''\n#"
    atom = parsed(tmp_path, text)[0][0][0][0]
    assert (atom.seqid.icode, atom[0].element.name) == (" ", "X")
    nameless = parsed(tmp_path, f"{ATOM[:17]}   {ATOM[20:]}\n{END}")[0][0][0][0]
    assert nameless.name == "UNL"


@pytest.mark.parametrize("packed", [False, True])
def test_a_text_is_as_large_as_the_limit_and_no_larger(packed, tmp_path, monkeypatch):
    assert files._BYTES == 512 * 1024 * 1024
    monkeypatch.setattr(files, "_BYTES", 2000)
    text = f"{ATOM}\n{END}"
    full = text + " " * (2000 - len(text))
    pack = gzip.compress if packed else bytes
    assert parsed(tmp_path, pack(full.encode()))[2] is True
    too_much = "larger than 512 megabytes; give fewer models or chains"
    assert refusal(tmp_path, pack(f"{full} ".encode())) == too_much
    for given, taken in ((full, True), (f"{full} ", False)):
        monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(pack(given.encode()))))
        if taken:
            assert parse(Path("-"))[2] is True
        else:
            with pytest.raises(pc.ProtochainError, match=f"^standard input: {too_much}$"):
                parse(Path("-"))


def test_what_is_no_text_is_refused(tmp_path):
    assert refusal(tmp_path, f"{ATOM}\n\0{END}") == "is a binary file; give PDB or mmCIF text"
    with pytest.raises(pc.ProtochainError) as refused:
        parse(tmp_path / "none")
    assert str(refused.value).startswith(f"{tmp_path}/none: cannot be read (No such file")


def test_parts_of_a_chain_are_joined(tmp_path):
    other = ATOM.replace("ALA A", "ALA B")
    third = ATOM.replace("A   1 ", "A   2 ")
    (model,) = parsed(tmp_path, "\n".join((ATOM, "TER", other, "TER", third, END)))[0]
    assert [(chain.name, len(chain)) for chain in model] == [("A", 2), ("B", 1)]


@pytest.mark.parametrize("record", ["ATOM  ", "hetatm", "REMARK"])
def test_letters_beyond_ascii_are_refused_in_the_used_columns_of_atoms_only(record, tmp_path):
    line = f"{record}{ATOM[6:]}"
    for column in range(7, 81):
        odd = f"{line[: column - 1]}é{line[column:]}"
        if 13 <= column <= 66 and record != "REMARK":
            assert refusal(tmp_path, f"{ATOM}\n{odd}\n{END}") == (
                f"line 2: column {column} holds a letter that is not ASCII; correct it"
            )
        else:
            assert files._ascii(odd, "x", files._USED) == odd.replace("é", "?")
            assert parsed(tmp_path, f"{ATOM}\n{odd}\n{END}")[2] is True


def corrected(*lines):
    overlooked = []
    text, _ = files._correct_pdb("\n".join(lines), "x", overlooked)
    return text.split("\n"), [(repair.kind, *repair.facts.values()) for repair in overlooked]


def test_a_model_without_an_end_ends_where_the_next_begins():
    lines, overlooked = corrected(
        "MODEL 1", ATOM, "ENDMDL", "MODEL 2", ATOM, "MODEL 3", "model 4", "ENDMDL", "END"
    )
    assert overlooked == [(Kind.NO_ENDMDL, 2)]
    assert lines == [
        "MODEL 1", ATOM, "ENDMDL", "MODEL 2", ATOM, "ENDMDL", "MODEL 3", "ENDMDL", "model 4", "ENDMDL", "END",
    ]  # fmt: skip
    assert corrected("MODEL 1", "ENDMDL", "ATOMS"[:3]) == (["MODEL 1", "ENDMDL", "ATO"], [])


def test_records_that_are_not_used_are_left_out():
    assert corrected(ATOM, "ANISOU x", "SIGATM x", "siguij", "REMARK", ATOM) == (
        [ATOM, "", "", "", "REMARK", ATOM],
        [],
    )


def test_names_in_lower_case_are_read_in_upper_case_but_not_ids():
    low = "hetatm    1  cabbala b   1c      1.000   2.000   3.000  1.00  0.00      segm C  "
    up = "HETATM    1  CABbALA b   1c      1.000   2.000   3.000  1.00  0.00      segm C  "
    assert corrected(low, ATOM, low) == ([up, ATOM, up], [(Kind.LOWER_CASE, 2)])
    for column, kept in (
        (6, True),
        (11, True),
        (12, False),
        (15, False),
        (16, True),
        (17, False),
        (19, False),
        (20, True),
    ):
        line = f"{ATOM[:column]}q{ATOM[column + 1 :]}"
        assert corrected(line)[0] == [line if kept else line.upper()]


def test_elements_and_charges_that_are_none_are_left_out():
    plain = ATOM[:66]
    same = [f"{plain:76s}{end}" for end in (" C2+", " C+2", " C+", " C -", " C", "CA1-")]
    assert corrected(*same) == (same, [])
    lines, overlooked = corrected(
        "REMARK", same[0], f"{plain:76s}QQ2+", ATOM, f"{plain:74s}12QQ", f"{plain:76s}OG"
    )
    assert lines == ["REMARK", same[0], plain, ATOM, f"{plain:74s}12", plain]
    assert overlooked == [(Kind.NO_ELEMENT, 3, 3)]
    assert corrected(f"{plain:76s} C2A", f"{plain:76s} C 5") == ([f"{plain:76s} C"] * 2, [])


@pytest.mark.parametrize(
    ("start", "end", "text", "why"),
    [
        (30, 38, "   1.0x2", "x is '1.0x2', not a number; correct columns 31-38"),
        (38, 46, "        ", "y is '', not a number; correct columns 39-46"),
        (46, 54, "     inf", "z is 'inf', not a number; correct columns 47-54"),
        (46, 54, "    nan ", "z is 'nan', not a number; correct columns 47-54"),
        (22, 26, "  x ", "the residue number is 'x'; correct columns 23-26"),
        (22, 26, "1A00", "the residue number is '1A00'; correct columns 23-26"),
        (22, 26, "A-00", "the residue number is 'A-00'; correct columns 23-26"),
        (22, 26, " A00", "the residue number is 'A00'; correct columns 23-26"),
        (22, 26, "    ", "the residue number is ''; correct columns 23-26"),
        (22, 26, "A0Z9", ""),
        (22, 26, " -12", ""),
        (30, 55, "9999.999-999.999-999.999-", ""),
    ],
)
def test_numbers_are_read_from_their_columns(start, end, text, why):
    line = f"{ATOM[:start]}{text}{ATOM[end:]}"
    if not why:
        assert corrected("REMARK", line) == (["REMARK", line], [])
        return
    with pytest.raises(pc.ProtochainError) as refused:
        corrected("REMARK", line)
    assert str(refused.value) == f"x: line 2: {why}"


def counted(n):
    return SimpleNamespace(count_atom_sites=lambda: n, all=lambda: ())


def test_a_model_has_as_many_atoms_as_the_limit_and_no_more():
    check([counted(250_000)], "x")
    for models, why in (
        ([counted(1), counted(250_001)], "250001 atoms are more than 250000; give fewer chains"),
        ([], NO_ATOMS),
        ([counted(0), counted(5)], NO_ATOMS),
    ):
        with pytest.raises(pc.ProtochainError) as refused:
            check(models, "x")
        assert str(refused.value) == f"x: {why}"


@pytest.mark.parametrize("chain", ["A", ""])
@pytest.mark.parametrize(
    ("far", "taken"), [(1e5, True), (-1e5, True), (1.5e5, False), (-1.5e5, False), (float("nan"), False)]
)
def test_positions_are_within_ten_micrometres(far, taken, chain):
    structure = gemmi.read_pdb_string(f"{ATOM}\n{ATOM.replace('A   1 ', 'A   2C')}\n{END}")
    structure[0][0].name = chain
    structure[0][0][1][0].pos.y = far
    if taken:
        check(structure, "x")
        return
    with pytest.raises(pc.ProtochainError) as refused:
        check(structure, "x")
    assert str(refused.value) == (
        f"x: the position of atom CA of {chain and f'{chain}:'}ALA2C is not a number "
        "or beyond 100000 angstrom; correct it"
    )
