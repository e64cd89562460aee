"""A file written keeps what the file read said: title, cell, sequence, helices, labels, occupancies."""

import bz2
import functools
import gzip
import lzma

import gemmi
import numpy as np
import pytest
from fixtures.samples import STRUCTURES, load, shared

import protochain as pc
from protochain.structure.molecule import header
from protochain.structure.write import as_text, check_fits

ENTRIES = (
    "1ejg.pdb", "3i40.pdb", "1fas_fasciculin.cif", "1orc_icode.pdb", "1a8o_mse.cif", "1bhl_gap_cas.pdb",
)  # fmt: skip
PARENTS = {"MSE": "MET", "CAS": "CYS"}


def path_of(name):
    return STRUCTURES / name if (STRUCTURES / name).exists() else shared(name)


@functools.cache
def read(name):
    """What gemmi reads in a file, and what is loaded of it."""
    path = path_of(name)
    source = gemmi.read_structure(str(path), merge_chain_parts=True)
    source.setup_entities()
    source.assign_label_seq_id()
    return source, pc.load(path)


def written(structure, suffix, tmp_path):
    """What gemmi reads in the file written."""
    pc.save(structure, tmp_path / f"out{suffix}")
    out = gemmi.read_structure(str(tmp_path / f"out{suffix}"), merge_chain_parts=True)
    out.setup_entities()
    return out


def helices(structure):
    return [
        (each.start.chain_name, each.start.res_id.seqid, each.end.res_id.seqid, each.pdb_helix_class,
         each.length)
        for each in structure.helices
    ]  # fmt: skip


def strands(structure):
    return [
        (sheet.name, each.start.chain_name, each.start.res_id.seqid, each.end.res_id.seqid, each.sense,
         each.hbond_atom1.atom_name, each.hbond_atom1.res_id.seqid, each.hbond_atom2.res_id.seqid)
        for sheet in structure.sheets for each in sheet.strands
    ]  # fmt: skip


def sequences(structure):
    """Sequence of each chain of the protein, as the file gives it."""
    found = {}
    for chain in structure[0]:
        entity = structure.get_entity_of(chain.get_polymer())
        if entity and entity.full_sequence:
            found[chain.name] = [gemmi.Entity.first_mon(each) for each in entity.full_sequence]
    return found


@pytest.mark.parametrize("suffix", [".pdb", ".cif"])
@pytest.mark.parametrize("name", ENTRIES)
def test_what_the_file_says_is_in_the_file_written(name, suffix, tmp_path):
    source, s = read(name)
    out = written(s, suffix, tmp_path)
    titles = [each.info["_struct.title"] for each in (out, source)]
    # PDB files have titles in capitals, broken at blanks and hyphens.
    assert titles[0] == titles[1] or (
        suffix == ".pdb" and titles[0].replace(" ", "") == titles[1].upper().replace(" ", "")
    )
    assert out.cell.parameters == pytest.approx(source.cell.parameters) and out.cell.is_crystal()
    assert out.spacegroup_hm == source.spacegroup_hm and out.info["_cell.Z_PDB"] == source.info["_cell.Z_PDB"]
    assert helices(out) == helices(source) and strands(out) == strands(source)
    assert len(out.helices) + len(out.sheets) > 0
    expected = {
        chain: [PARENTS.get(mon, mon) for mon in sequence] for chain, sequence in sequences(source).items()
    }
    if name == "1ejg.pdb":
        # 22 and 25 are each two residues in one place; the sequence tells of those that are there.
        assert expected["A"][21] == "PRO" and s.residue_name[21] == "PRO"
    assert sequences(out) == expected and expected
    assert len(out.cispeps) == {"1fas_fasciculin.cif": 2, "1orc_icode.pdb": 1}.get(name, 0)


SECONDARY = """\
HELIX    1  H1 ILE A   23  GLU B   34  1                                  12
HELIX    2  H2 MSE A   56  TYR A   59  5                                   4
SHEET    1 BET 5 GLY B  10  VAL A  17  0
SHEET    2 BET 5 MSE A   1  THR A   7 -1  N  THR A   7   O  GLY B  10
SHEET    3 BET 5 GLU A  64  ARG B  72  1  N  LEU A  67   O  VAL A   5
SHEET    4 BET 5 GLN A  40  PHE A  45 -1  N  ILE A  44   O  VAL B  70
SHEET    5 BET 5 LYS A  48  LEU A  50 -1  N  LYS A  48   O  PHE A  45
SHEET    1 ODD 1 GLU A  64  ARG B  72  0
"""


@pytest.mark.parametrize("suffix", [".pdb", ".cif"])
def test_helices_and_strands_are_of_residues_that_are_there_under_their_names(suffix, tmp_path):
    """What ends where a residue is left out goes, here a chain; a sheet begins with its next strand."""
    text = SECONDARY
    for line in (STRUCTURES / "1ubq.pdb").read_text().splitlines(keepends=True):
        number, name = line[22:26].strip(), line[12:16].strip()
        if line.startswith("ATOM") and number in ("10", "34", "70", "72"):
            text += line[:21] + "B" + line[22:]
        elif line.startswith("ATOM") and number in ("1", "56"):
            text += (line[:17] + "MSE" + line[20:]) * (name in ("N", "CA", "C", "O", "CB"))
        elif line.startswith("ATOM"):
            text += line
    (tmp_path / "in.pdb").write_text(text)
    out = written(pc.load(tmp_path / "in.pdb", chains="A"), suffix, tmp_path)
    (helix,), (sheet,) = out.helices, out.sheets
    assert [str(end.res_id) for end in (helix.start, helix.end)] == ["56(MET)", "59(TYR)"]
    found = [
        (*map(str, (s.start.res_id, s.end.res_id)), s.sense, s.hbond_atom1.atom_name) for s in sheet.strands
    ]
    assert found == [
        ("1(MET)", "7(THR)", 0, ""), ("40(GLN)", "45(PHE)", -1, ""), ("48(LYS)", "50(LEU)", -1, "O"),
    ]  # fmt: skip


def test_residues_of_the_sequence_that_are_not_there_are_components():
    text = as_text(read("2beg_abeta_fibril.pdb")[1], ".cif")
    block = gemmi.cif.read_string(text).sole_block()
    named = {row.str(0) for row in block.find("_chem_comp.", ["id"])}
    assert {row.str(0) for row in block.find("_entity_poly_seq.", ["mon_id"])} <= named


def test_new_label_ids_are_told(tmp_path):
    """Two polymers under one chain id."""
    source = gemmi.read_structure(str(STRUCTURES / "3i40.pdb"))
    for residue in source[0]["B"]:
        residue.seqid.num += 100
    source[0]["B"].name = "A"
    source.setup_entities()
    for chain, label in zip(source[0], "PQ", strict=True):
        for residue in chain:
            residue.subchain = label if residue.entity_type == gemmi.EntityType.Polymer else residue.subchain
    source.make_mmcif_document().write_file(str(tmp_path / "a.cif"))
    (line,) = check_fits(pc.load(tmp_path / "a.cif"), tmp_path / "b.cif")
    assert "P is A" in line and "Q is A2" in line
    assert check_fits(read("1ubq.cif")[1], tmp_path / "b.cif") == []


@pytest.mark.parametrize("suffix", [".pdb", ".cif"])
@pytest.mark.parametrize("name", ["1ejg.pdb", "1bhl_gap_cas.pdb"])
def test_occupancies_are_those_of_the_file_and_added_hydrogens_have_their_parents(name, suffix, tmp_path):
    source, s = read(name)
    given: dict[tuple[str, ...], set[float]] = {}
    for at in source[0].all():
        place = (at.chain.name, str(at.residue.seqid), at.residue.name, at.atom.name)
        given.setdefault(place, set()).add(at.atom.occ)
    out = written(s, suffix, tmp_path)
    partial = 0
    parent = 1.0
    for at in out[0].all():
        place = (at.chain.name, str(at.residue.seqid), at.residue.name, at.atom.name)
        if at.atom.is_hydrogen():
            in_file = given.get(place, set())
            assert min(abs(at.atom.occ - occ) for occ in (parent, *in_file)) < 0.006, place
            continue
        parent = at.atom.occ
        partial += parent < 0.99
        if at.residue.name not in PARENTS.values():
            assert min(abs(parent - occ) for occ in given.get(place, {1.0})) < 0.006, place
    assert partial > 0
    assert not s.occupancy.flags.writeable and s.occupancy.shape == (s.n_atoms,)


@pytest.mark.parametrize(
    "name",
    [
        *("1ubq.cif", "1a8o_mse.cif"),
        pytest.param("3o21_1489.cif", marks=pytest.mark.slow),
    ],
)
def test_label_ids_are_those_of_the_file(name, tmp_path):
    path = path_of(name)
    source = gemmi.read_structure(str(path), merge_chain_parts=True)
    labels = {
        (chain.name, str(residue.seqid)): (residue.subchain, residue.label_seq, residue.entity_id)
        for chain in source[0]
        for residue in chain.get_polymer()
    }
    _, s = read(name)
    out = written(s, ".cif", tmp_path)
    found = {
        (chain.name, str(residue.seqid)): (residue.subchain, residue.label_seq, residue.entity_id)
        for chain in out[0]
        for residue in chain
        if residue.entity_type == gemmi.EntityType.Polymer
    }
    assert len(found) == len(np.unique(s.atom_residue[~s.kept]))
    assert {place: labels[place] for place in found} == found
    # Every place in a sequence is that of its residue.
    table = gemmi.cif.read(str(tmp_path / "out.cif"))[0].find(
        "_atom_site.", ["label_entity_id", "label_seq_id", "label_comp_id"]
    )
    sequence = {entity.name: entity.full_sequence for entity in out.entities}
    for entity, place, mon in table:
        assert place == "." or mon in sequence[entity][int(place) - 1].split(",")


def test_the_parts_of_a_chain_that_the_file_calls_one_molecule_stay_one(tmp_path):
    lines = (STRUCTURES / "1ubq.cif").read_text().splitlines(True)
    columns = [line.split(".")[1].strip() for line in lines if line.startswith("_atom_site.")]
    place = columns.index("label_seq_id")
    gone = [line for line in lines if not (line[:5] == "ATOM " and 30 <= int(line.split()[place]) <= 33)]
    (tmp_path / "in.cif").write_text("".join(gone))
    s = pc.load(tmp_path / "in.cif")
    assert s.n_chains == 2
    (chain,) = written(s, ".cif", tmp_path)[0]
    assert {residue.subchain for residue in chain} == {"A"}
    assert [residue.label_seq for residue in chain] == [*range(1, 30), *range(34, 77)]
    assert pc.load(tmp_path / "out.cif").n_chains == 2


def test_kept_waters_and_ions_keep_their_labels_and_kinds(tmp_path):
    s = pc.load(shared("1fas_fasciculin.cif"), keep=("water",))
    out = written(s, ".cif", tmp_path)
    kinds = {entity.name: (entity.entity_type, list(entity.subchains)) for entity in out.entities}
    assert kinds == {"1": (gemmi.EntityType.Polymer, ["A"]), "2": (gemmi.EntityType.Water, ["B"])}
    written(s, ".pdb", tmp_path)
    text = (tmp_path / "out.pdb").read_text()
    assert text.count("\nTER") == 1 and text.index("\nTER") < text.index("\nHETATM")
    assert pc.load(tmp_path / "out.pdb", keep=("water",)).obstacle.sum() == s.obstacle.sum()


@pytest.mark.parametrize("suffix", [".pdb", ".cif"])
def test_an_output_that_is_read_again_is_written_the_same(suffix, tmp_path):
    _, s = read("1a8o_mse.cif")
    first = tmp_path / f"first{suffix}"
    pc.save(s, first)
    again = pc.load(first)
    pc.save(again, tmp_path / f"again{suffix}")
    head, tail = ("data_first", "data_again") if suffix == ".cif" else ("", "")

    def kept(path):
        lines = path.read_text().replace(head, tail).replace(" first", " again").splitlines()
        return [line for line in lines if "REMARK" not in line and "_protochain" not in line]

    if suffix == ".pdb":
        assert kept(first) == kept(tmp_path / "again.pdb")
    else:
        one, other = (gemmi.read_structure(str(tmp_path / f"{n}.cif")) for n in ("first", "again"))
        # Their names are those of the files.
        heads = [each.make_pdb_headers().partition("TITLE")[2] for each in (one, other)]
        assert heads[0] == heads[1] != ""
        assert [r.subchain for c in one[0] for r in c] == [r.subchain for c in other[0] for r in c]


@pytest.mark.parametrize("name", ["x.pdb.gz", "x.cif.gz", "x.pdbx", "x.ent", "x.mmcif.xz", "x.pdb.bz2"])
def test_the_suffix_decides_format_and_packing(name, tmp_path):
    s = load("ala10.pdb")
    pc.save(s, tmp_path / name)
    again = pc.load(tmp_path / name)
    assert np.abs(again.positions - s.positions).max() < 1e-4 and again.name == "x"
    data = (tmp_path / name).read_bytes()
    pc.save(s, tmp_path / name)
    assert (tmp_path / name).read_bytes() == data, "the same structure gives the same bytes"
    unpack = {"gz": gzip.decompress, "bz2": bz2.decompress, "xz": lzma.decompress}.get(
        name.rpartition(".")[2], bytes
    )
    assert unpack(data).startswith(b"data_" if "cif" in name or "pdbx" in name else b"REMARK")


def test_two_names_at_one_place_of_a_sequence_stand_with_a_comma_between():
    """As mmCIF writes microheterogeneity; an entity without that place does not fit."""
    entity = gemmi.Entity("1")
    entity.entity_type, entity.subchains = gemmi.EntityType.Polymer, ["A"]
    entity.full_sequence = ["GLY", "UNK", "ALA"]
    there = []
    for place, name in ((1, "GLY"), (2, "SER"), (2, "PRO"), (2, "SER")):
        residue = gemmi.Residue()
        residue.name, residue.label_seq, residue.entity_type = name, place, gemmi.EntityType.Polymer
        there.append(residue)
    assert header._fits(entity, {"A": there})
    assert list(entity.full_sequence) == ["GLY", "SER,PRO", "ALA"]
    there[0].label_seq = 4
    assert not header._fits(entity, {"A": there})
