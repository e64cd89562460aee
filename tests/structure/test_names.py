"""Names of residues that mean several things, by the atoms that are there; and names of D-amino acids."""

import gemmi
import numpy as np
import pytest
from fixtures.repairs import sentences
from fixtures.samples import STRUCTURES
from fixtures.tolerances import PDB_ROUNDING_NM

import protochain as pc
from protochain.minimisers.restraints import ChiralityRestraint
from protochain.structure.molecule.repairs import Kind, Reason
from protochain.structure.molecule.residues import D_NAMES
from protochain.structure.write import as_text

BACKBONE = ("N", "CA", "C", "O")


def amino_acid(letter, name, gone=(), more=()):
    """Alanines with one residue of another name between them, and further atoms at its side chain."""
    lines = []
    for line in as_text(pc.from_sequence(f"A{letter}A"), ".pdb", hydrogens=False).splitlines():
        if not line.startswith("ATOM"):
            continue
        if line[22:26] == "   2":
            line = f"{line[:17]}{name:<3}{line[20:]}" if len(name) < 4 else f"{line[:17]}{name}{line[21:]}"
            if line[12:16].strip() in gone:
                continue
            last = line
        lines.append(line)
    x = np.array([float(last[k : k + 8]) for k in (30, 38, 46)])
    for k, atom in enumerate(more, 1):
        place = "".join(f"{v:8.3f}" for v in (x[0], x[1] + 0.9 * k, x[2] + 0.9))
        lines.append(f"{last[:12]} {atom:<3}{last[16:30]}{place}{last[54:76]} {atom[0]}")
    order = sorted(lines, key=lambda line: int(line[22:26]))
    return "\n".join([*order, "TER", "END", ""])


@pytest.mark.parametrize(
    ("letter", "name", "gone", "more", "taken", "lost"),
    [
        ("N", "NLN", (), (), "ASN", ()),
        ("S", "OLS", (), (), "SER", ()),
        ("N", "NLN", ("OD1", "ND2"), ("CD", "CE"), "NLN", ()),  # Norleucine's amide
        ("H", "HSE", (), (), "HIS", ()),
        ("H", "HIP", (), (), "HIS", ()),
        ("H", "HIP", (), ("P", "O1P", "O2P", "O3P"), "HIP", ()),
        ("H", "HIP", ("CD2",), ("P",), "HIS", ("P",)),
        ("C", "CYM", (), (), "CYS", ()),
        ("C", "CYM", (), ("OD",), "CYS", ("OD",)),
        ("C", "DCY", (), (), "CYS", ()),
        ("K", "LYN", (), (), "LYS", ()),
        ("L", "NLE", ("CD1", "CD2"), ("CD", "CE"), "NLE", ()),
    ],
)
def test_a_name_that_means_several_things_is_what_its_atoms_are(
    letter, name, gone, more, taken, lost, tmp_path
):
    path = tmp_path / "x.pdb"
    path.write_text(amino_acid(letter, name, gone, more))
    s = pc.load(path)
    assert s.residue_name.tolist() == ["ALA", taken, "ALA"]
    # Atoms that the residue has in the archive are missing, or its chemistry is unknown.
    assert [(each.name, each.atoms) for each in s.losses] == ([(name, lost)] if lost else [])
    assert {each.why for each in s.losses} <= {Reason.PARENT, Reason.INCOMPLETE}


def test_homoserine_is_no_histidine(tmp_path):
    path = tmp_path / "x.pdb"
    path.write_text(amino_acid("S", "HSE", ("OG",), ("CG", "OD")))
    s = pc.load(path)
    assert s.residue_name.tolist() == ["ALA", "HSE", "ALA"] and len(s.fragments) == 1
    assert {"CB", "CG", "OD"} <= {*s.atom_name[s.atom_residue == 1]}


@pytest.mark.parametrize(
    ("name", "atoms", "taken"),
    [
        ("NHE", ("N",), "NH2"),
        ("NHE", ("N", "C1", "C2", "S", "O1"), "NHE"),  # A buffer
        ("ADE", ("N9", "C8", "N7", "C5", "C6", "N6"), "ADE"),  # The base alone
        ("SPC", ("O",), "HOH"),
        ("SPC", ("C1", "O", "C2"), "SPC"),
        ("NMA", ("N", "C1", "C2", "C3"), "NMA"),
    ],
)
def test_ligands_do_not_become_caps_nucleotides_or_water(name, atoms, taken, tmp_path):
    lines = [line for line in (STRUCTURES / "ala10.pdb").read_text().splitlines() if line.startswith("ATOM")]
    end = next(line for line in lines if line[12:16].strip() == "OXT")
    c = next(line for line in lines if line[12:16].strip() == "C" and line[22:26] == end[22:26])
    if taken == "NH2":
        lines.remove(end)
        start = [float(end[k : k + 8]) for k in (30, 38, 46)]
    else:
        start = [float(c[30:38]) + 4.0, float(c[38:46]), float(c[46:54])]
    for k, atom in enumerate(atoms):
        place = f"{start[0] + 1.4 * k:8.3f}{start[1]:8.3f}{start[2]:8.3f}"
        lines.append(f"HETATM{900 + k:5d}  {atom:<3} {name} A  99    {place}  1.00  0.00           {atom[0]}")
    path = tmp_path / "x.pdb"
    path.write_text("\n".join([*lines, "END", ""]))
    s = pc.load(path, keep="all")
    assert s.residue_name[-1] == taken
    assert bool(s.kept[-1]) == (taken != "NH2") and not s.losses


def mirror(structure):
    """Every atom on the other side of a plane."""
    for place in structure[0].all():
        place.atom.pos.x = -place.atom.pos.x


def racemate(tmp_path, unknown=""):
    """A peptide and beside it its mirror image, under the names of D-amino acids, as chain B."""
    made = gemmi.read_structure(str(STRUCTURES / "1l2y.pdb"))
    del made[1:]
    made.remove_hydrogens()
    other = made.clone()
    mirror(other)
    far = max(place.atom.pos.x for place in made[0].all()) - min(p.atom.pos.x for p in other[0].all())
    for place in other[0].all():
        place.residue.name = D_NAMES.get(place.residue.name, place.residue.name)
        place.atom.pos.x += far + 5.0
    if unknown:
        other[0][0][4].name = unknown
        other[0][0][4]["CD"][0].name = "CX"
    other[0][0].name = "B"
    made[0].add_chain(other[0][0])
    made.remove_empty_chains()
    path = tmp_path / "racemate.pdb"
    made.write_minimal_pdb(str(path))
    return path


def test_a_racemate_is_relaxed_with_the_hands_that_it_has_and_so_are_its_files(tmp_path):
    s = pc.load(racemate(tmp_path))
    d = s.residue_chain == "B"
    assert np.array_equal(s.mirrored, d & (s.residue_name != "GLY"))
    relaxed = pc.relax(s, threads=1, solvent="vacuum")
    assert relaxed.stereocentres_corrected == () and relaxed.measures_end["inverted_stereocentres"] == 0
    for name in ("out.pdb", "out.cif"):
        pc.save(relaxed.structure, tmp_path / name)
        named = gemmi.read_structure(str(tmp_path / name))[0]
        assert [r.name for r in named["B"]] == [D_NAMES.get(r.name, r.name) for r in named["A"]]
        again = pc.load(tmp_path / name)
        assert np.array_equal(again.mirrored, s.mirrored) and again.losses == ()
        assert not len(ChiralityRestraint.of(again).inversions(again.positions))
        assert again.positions == pytest.approx(relaxed.x, abs=2 * PDB_ROUNDING_NM)
        value = pc.energy(again, solvent="vacuum")(again.positions)[0]
        assert value == pytest.approx(relaxed.energy_end, abs=0.01 * abs(relaxed.energy_end))


def test_an_unknown_residue_of_a_racemate_is_named_and_the_other_chain_offered(tmp_path, capsys, monkeypatch):
    path = racemate(tmp_path, unknown="XQZ")
    with pytest.raises(pc.ProtochainError) as refused:
        pc.load(path)
    said = str(refused.value)
    assert said.startswith(f"{path}: B:XQZ5 ") and said.endswith(' chains="A"')
    assert pc.load(path, chains="A").n_residues == 20
    monkeypatch.setattr("sys.argv", ["protochain", "relax", str(path)])
    with pytest.raises(SystemExit) as ended:
        from protochain.cli import main

        main()
    said = capsys.readouterr().err
    assert ended.value.code == 2 and said.endswith("take only what has none: --chains A\n")


def d_arginine(tmp_path, is_d, alone=False):
    """Ubiquitin with its arginine 42 named DAR, of the hand of D or left as it is; or beside it, alone."""
    made = gemmi.read_structure(str(STRUCTURES / "1ubq.pdb"))
    made.remove_waters()
    arginine = next(r for r in made[0]["A"] if r.seqid.num == 42)
    if alone:
        away = gemmi.Position(0.0, 0.0, 0.0)
        centre = np.mean([p.atom.pos.tolist() for p in made[0].all()], axis=0)
        way = np.array(arginine["CA"][0].pos.tolist()) - centre
        away = gemmi.Position(*(9.0 * way / np.linalg.norm(way)))
        arginine = arginine.clone()
        for atom in arginine:
            atom.pos = atom.pos + away
        arginine.seqid = gemmi.SeqId(1, " ")
        chain = gemmi.Chain("I")
        arginine = chain.add_residue(arginine)
    arginine.name = "DAR"
    if is_d:
        at = {a.name: np.array(a.pos.tolist()) for a in arginine}
        normal = np.cross(at["N"] - at["CA"], at["C"] - at["CA"])
        normal /= np.linalg.norm(normal)
        for atom in arginine:
            if atom.name not in BACKBONE:
                x = at[atom.name] - 2.0 * ((at[atom.name] - at["CA"]) @ normal) * normal
                atom.pos = gemmi.Position(*x)
    if alone:
        made[0].add_chain(chain)
    path = tmp_path / "x.pdb"
    made.write_minimal_pdb(str(path))
    return path


@pytest.mark.parametrize(
    ("is_d", "alone", "said"),
    [
        (True, False, "A:DAR42: D-amino acid, with the parameters of its mirror image"),
        (False, False, "inverted stereocentres in the file: CA of A:DAR42"),
        (True, True, "I:DAR1: no part of a chain: it is bonded to no other residue"),
        (False, True, "I:DAR1: no part of a chain: it is bonded to no other residue"),
    ],
)
def test_one_line_tells_of_a_d_arginine(is_d, alone, said, tmp_path):
    s = pc.load(d_arginine(tmp_path, is_d, alone))
    told = [each for each in s.repairs if each.kind not in (Kind.STAYS_UNKNOWN, Kind.NEAR)]
    named = [str(each) for each in told if ":DAR" in str(each)]
    assert named == [said] and not any("ARG" in line for line in sentences(s))
    assert int(s.mirrored.sum()) == 1 and s.kept.any() == alone
    wrong = [s.describe(int(k)) for k in ChiralityRestraint.of(s).inversions(s.positions)]
    assert wrong == ([] if is_d or alone else ["atom CA of A:DAR42"])


def test_a_modified_residue_alone_stays_as_it_is(tmp_path):
    """It is no part of a chain, and needs no template."""
    made = gemmi.read_structure(str(d_arginine(tmp_path, True, alone=True)))
    made[0]["I"][0].name = "CIR"
    made.write_minimal_pdb(str(tmp_path / "y.pdb"))
    s = pc.load(tmp_path / "y.pdb")
    assert s.residue_name[-1] == "CIR" and s.losses == () and s.kept.sum() == 11


def test_a_modified_d_amino_acid_is_known_by_its_atoms(tmp_path):
    """The tables know the parent of hydroxyarginine (HAR), but not its hand."""
    path = tmp_path / "x.pdb"
    text = (d_arginine(tmp_path, True)).read_text()
    path.write_text(text.replace("DAR", "HAR"))
    s = pc.load(path)
    assert s.mirrored.tolist() == (s.residue_number == "42").tolist()
    assert "A:HAR42: converted to its D-amino acid DAR" in sentences(s)


def test_an_unknown_name_of_a_mirrored_residue_is_that_of_its_atoms(tmp_path):
    path = racemate(tmp_path)
    path.write_text(path.read_text().replace("DGN B", "XQZ B"))
    s = pc.load(path)
    (at,) = (k for k, name in enumerate(s.residue_name_in_file) if s.mirrored[k] and name == "DGN")
    assert s.residue_name[at] == "GLN" and s.mirrored[20:].sum() == pc.load(racemate(tmp_path)).mirrored.sum()
