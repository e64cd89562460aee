"""Files of other programs hold the same atoms; assemblies are what their operators make."""

import gemmi
import numpy as np
import pytest
from fixtures.samples import STRUCTURES, load

import protochain as pc
from bench.files.recipes import binary_cif
from protochain.structure.formats import foreign

NAME = "3i40.pdb"


def bcif(structure, path):
    pc.save(structure, path.with_suffix(".cif"))
    path.write_bytes(binary_cif(path.with_suffix(".cif").read_text()))


def by_mdanalysis(structure, path):
    universe = pc.to_mdanalysis(structure)
    universe.dimensions = [80, 80, 80, 90, 90, 90]
    universe.add_TopologyAttr("charges", np.linspace(-1, 1, structure.n_atoms))
    universe.add_TopologyAttr("radii", np.full(structure.n_atoms, 1.5))
    universe.add_TopologyAttr("record_types", ["ATOM"] * structure.n_atoms)
    universe.atoms.write(str(path))


def amber(structure, path):
    """A topology with what says which atoms there are, and positions in a file of the same name."""

    def section(name, values, form, width, per_line):
        rows = [values[k : k + per_line] for k in range(0, len(values), per_line)] or [[]]
        text = "\n".join("".join(f"{value:{width}}" for value in row) for row in rows)
        return f"%FLAG {name}\n%FORMAT({form})\n{text}\n"

    n = structure.n_atoms
    starts = [1 + int(np.flatnonzero(structure.atom_residue == r)[0]) for r in range(structure.n_residues)]
    numbers = [gemmi.Element(str(e)).atomic_number for e in structure.atom_element]
    ends = np.array([structure.atom_element[list(pair)] == "H" for pair in structure.bonds]).any(axis=1)
    with_h, without_h = (
        [v for i, j in structure.bonds[mask].tolist() for v in (3 * i, 3 * j, 1)] for mask in (ends, ~ends)
    )
    pointers = [n, 1, len(with_h) // 3, len(without_h) // 3, *[0] * 7, structure.n_residues, *[0] * 19]
    path.write_text(
        "%VERSION  VERSION_STAMP = V0001.000  DATE = 01/01/26  00:00:00\n"
        + section("TITLE", ["x"], "20a4", "<80", 1)
        + section("POINTERS", pointers, "10I8", ">8", 10)
        + section("ATOM_NAME", structure.atom_name.tolist(), "20a4", "<4", 20)
        + section("CHARGE", [0.0] * n, "5E16.8", ">16.8E", 5)
        + section("ATOMIC_NUMBER", numbers, "10I8", ">8", 10)
        + section("MASS", [float(m) for m in structure.atom_mass], "5E16.8", ">16.8E", 5)
        + section("ATOM_TYPE_INDEX", [1] * n, "10I8", ">8", 10)
        + section("RESIDUE_LABEL", structure.residue_name.tolist(), "20a4", "<4", 20)
        + section("RESIDUE_POINTER", starts, "10I8", ">8", 10)
        + section("BONDS_INC_HYDROGEN", with_h, "10I8", ">8", 10)
        + section("BONDS_WITHOUT_HYDROGEN", without_h, "10I8", ">8", 10)
        + "".join(
            section(f"{what}_{which}_HYDROGEN", [], "10I8", ">8", 10)
            for what in ("ANGLES", "DIHEDRALS")
            for which in ("INC", "WITHOUT")
        )
        + section("AMBER_ATOM_TYPE", ["X"] * n, "20a4", "<4", 20)
    )
    x = (10.0 * structure.positions).ravel()
    rows = ["".join(f"{value:12.7f}" for value in x[k : k + 6]) for k in range(0, len(x), 6)]
    path.with_suffix(".rst7").write_text("\n".join(["x", f"{n:5d}", *rows, ""]))


@pytest.mark.parametrize(
    ("name", "write", "rounding"),
    [
        ("x.cif.zst", pc.save, 1e-6), ("x.bcif", bcif, 1e-6), ("x.gro", by_mdanalysis, 6e-4),
        ("x.pqr", by_mdanalysis, 6e-5), ("x.crd", by_mdanalysis, 1e-5), ("x.prmtop", amber, 1e-6),
    ],
)  # fmt: skip
def test_a_file_of_another_program_has_the_same_atoms(name, write, rounding, tmp_path):
    s = load(NAME)
    write(s, tmp_path / name)
    read = pc.load(tmp_path / name)
    assert read.n_atoms == s.n_atoms and read.n_chains == s.n_chains == 2
    assert read.residue_name.tolist() == s.residue_name.tolist()
    assert sorted(map(tuple, read.bonds.tolist())) == sorted(map(tuple, s.bonds.tolist()))
    assert np.abs(read.positions - s.positions).max() < rounding
    if name.endswith(("gro", "pqr", "prmtop")):
        assert np.isnan(read.b_factor).all() and (read.occupancy == 1.0).all()


def test_the_other_file_of_a_pair_is_named_where_it_is_not(tmp_path):
    amber(load(NAME), tmp_path / "x.prmtop")
    (tmp_path / "x.rst7").rename(tmp_path / "y.rst7")
    with pytest.raises(
        pc.ProtochainError, match=r"x.prmtop: its coordinate file is missing; put one of x.inp"
    ):
        pc.load(tmp_path / "x.prmtop")
    with pytest.raises(
        pc.ProtochainError, match=r"y.rst7: its topology file is missing; put one of y.prmtop"
    ):
        pc.load(tmp_path / "y.rst7")


@pytest.mark.parametrize("name", ["x.bcif", "x.prmtop", "x.cif.zst"])
def test_a_cut_file_is_refused_in_one_line(name, tmp_path):
    write = {"x.bcif": bcif, "x.prmtop": amber, "x.cif.zst": pc.save}[name]
    write(load(NAME), tmp_path / name)
    data = (tmp_path / name).read_bytes()
    (tmp_path / name).write_bytes(data[: len(data) // 2])
    with pytest.raises(pc.ProtochainError) as refused:
        pc.load(tmp_path / name)
    assert str(refused.value).startswith(f"{tmp_path / name}: ") and "\n" not in str(refused.value)


def test_an_assembly_is_its_operators_applied(tmp_path):
    s = load("1l2y.pdb")
    made = gemmi.read_pdb_string(
        "REMARK 350 BIOMOLECULE: 1\nREMARK 350 APPLY THE FOLLOWING TO CHAINS: A\n"
        "REMARK 350   BIOMT1   1  1.000000  0.000000  0.000000        0.00000\n"
        "REMARK 350   BIOMT2   1  0.000000  1.000000  0.000000        0.00000\n"
        "REMARK 350   BIOMT3   1  0.000000  0.000000  1.000000        0.00000\n"
        "REMARK 350   BIOMT1   2 -1.000000  0.000000  0.000000       40.00000\n"
        "REMARK 350   BIOMT2   2  0.000000 -1.000000  0.000000        5.00000\n"
        "REMARK 350   BIOMT3   2  0.000000  0.000000  1.000000        0.00000\n"
        + "".join(
            line + "\n" for line in (STRUCTURES / "1l2y.pdb").read_text().split("ENDMDL")[0].split("\n")
            if line.startswith("ATOM")
        )
    )  # fmt: skip
    made.setup_entities()
    made.make_mmcif_document().write_file(str(tmp_path / "x.cif"))
    (tmp_path / "x.pdb").write_text(made.make_pdb_string())
    for path in (tmp_path / "x.cif", tmp_path / "x.pdb"):
        both = pc.load(path, assembly="1")
        assert [*dict.fromkeys(both.residue_chain.tolist())] == ["A", "B"]
        first, second = np.split(both.positions, 2)
        assert first == pytest.approx(s.positions, abs=1e-4)
        assert second == pytest.approx(first * [-1, -1, 1] + [4.0, 0.5, 0.0], abs=1e-4)
        pc.save(both, tmp_path / "y.cif")
        assert pc.load(tmp_path / "y.cif").n_residues == 2 * s.n_residues
        with pytest.raises(pc.ProtochainError, match="has no assembly 2; it has 1"):
            pc.load(path, assembly="2")
    with pytest.raises(pc.ProtochainError, match="has no assembly 1; it states none"):
        pc.load(STRUCTURES / "ala10.pdb", assembly="1")


def test_marks_of_a_binary_column_are_those_of_text():
    pdbx = pytest.importorskip("biotite.structure.io.pdbx")
    column = pdbx.BinaryCIFColumn(np.array(["a", "", ""]), np.array([0, 1, 2], dtype=np.uint8))
    assert foreign._values(column) == ["a", False, None]
    block = gemmi.cif.Document().add_new_block("x")
    block.set_mmcif_category("_y.", {"z": foreign._values(column)})
    assert [*block.find_values("_y.z")] == ["a", ".", "?"]


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be"])
@pytest.mark.parametrize("name", ["1l2y.pdb", "1ubq.cif"])
def test_text_of_two_bytes_a_letter_is_read(name, encoding, tmp_path):
    path = tmp_path / name
    path.write_bytes((STRUCTURES / name).read_text().encode(encoding))
    assert np.array_equal(pc.load(path).positions, load(name).positions)
