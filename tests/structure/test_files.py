"""Files as people have them: every oddity is taken, said, or refused in one line."""

import functools
import gzip
import hashlib
import io
import itertools
import os
import string
import subprocess
import sys
import threading
from pathlib import Path

import gemmi
import numpy as np
import pytest
from fixtures.repairs import sentences
from fixtures.samples import MORE_STRUCTURES, ROOT, STRUCTURES, energy, load, shared
from pdbfixer.pdbfixer import substitutions

import protochain as pc
from protochain.batches import BatchSettings, find_jobs
from protochain.batches.task import Task
from protochain.structure.formats.files import parse
from protochain.structure.molecule import residues
from protochain.structure.molecule.templates import archive_parent
from protochain.structure.preparation.read import model_numbers
from protochain.structure.write import as_text

FILES = sorted(
    str(path.relative_to(MORE_STRUCTURES))
    for path in MORE_STRUCTURES.rglob("*")
    if path.suffix in (".pdb", ".cif")
)
QUICK = {
    "1bhl_gap_cas.pdb", "1cih_scop_oldcols.pdb", "1kyo_m3l.pdb", "2ptc_I_bpti_occ0.pdb", "4zhl_icodes.cif",
    "4ake_charmm_noelem.pdb", "5vav_cyclic.pdb", "6lfo_gap_model.pdb", "aaqaa3_capped.pdb",
    "hewl_charmm_H.pdb", "trpcage_d9e_missing.pdb", "ubiquitin_ca_only.pdb", "unordered_icode.pdb",
}  # fmt: skip
"""One of each oddity; the slow tests take all."""
REFUSED = {"ubiquitin_ca_only.pdb"}


@functools.cache
def loaded(name):
    """One of the larger collection, for all tests that change nothing about how it is read."""
    return pc.load(shared(name))


def atoms_of(name):
    return [line for line in (STRUCTURES / name).read_text().splitlines(True) if line[:6].strip() == "ATOM"]


def written(tmp_path, text, name="x.pdb"):
    path = tmp_path / name
    path.write_text(text)
    return path


@pytest.mark.skipif(not FILES, reason="the larger collection is not here")
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=() if name in QUICK else pytest.mark.slow) for name in FILES]
)
def test_every_file_is_taken_whole_or_refused_in_a_line(name):
    path = MORE_STRUCTURES / name
    if name in REFUSED:
        with pytest.raises(pc.ProtochainError) as refused:
            pc.load(path)
        assert str(refused.value).startswith(f"{path}: ") and "\n" not in str(refused.value)
        return
    s = loaded(name)
    said = "\n".join(sentences(s))
    there = set(zip(s.residue_chain, np.char.add(s.residue_number, s.residue_insertion_code), strict=True))
    original = parse(path)[0]
    for chain in original[0]:
        for residue in chain:
            if gemmi.find_tabulated_residue(residue.name).is_amino_acid():
                number = str(residue.seqid).strip()
                where = residues.Residue(chain.name.strip(), number, residue.name)
                assert (chain.name.strip(), number) in there or f"{where}: left out" in said, where
    first, second = s.bonds.T
    lengths = np.linalg.norm(s.positions[first] - s.positions[second], axis=1)
    assert lengths.min() > 0.08 and lengths.max() < 0.3
    assert np.isfinite(s.positions).all() and len(s.b_factor) == s.n_atoms
    assert dict(s.left_out) == {} or said


def odd(lines):
    """The same file, as other programs write it."""
    text = "".join(lines)
    return {
        "windows": text.replace("\n", "\r\n"),
        "old macintosh": text.replace("\n", "\r"),
        "byte order mark": "\ufeff" + text,
        "no element": "".join(line[:66].rstrip() + "\n" for line in lines),
        "old columns": "".join(f"{line[:66]}      1ABC{k:4d}\n" for k, line in enumerate(lines, 1)),
        "lower case": "".join(line[:21].lower() + line[21:26] + line[26:].lower() for line in lines),
        "no occupancy": "".join(line[:54] + "\n" for line in lines),
        "scattered": "".join(
            [line for line in lines if line[12:16] != " O  "]
            + [line for line in lines if line[12:16] == " O  "]
        ),
        "hybrid-36": "".join(f"{line[:6]}A{int(line[6:11]):04d}{line[11:]}" for line in lines),
    }


def test_a_last_line_may_lack_its_end(tmp_path):
    """Of a file whose lines end with the coordinates, and of one with elements."""
    lines = atoms_of("1ubq.pdb")
    for columns in (54, 66, 80):
        text = "".join(line[:columns].rstrip() + "\n" for line in lines)
        whole, cut = (pc.load(written(tmp_path, each)) for each in (text, text[:-1]))
        assert np.array_equal(whole.positions, cut.positions) and whole.repairs == cut.repairs


@pytest.mark.parametrize("kind", list(odd([])))
def test_the_same_atoms_written_otherwise_are_the_same_structure(kind, tmp_path):
    lines = atoms_of("1ubq.pdb")
    straight = pc.load(written(tmp_path, "".join(lines) + "END\n"))
    path = tmp_path / "odd.pdb"
    path.write_bytes((odd(lines)[kind] + "END\n").encode())
    s = pc.load(path)
    assert np.array_equal(s.positions, straight.positions) or kind == "scattered"
    assert s.n_atoms == straight.n_atoms and sorted(s.atom_name) == sorted(straight.atom_name)
    if kind in ("lower case", "old columns"):
        assert len(s.repairs) == len(straight.repairs) + 1


def test_a_packed_file_is_read_from_standard_input(monkeypatch):
    text = gzip.compress((STRUCTURES / "1l2y.pdb").read_bytes())
    monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(text)))
    assert np.array_equal(pc.load("-").positions, load("1l2y.pdb").positions)
    assert model_numbers("-") == [1] and pc.load("-", model=1).n_atoms == load("1l2y.pdb").n_atoms


BEYOND_ASCII = [b"\xe9", "é".encode()]


@pytest.mark.parametrize(
    ("column", "quote", "letter"),
    [
        ("label_alt_id", b"", BEYOND_ASCII[0]),
        ("label_atom_id", b"'", BEYOND_ASCII[1]),
        ("auth_asym_id", b"", BEYOND_ASCII[1]),
    ],
)
def test_a_name_that_is_not_ascii_is_refused_in_mmcif_too(letter, quote, column, tmp_path):
    lines = (STRUCTURES / "1ubq.cif").read_bytes().splitlines(keepends=True)
    columns = [line.split(b".")[1].strip().decode() for line in lines if line.startswith(b"_atom_site.")]
    row = next(k for k, line in enumerate(lines) if line.startswith(b"ATOM "))
    words = lines[row].split()
    words[columns.index(column)] = quote + letter + quote
    lines[row] = b" ".join(words) + b"\n"
    (tmp_path / "x.cif").write_bytes(b"".join(lines))
    with pytest.raises(pc.ProtochainError, match=rf"x\.cif: line {row + 1}: column \d+ .* not ASCII"):
        pc.load(tmp_path / "x.cif")


@pytest.mark.parametrize("letter", BEYOND_ASCII)
@pytest.mark.parametrize(
    "record",
    [
        b"REMARK   1 %b\n",
        b"SSBOND   1 CYS %b    5    CYS A   55\n",
        b"LINK         SG  CY%b A   5                 SG  CYS A  55     1555   1555  2.03\n",
    ],
)
def test_other_records_may_hold_anything(letter, record, tmp_path):
    text = "".join(atoms_of("4pti.pdb")).encode()
    (tmp_path / "x.pdb").write_bytes(record % letter + text + b"END\n")
    assert np.array_equal(pc.load(tmp_path / "x.pdb").positions, load("4pti.pdb").positions)


def test_too_much_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("protochain.structure.formats.files.MAX_ATOMS", 100)
    with pytest.raises(pc.ProtochainError, match="more than 100 atoms"):
        parse(STRUCTURES / "1l2y.pdb")
    (tmp_path / "lines.pdb.gz").write_bytes(gzip.compress(b"\n" * 30_000_000))
    with pytest.raises(pc.ProtochainError, match="more than 8 million lines"):
        parse(tmp_path / "lines.pdb.gz")
    (tmp_path / "one.cif").write_bytes(b"data_x\nloop_\n_atom_site.id\n" + b"1 " * 600_000)
    with pytest.raises(pc.ProtochainError, match="a line has over 1000000 characters"):
        parse(tmp_path / "one.cif")


AMINO_ACIDS = {
    name
    for letters in itertools.product(string.ascii_uppercase + string.digits, repeat=3)
    if gemmi.find_tabulated_residue(name := "".join(letters)).is_amino_acid()
}


def test_parents_are_those_of_pdbfixer():
    assert {name: archive_parent(name) for name in substitutions} == substitutions


BY_RULE = {"ASX": "ASN", "GLX": "GLN", "SEC": "CYS", "PYL": "LYS"}


@pytest.mark.parametrize("extra_atom", [False, True])
def test_amino_acids_become_their_parents_or_are_refused_by_name(extra_atom, tmp_path):
    """D forms, tautomers and modified residues, at both ends of a chain and within it."""
    parents = {letter: name for name, letter in residues.STANDARD.items()}
    refused = set()
    sample = {*sorted(AMINO_ACIDS | {*substitutions})[::9], *BY_RULE, *residues.STATE_PARENT, "HYP", "UNK"}
    sample &= AMINO_ACIDS | {*substitutions}
    for name in sample:
        letter = gemmi.find_tabulated_residue(name).one_letter_code.upper()
        parent = substitutions.get(name) or BY_RULE.get(name) or parents.get(letter, "ALA")
        code = residues.STANDARD[parent]
        lines = []
        text = as_text(pc.from_sequence(f"{code}A{code}A{code}"), ".pdb", hydrogens=not extra_atom)
        for line in text.splitlines(keepends=True):
            if line.startswith("ATOM") and line[22:26] in ("   1", "   3", "   5"):
                line = f"{line[:17]}{name}{line[20:]}"
                if extra_atom and line[12:16] == " CA ":
                    lines.append(f"{line[:12]} CQ {line[16:30]}{float(line[30:38]) + 1.4:8.3f}{line[38:]}")
            lines.append(line)
        path = written(tmp_path, "".join(lines))
        try:
            s = pc.load(path, standard_residues=True)
        except pc.ProtochainError as error:
            assert f"{path}: A:" in str(error) and "\n" not in str(error)
            refused.add(name)
        else:
            assert s.residue_name.tolist() == [parent, "ALA", parent, "ALA", parent]
    # Those without a parent; hydroxyproline, which ff14SB has; and what has an atom too many.
    letters = {name: gemmi.find_tabulated_residue(name).one_letter_code for name in AMINO_ACIDS - {*BY_RULE}}
    unknown = {name for name, letter in letters.items() if letter in "XBZUO "}
    unknown -= set() if extra_atom else {"UNK"}  # Of backbone and C-beta it is alanine.
    # Of the names of states, the archive has some for other molecules.
    states = set(residues.STATE_PARENT) - set(substitutions)
    standard = {*residues.STANDARD, *states} if extra_atom else set()
    assert refused == sample & (unknown | {"HYP"} | standard)


SULPHATE = (
    ("S", (1.0, 0.9, 0.5)),
    ("O1", (2.2, 0.5, 1.2)),
    ("O2", (0.2, 1.9, 1.2)),
    ("O3", (1.2, 1.3, -0.9)),
)


@pytest.mark.parametrize(("last", "has_oxygen"), [(False, False), (True, True)])
def test_a_sulphate_is_no_end_of_a_chain(last, has_oxygen, tmp_path):
    """Sulphotyrosine (TYS) of hirudin: its O1 is not the backbone's O, also where that is missing."""
    sequence = "AAY" if last else "AYA"
    place = sequence.index("Y") + 1
    s = pc.from_sequence(sequence)
    lines = []
    for line in as_text(s, ".pdb", hydrogens=False).splitlines(True):
        if line.startswith("ATOM") and line[17:26] == f"TYR A   {place}":
            line = f"HETATM{line[6:17]}TYS{line[20:]}"
            if line[12:16] == " O  " and not has_oxygen:
                continue
            if line[12:16] == " OH ":
                at = [float(line[k : k + 8]) for k in (30, 38, 46)]
                for name, off in SULPHATE:
                    here = "".join(f"{a + b:8.3f}" for a, b in zip(at, off, strict=True))
                    lines.append(f"{line[:12]} {name:<3s}{line[16:30]}{here}{line[54:76]} {name[0]}\n")
        lines.append(line)
    made = pc.load(written(tmp_path, "".join(lines)), standard_residues=True)
    assert made.residue_name.tolist() == s.residue_name.tolist() and made.n_atoms == s.n_atoms
    said = "converted to its standard parent TYR, S, O1, O2, O3 left out"
    assert f"A:TYS{place}: {said}" in sentences(made)
    carbon, oxygen = (
        made.positions[(made.atom_residue == place - 1) & (made.atom_name == name)][0] for name in ("C", "O")
    )
    assert np.linalg.norm(carbon - oxygen) == pytest.approx(0.123, abs=0.005)


@pytest.mark.parametrize("name", ["HIC", "DHI"])
def test_modified_histidines_are_read_with_their_own_atoms(name, tmp_path):
    """4-methylhistidine (HIC) has CZ on NE2; D-histidine (DHI) has no atom more than L-histidine."""
    lines = []
    s = pc.from_sequence("AHA")
    for line in as_text(s, ".pdb", hydrogens=False).splitlines(True):
        lines.append(line.replace("HIS A   2", f"{name} A   2").replace("ATOM  ", "HETATM"))
        if name == "HIC" and line[12:26] == " NE2 HIS A   2":
            x = [float(line[k : k + 8]) + 0.85 for k in (30, 38, 46)]
            at = "".join(f"{value:8.3f}" for value in x)
            lines.append(f"HETATM{line[6:12]} CZ  HIC{line[20:30]}{at}{line[54:76]} C\n")
    made = pc.load(written(tmp_path, "".join(lines)), standard_residues=True)
    assert made.residue_name.tolist() == ["ALA", "HIS", "ALA"]
    assert any(f"A:{name}2" in line for line in sentences(made))
    assert np.isfinite(pc.energy(made, solvent="vacuum")(made.positions)[0])


def test_an_mmcif_file_without_its_last_mark_is_taken_if_its_atoms_are_whole(tmp_path):
    text = (STRUCTURES / "1ubq.cif").read_text().rstrip()
    assert text.endswith("#")
    unmarked = pc.load(written(tmp_path, text.removesuffix("#"), "1ubq.cif"))
    assert np.array_equal(unmarked.positions, load("1ubq.cif").positions)
    lines = text.splitlines(True)
    waters = [k for k, line in enumerate(lines) if line.startswith("HETATM")]
    pc.load(written(tmp_path, "".join(lines[: waters[3]]), "1ubq.cif"))
    last = [k for k, line in enumerate(lines) if line.startswith("ATOM ")][-1]
    for end in (last - 200, last + 1):
        # All that says that the file is whole would be the waters, which are listed.
        with pytest.raises(pc.ProtochainError, match=r"line \d+: the file is cut short; .* a line with #"):
            pc.load(written(tmp_path, "".join(lines[:end]), "1ubq.cif"))
    pc.save(load("1l2y.pdb"), tmp_path / "own.cif")
    own = (tmp_path / "own.cif").read_text().rstrip().rstrip("#\n") + "\n"
    assert np.array_equal(
        pc.load(written(tmp_path, own, "own.cif")).positions, pc.load(STRUCTURES / "1l2y.pdb").positions
    )


def test_the_same_file_gives_the_same_bits_in_another_process():
    code = (
        "import sys, hashlib, protochain as pc\n"
        "print(hashlib.sha256(pc.load(sys.argv[1]).positions.tobytes()).hexdigest())"
    )
    path = MORE_STRUCTURES / "4cup_missing.cif"
    path = path if path.exists() else STRUCTURES / "4pti.pdb"
    there = subprocess.run(
        [sys.executable, "-c", code, str(path)], capture_output=True, text=True, check=True,
        env={**os.environ, "PYTHONPATH": str(ROOT), "PYTHONHASHSEED": "1"},
    )  # fmt: skip
    assert there.stdout.strip() == hashlib.sha256(pc.load(path).positions.tobytes()).hexdigest()


@pytest.mark.parametrize(
    ("name", "method"),
    [
        ("5vav_cyclic.pdb", "lbfgs"), ("1a1p_compstatin.pdb", "hybrid"),
    ],
)  # fmt: skip
def test_rings_and_bridges_stay_closed(name, method):
    s = loaded(name)
    chain, energy = pc.build_chain(s), pc.energy(s)
    r = pc.minimise(chain, energy, method, max_evaluations=150)
    for first, second in chain.loops.tolist():
        usual = 0.204 if s.atom_name[first] == "SG" else 0.1335
        assert abs(np.linalg.norm(r.x[first] - r.x[second]) - usual) < 0.015


@pytest.fixture(params=["pipe", "device", "folder"])
def endless(request, tmp_path):
    """What is no file, to read which may never end; who opens the pipe finds it empty, and is noticed."""
    path, opened = tmp_path / "odd.pdb", []
    if request.param == "device":
        path.symlink_to("/dev/null")  # As /dev/zero, which would fill the memory if it were read.
        yield path
        return
    if request.param == "folder":
        path.mkdir()
        yield path
        return
    os.mkfifo(path)

    def answer():
        end = os.open(path, os.O_WRONLY)  # Waits for a reader.
        opened.append(end)
        os.close(end)

    waiting = threading.Thread(target=answer)
    waiting.start()
    yield path
    assert not opened, "it is read"
    end = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    waiting.join()
    os.close(end)


@pytest.mark.parametrize(
    "call",
    [
        pc.load,
        lambda path: pc.rmsd(STRUCTURES / "ala10.pdb", path),
        lambda path: (
            pc.load(STRUCTURES / "ala10.pdb", forcefield=path) and pc.energy(load("ala10.pdb"), path)
        ),
        lambda path: find_jobs([], BatchSettings(), manifest=path),
    ],
)
def test_what_is_no_file_is_refused_unread(call, endless):
    with pytest.raises(pc.ProtochainError, match=r"odd\.pdb: is not a regular file; give a regular file$"):
        call(endless)


def test_what_is_no_file_is_no_checkpoint(endless):
    with pytest.raises(pc.ProtochainError, match=r"odd\.pdb: is not a checkpoint of a minimisation"):
        pc.minimise(pc.build_chain(load("ala10.pdb")), energy("ala10.pdb"), resume=endless)


def test_a_pipe_that_a_shell_has_opened_is_read():
    """As ``protochain info <(zcat x.pdb.gz)``; but of a batch, whose processes have other pipes."""
    reads, writes = os.pipe()
    with os.fdopen(writes, "wb") as file:
        file.write((STRUCTURES / "ala10.pdb").read_bytes()[: 1 << 15])
    try:
        assert pc.load(f"/dev/fd/{reads}").fingerprint == load("ala10.pdb").fingerprint
        (job,) = find_jobs([f"/dev/fd/{reads}"], BatchSettings())
        (row,) = Task(job, Path("out")).run(1)
        assert row.record["status"] == "refused"
    finally:
        os.close(reads)


ROW = "ATOM      1  CA  ALA A   1      11.104   6.134  -6.504  1.00  0.00           C  \n"
SITES = (
    "group_PDB id type_symbol label_atom_id label_comp_id label_asym_id label_seq_id Cartn_x Cartn_y Cartn_z"
)
CIF = "data_x\nloop_\n" + "".join(f"_atom_site.{each}\n" for each in SITES.split())


@pytest.mark.parametrize(
    "text",
    [ROW * 250_001, CIF + "A 1 C CA ALA A 1 1 2 3\n" * 250_001, "\n" * 2_000_000],
    ids=["PDB", "mmCIF", "empty"],
)
def test_what_packs_into_nothing_is_refused_before_it_is_parsed(text, tmp_path, monkeypatch):
    monkeypatch.setattr(gemmi, "read_pdb_string", None)
    monkeypatch.setattr(gemmi.cif, "read_string", None)
    path = tmp_path / "x.gz"
    path.write_bytes(gzip.compress(text.encode()))
    with pytest.raises(pc.ProtochainError, match=r"x\.gz: (more than 250000 atoms|2000000 lines)"):
        parse(path)
