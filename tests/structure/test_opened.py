"""Files written, as other programs read them: atoms, chains, residues, elements, and bonds of other kinds."""

import numpy as np
import pytest
from fixtures.samples import STRUCTURES

import protochain as pc
from bench.files import file_kinds

KINDS = (
    "plain", "disulfides-unstated", "chains-without-ids", "insertion-codes", "sep", "ace-nme",
    "covalent-stated", "glycerol-in-mmcif", "ion-charges-in-mmcif", "dna-archive-cif",
    "rna-five-prime-triphosphate-pdb",
)  # fmt: skip
ALONG = ({"C", "N"}, {"O3'", "P"})


def gemmi_(path):
    gemmi = pytest.importorskip("gemmi")
    model = gemmi.read_structure(str(path), merge_chain_parts=False)[0]
    atoms = [
        (a.name, a.element.name, r.name, str(r.seqid).strip(), c.name.strip())
        for c in model for r in c for a in r
    ]  # fmt: skip
    return atoms, None


def biotite(path):
    pytest.importorskip("biotite")
    from biotite.structure.io import pdb, pdbx

    if path.suffix == ".pdb":
        made = pdb.PDBFile.read(path).get_structure(model=1, include_bonds=True)
    else:
        made = pdbx.get_structure(pdbx.CIFFile.read(path), model=1, include_bonds=True)
    numbers = [f"{n}{code}".strip() for n, code in zip(made.res_id, made.ins_code, strict=True)]
    elements = [each.capitalize() for each in made.element]
    columns = (made.atom_name, elements, made.res_name, numbers, made.chain_id)
    return [tuple(map(str, row)) for row in zip(*columns, strict=True)], made.bonds.as_array()[:, :2]


def mdanalysis(path):
    pytest.importorskip("MDAnalysis")
    if path.suffix != ".pdb":
        pytest.skip("reads no mmCIF")
    from MDAnalysis import Universe

    made = Universe(str(path)).atoms
    numbers = [f"{n}{code}".strip() for n, code in zip(made.resids, made.icodes, strict=True)]
    elements = [each.capitalize() for each in made.elements]
    columns = (made.names, elements, made.resnames, numbers, made.chainIDs)
    bonds = made.universe.bonds.indices if hasattr(made.universe, "bonds") else ()
    return [tuple(map(str, row)) for row in zip(*columns, strict=True)], bonds


def openmm(path):
    from openmm.app import PDBFile, PDBxFile

    made = (PDBFile if path.suffix == ".pdb" else PDBxFile)(str(path)).topology
    atoms = [
        (a.name, a.element.symbol, a.residue.name, f"{a.residue.id}{a.residue.insertionCode}".strip(),
         a.residue.chain.id.strip())
        for a in made.atoms()
    ]  # fmt: skip
    return atoms, [(a.index, b.index) for a, b in made.bonds()]


def mdtraj(path):
    made = pytest.importorskip("mdtraj").load(str(path)).topology
    atoms = [(a.name, a.element.symbol, a.residue.name, str(a.residue.resSeq), "") for a in made.atoms]
    return atoms, [(a.index, b.index) for a, b in made.bonds]


def pymol(path):
    with pytest.importorskip("pymol2").PyMOL() as session:
        session.cmd.set("retain_order", 1)
        session.cmd.load(str(path), "made")
        made = session.cmd.get_model("made")
    atoms = [(a.name, a.symbol.capitalize(), a.resn, a.resi, a.chain) for a in made.atom]
    return atoms, [each.index for each in made.bond]


READERS = (gemmi_, biotite, mdanalysis, openmm, mdtraj, pymol)
RENAME = (openmm, mdtraj)
"""They call the first hydrogen of a terminus H; mdtraj has no insertion codes and, as OpenMM, label ids."""


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".pdb", ".cif"])
@pytest.mark.parametrize("reader", READERS, ids=[each.__name__.strip("_") for each in READERS])
@pytest.mark.parametrize("name", KINDS)
def test_other_programs_read_what_was_written(name, reader, suffix, tmp_path):
    kind = next(each for each in file_kinds.KINDS if each.name == name)
    s = pc.load(kind.make(tmp_path)[0], **{**kind.options, "keep": "all"})
    pc.save(s, tmp_path / f"out{suffix}")
    atoms, bonds = reader(tmp_path / f"out{suffix}")
    of = s.atom_residue
    numbers = np.char.add(s.residue_number.astype(str), s.residue_insertion_code.astype(str))
    columns = (s.atom_name, s.atom_element, s.residue_name_in_file[of], numbers[of], s.residue_chain[of])
    expected = [tuple(map(str, row)) for row in zip(*columns, strict=True)]
    which = (1, 2) if reader in RENAME else range(5)
    assert [[row[k] for k in which] for row in atoms] == [[row[k] for k in which] for row in expected]
    if bonds is None:
        return
    read = {frozenset(map(int, pair)) for pair in bonds}
    for pair in s.bonds.tolist():
        names = {str(s.atom_name[k]) for k in pair}
        is_link = of[pair[0]] != of[pair[1]] and names not in ALONG
        # OpenMM looks up label ids of links among chain ids: a blank chain and a ligand have others.
        has_others = reader in RENAME and suffix == ".cif"
        has_others &= bool(s.kept[pair].any() or "" in s.residue_chain[of[pair]])
        if is_link and not has_others:
            assert frozenset(pair) in read, [expected[k] for k in pair]


def test_a_table_of_bonds_has_those_of_every_component(tmp_path):
    """PyMOL takes the table of a ligand's bonds for that of all."""
    kind = next(each for each in file_kinds.KINDS if each.name == "glycerol-in-mmcif")
    s = pc.load(kind.make(tmp_path)[0])
    pc.save(s, tmp_path / "out.cif")
    gemmi = pytest.importorskip("gemmi")
    rows = gemmi.cif.read(str(tmp_path / "out.cif")).sole_block().find("_chem_comp_bond.", ["comp_id"])
    assert {row.str(0) for row in rows} == {*map(str, s.residue_name)} and len({*s.residue_name}) > 10
    assert pc.load(STRUCTURES / "1l2y.pdb").n_atoms + 14 == s.n_atoms
