"""The invariant of readers: atom records in a file = atoms read + atoms reported as removed."""

import re
from collections import Counter

import gemmi
import numpy as np
import pytest
from fixtures.samples import ROOT, STRUCTURES, load

import protochain as pc
from protochain.ligands.dictionary import component
from protochain.structure.formats.files import parse
from protochain.structure.molecule.repairs import Kind
from protochain.structure.write import as_text

SHARED = ROOT.parent / "shared"
SUFFIXES = (".pdb", ".cif", ".ent", ".gro", ".pqr", ".bcif", ".gz")
FEW = 400_000
"""Bytes of the files that are read by default; larger ones are slow."""
RECORD = re.compile(r"\s*(ATOM[\s\d]{2}|HETATM).{24}\s*-?\d*\.\d", re.IGNORECASE)


def files():
    """Structure files of the repository and of the collection, those of the fast subset unmarked."""
    paths = [p for top in (STRUCTURES, SHARED) for p in sorted(top.rglob("*")) if p.suffix in SUFFIXES]
    found = []
    for k, path in enumerate(paths):
        is_fast = path.parent == STRUCTURES or (k % 12 == 0 and path.stat().st_size < FEW)
        name = str(path.relative_to(ROOT if path.is_relative_to(ROOT) else SHARED))
        found.append(pytest.param(path, id=name, marks=[] if is_fast else pytest.mark.slow))
    return found


def n_records(text):
    """Atom records of a text, counted without a reader of structures."""
    if any(line.startswith("_atom_site.") for line in text.splitlines()):
        return sum(len(block.find_loop("_atom_site.Cartn_x")) for block in gemmi.cif.read_string(text))
    return sum(bool(RECORD.match(line)) for line in text.splitlines())


def n_read(path):
    """Atoms read, with those of the data blocks that are reported as removed."""
    structure, repairs, *_ = parse(path)
    read = sum(model.count_atom_sites() for model in structure)
    names = [n for repair in repairs if repair.kind is Kind.BLOCKS_LEFT_OUT for n in repair.facts["others"]]
    blocks = gemmi.cif.read_string(text_of(path)) if names else {}
    return read + sum(len(blocks[name].find_loop("_atom_site.Cartn_x")) for name in names)


def text_of(path):
    data = path.read_bytes()
    if data[:2] == b"\x1f\x8b":
        import gzip

        data = gzip.decompress(data)
    return data.decode("utf-16" if data[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8", "replace")


@pytest.mark.parametrize("path", files())
def test_the_reader_reads_every_atom_record(path):
    if path.suffix in (".gro", ".pqr", ".bcif"):
        import MDAnalysis

        expected = len(MDAnalysis.Universe(str(path)).atoms)
    else:
        expected = n_records(text_of(path))
    if not expected:
        pytest.skip("the file has no atoms")
    try:
        assert n_read(path) == expected
    except pc.ProtochainError as error:
        assert str(path) in str(error)  # A refusal reads nothing, and names the file.


def is_water(name):
    """Whether a residue is a water by its name, also by those of Maestro."""
    return name in ("SPC", "T4P") or gemmi.find_tabulated_residue(name).is_water()


def removed(structure):
    """Heavy atoms of the file that a structure lacks, by chain, number, residue and atom name."""
    places = {*structure.origin.place.tolist()}
    names = [name.split("/") for k, name in enumerate(structure.origin.atoms) if k not in places]
    return [each for each in names if not re.match(r"\d*[HD]", each[3])]


@pytest.mark.parametrize("path", files())
def test_every_heavy_atom_that_a_structure_lacks_is_reported(path):
    """By a loss, by the count of its kind of molecule, or as one of several states of its residue."""
    try:
        s = pc.load(path)
    except pc.ProtochainError:
        pytest.skip("the file is refused")
    lost = {(each.chain, each.number, name) for each in s.losses for name in each.atoms}
    by_state = {
        (residue.chain, residue.number)
        for repair in s.repairs
        if repair.kind in (Kind.ALTERNATES, Kind.EXCLUDED, Kind.REPEATED, Kind.NO_PLACE, Kind.VIRTUAL)
        for residue in [repair.facts["residue"]]
    }
    unexplained = Counter()
    for chain, number, residue, atom, *altloc in removed(s):
        if not altloc and (chain, number, atom) not in lost and (chain, number) not in by_state:
            unexplained[residue, chain, number] += 1
    kinds = Counter("waters" if is_water(name) else name for name, *_ in unexplained)
    assert not {kind: n for kind, n in kinds.items() if s.left_out.get(kind, 0) < n}


LINES = [line for line in as_text(load("1l2y.pdb"), ".pdb").splitlines() if line.startswith("ATOM")]
RING = [
    f"HETATM{k:5d}  C{k}  BNZ B   1    {x:8.3f}{y:8.3f}   8.501  1.00  0.00           C"
    for k, (x, y) in enumerate(
        [(1.492, 0.019), (0.797, 1.222), (-0.593, 1.222), (-1.288, 0.019), (-0.593, -1.185), (0.797, -1.185)],
        1,
    )
]
CONECT = [f"CONECT{k:5d}{k % 6 + 1:5d}" + f"{k % 6 + 1:5d}" * (k % 2) for k in range(1, 7)]


def written(path, *lines):
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.mark.parametrize(
    "lines",
    [
        (*LINES, "END", *RING, "END"), (*LINES, "TER", "ENDMDL", *RING, "END"), (*RING, "END", *LINES),
        ("MODEL        1", *LINES, "ENDMDL", *RING, "END"), (*LINES, "END", "END", *RING),
        (*LINES[:100], "END", *LINES[100:], "END", *RING), (*LINES, "END", *RING, *CONECT, "END"),
        ("HEADER    X", *(f"  {line}" for line in LINES), *(f"\t{line}" for line in RING), "END"),
    ],
)  # fmt: skip
def test_atoms_after_an_end_record_and_indented_atoms_belong_to_the_structure(lines, tmp_path):
    """The reference is the same file with all atoms before one END."""
    plain = pc.load(written(tmp_path / "plain.pdb", *LINES, "TER", *RING, "END"))
    s = pc.load(written(tmp_path / "x.pdb", *lines))
    assert (s.n_residues, s.n_atoms) == (21, 316) and s.losses == ()
    key = {
        (str(n), c): x
        for n, c, x in zip(s.atom_name, s.residue_chain[s.atom_residue], s.positions.tolist(), strict=True)
    }
    for name in ("C1", "C4", "H1"):
        place = (s.atom_name == name) & (s.residue_name[s.atom_residue] == "BNZ")
        other = (plain.atom_name == name) & (plain.residue_name[plain.atom_residue] == "BNZ")
        assert s.positions[place] == pytest.approx(plain.positions[other], abs=1e-6)
    assert key and sum(r.kind in (Kind.SEGMENTS_JOINED, Kind.INDENTED) for r in s.repairs) == 1


@pytest.mark.parametrize("mark", ["END", "ENDMDL"])
def test_frames_that_end_records_separate_are_models(mark, tmp_path):
    moved = [f"{line[:30]}{float(line[30:38]) + 1:8.3f}{line[38:]}" for line in LINES]
    path = written(tmp_path / "x.pdb", "CRYST1", *LINES, "TER", mark, *moved, mark, "", "END", "notes")
    s = pc.load(path)
    (repair,) = [r for r in s.repairs if r.kind is Kind.MODELS_LEFT_OUT]
    assert repair.facts["count"] == 1 and s.n_atoms == len(LINES)
    assert pc.load(path, model=2).positions - s.positions == pytest.approx(
        np.tile([0.1, 0.0, 0.0], (s.n_atoms, 1)), abs=1e-6
    )


def test_atoms_outside_several_models_are_refused_with_their_line(tmp_path):
    lines = ("MODEL        1", *LINES, "ENDMDL", "MODEL        2", *LINES, "ENDMDL", *RING, "END")
    with pytest.raises(pc.ProtochainError, match=rf"line {2 * len(LINES) + 5}: atom records outside the 2"):
        pc.load(written(tmp_path / "x.pdb", *lines))


def test_an_mmcif_file_needs_no_last_mark(tmp_path):
    """The grammar of CIF has none; a missing end is reported."""
    text = as_text(load("1l2y.pdb"), ".cif").rstrip().removesuffix("#")
    rows = text.splitlines()
    end = max(k for k, line in enumerate(rows) if line.startswith("ATOM"))
    last = max(k for k in range(end) if rows[k].startswith("ATOM") and " SER A" not in rows[k])
    names = ("_entity_poly_seq.", "_struct_asym.")
    assert any(line.startswith(names) for line in rows)
    whole = pc.load(written(tmp_path / "a.cif", text))
    assert not [r for r in whole.repairs if r.kind is Kind.NO_END]
    cut = pc.load(written(tmp_path / "b.cif", *rows[: last + 1]))
    assert cut.n_residues == 19 and [r for r in cut.repairs if r.kind is Kind.NO_END]


@pytest.mark.parametrize("name", ["HEM", "HEC", "CLA", "NAP"])
def test_left_aligned_names_without_elements_are_read_by_the_dictionary(name, tmp_path):
    """The elements are those of the Chemical Component Dictionary."""
    pytest.importorskip("biotite")
    info = component(name)
    heavy = info.element != "H"
    ligand = [
        f"HETATM{k:5d} {atom:<4} {name} B   1    {x:8.3f}{y:8.3f}{z:8.3f}  1.00  0.00"
        for k, (atom, (x, y, z)) in enumerate(
            zip(info.atom_name[heavy], info.coord[heavy] + 25.0, strict=True), 400
        )
    ]
    protein = [f"{line[:12]}{line[12:16].strip():<4}{line[16:66]}" for line in LINES]
    s = pc.load(written(tmp_path / "x.pdb", *protein, "TER", *ligand, "END"), keep="all")
    own = s.residue_name[s.atom_residue] == name
    read = dict(zip(s.atom_name[own].tolist(), s.atom_element[own].tolist(), strict=True))
    expected = dict(zip(info.atom_name[heavy].tolist(), info.element[heavy].tolist(), strict=True))
    assert {atom: read.get(atom, "").upper() for atom in expected} == {
        a: e.upper() for a, e in expected.items()
    }


def test_left_aligned_names_of_an_unknown_molecule_give_organic_elements(tmp_path):
    ligand = [
        f"HETATM{k:5d} {atom:<4} QQ1 B   1    {x:8.3f}{20.0:8.3f}{20.0:8.3f}  1.00  0.00"
        for k, (atom, x) in enumerate([("CA", 20.0), ("CD1", 21.5), ("NA", 23.0), ("CL1", 24.7)], 400)
    ]
    protein = [f"{line[:12]}{line[12:16].strip():<4}{line[16:66]}" for line in LINES]
    s = pc.load(written(tmp_path / "x.pdb", *protein, "TER", *ligand, "END"), keep="all")
    assert s.atom_element[s.residue_name[s.atom_residue] == "QQ1"].tolist()[:4] == ["C", "C", "N", "Cl"]
