"""RMSD between files against mdtraj, MDAnalysis and tmtools, unequal lengths and numbers included."""

import json

import gemmi
import numpy as np
import pytest
from fixtures.command_line import refusal, run
from fixtures.refusals import expect_refusal
from fixtures.samples import STRUCTURES, load, shared
from fixtures.tolerances import RMSD_ANGSTROM

import protochain as pc
from protochain.comparison.deviation import deviation, rmsd_table
from protochain.core.errors import Fault
from protochain.structure.formats.files import parse
from protochain.structure.matching import alpha_trace, match
from protochain.structure.superpose import rmsd

PAIRS = [
    ("1ake_A.pdb", 1, "4ake_A_H.pdb", 1),
    ("1ubq_ubiquitin.pdb", 1, "1ubi_ubiquitin_addH.pdb", 1),
    ("4pti_bpti.pdb", 1, "5pti_bpti.cif", 1),
    ("2sdf_sdf1_nmr30.pdb", 3, "2sdf_sdf1_nmr30.pdb", 30),
    ("2k39_ubiquitin_nmr15.pdb", 1, "1ubq_ubiquitin.pdb", 1),
    ("1hel_lysozyme.pdb", 1, "hewl_charmm_H.pdb", 1),
]


def alpha_by_gemmi(name, model):
    """C-alpha positions (angstrom) of the amino acids of a model in file order, and the sequence."""
    (chosen,) = [m for m in gemmi.read_structure(str(shared(name))) if m.num == model]
    found, letters = [], ""
    for chain in chosen:
        for residue in chain:
            info = gemmi.find_tabulated_residue(residue.name)
            if info.is_amino_acid() or residue.name in ("HSD", "HSP", "HSE"):
                found.append(residue.get_ca().pos.tolist())
                letters += info.one_letter_code.upper() if info.one_letter_code.strip() else "H"
    return np.array(found), letters


@pytest.mark.parametrize("pair", PAIRS, ids=lambda pair: f"{pair[0]}-{pair[2]}")
def test_pairs_equal_mdtraj_mdanalysis_and_tmtools(pair):
    import mdtraj
    import tmtools
    from MDAnalysis.analysis.rms import rmsd

    name, model, other, number = pair
    (x, first), (y, second) = alpha_by_gemmi(name, model), alpha_by_gemmi(other, number)
    assert len(x) == len(y)
    d = deviation(pc.load(shared(name), model=model), pc.load(shared(other), model=number))
    assert (d.n_measured, d.match.coverage) == (len(x), 1.0)
    assert d.rmsd == pytest.approx(rmsd(y, x, center=True, superposition=True), abs=RMSD_ANGSTROM)
    assert d.rmsd_unsuperposed == pytest.approx(rmsd(y, x), abs=RMSD_ANGSTROM)
    topology = mdtraj.Topology()
    chain = topology.add_chain()
    for _ in x:
        topology.add_atom("CA", mdtraj.element.carbon, topology.add_residue("ALA", chain))
    frames = mdtraj.Trajectory(np.array([x, y]) / 10.0, topology)
    frames.superpose(frames, 0)
    off = 10.0 * (frames.xyz[1].astype(float) - frames.xyz[0])
    # Superposed in single precision, at coordinates of some nm.
    assert d.rmsd == pytest.approx(np.sqrt(np.mean(np.sum(off**2, axis=1))), abs=10 * RMSD_ANGSTROM)
    assert d.tm_score == pytest.approx(tmtools.tm_align(y, x, second, first).tm_norm_chain2, abs=1e-4)


def cut_and_renumbered(tmp_path):
    """Ubiquitin from 6 to 70, numbered from 301 in chain Z, with residue 40 mutated to alanine."""
    structure = gemmi.read_structure(str(STRUCTURES / "1ubq.pdb"))
    structure.remove_ligands_and_waters()
    chain = structure[0][0]
    for k in reversed(range(len(chain))):
        if not 6 <= chain[k].seqid.num <= 70:
            del chain[k]
    chain.name = "Z"
    for k, residue in enumerate(chain):
        if residue.seqid.num == 40:
            residue.name = "ALA"
            for i in reversed(range(len(residue))):
                if residue[i].name not in ("N", "CA", "C", "O", "CB"):
                    del residue[i]
        residue.seqid.num = 301 + k
    structure.write_pdb(str(tmp_path / "cut.pdb"))
    return tmp_path / "cut.pdb"


def test_unequal_sequences_are_aligned(tmp_path):
    whole, part = load("1ubq.pdb"), pc.load(cut_and_renumbered(tmp_path))
    found = match(whole, part)
    assert found.how == "sequence" and found.reference.tolist() == list(range(5, 70))
    assert found.identity == pytest.approx(64 / 65) and found.coverage == pytest.approx(65 / 76)
    d = deviation(whole, part)
    assert d.rmsd < 1e-6 and d.n_measured == 65 and 0.8 < d.tm_score < 0.9
    back = deviation(part, whole)
    assert back.match.coverage == 1.0 and back.tm_score == pytest.approx(1.0, abs=1e-6)


def test_chains_are_paired_whatever_they_are_called(tmp_path):
    s = load("3i40.pdb")
    structure = gemmi.read_structure(str(STRUCTURES / "3i40.pdb"))
    structure[0][0].name, structure[0][1].name = "B", "A"
    structure.write_pdb(str(tmp_path / "swapped.pdb"))
    found = match(s, pc.load(tmp_path / "swapped.pdb"))
    assert found.how == "sequence" and found.identity == 1.0 and found.coverage == 1.0
    assert deviation(s, pc.load(tmp_path / "swapped.pdb")).rmsd < 1e-6


def test_superposed_on_one_selection_and_measured_on_another():
    s = load("1ubq.pdb")
    x = s.positions.copy()
    tail = np.isin(s.atom_residue, range(70, 76))
    x[tail] += 0.3
    x = x @ np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]).T + 2.0
    d = deviation(s, s.with_positions(x), "name CA and resid 1:70", "name CA and resid 71:76")
    assert d.rmsd == pytest.approx(3.0 * np.sqrt(3.0), abs=1e-9)
    assert (d.n_aligned, d.n_measured) == (70, 6)
    assert deviation(s, s.with_positions(x), "resid 1:70", "resid 1:70").rmsd == pytest.approx(0.0, abs=1e-9)


def test_what_has_nothing_in_common_is_refused(capsys):
    glycines, leucines = pc.from_sequence("GG"), pc.from_sequence("LL")
    with pytest.raises(pc.ProtochainError, match=r"^LL: its sequence is unrelated to that of GG \(chains A"):
        deviation(glycines, leucines)
    with pytest.raises(pc.ProtochainError, match="selection 'name XX'"):
        deviation(glycines, glycines, "name XX")
    assert np.isnan(deviation(glycines, glycines).tm_score)
    assert run("rmsd", STRUCTURES / "1ubq.pdb", STRUCTURES / "1l2y.pdb") == 2
    said = capsys.readouterr().err
    assert "unrelated to that of" in said and "15 % identical" in said
    assert run("validate", STRUCTURES / "1l2y.pdb", "--reference", STRUCTURES / "1ubq.pdb") == 2
    assert "unrelated to that of" in capsys.readouterr().err


def trace_of(tmp_path, name="1ubq.pdb"):
    lines = (STRUCTURES / name).read_text().splitlines(True)
    path = tmp_path / "trace.pdb"
    path.write_text("".join(line for line in lines if line[:4] == "ATOM" and line[12:16] == " CA ") + "END\n")
    return path


def test_a_c_alpha_trace_is_measured_against_a_whole_file_either_way(tmp_path):
    whole, moved = load("1ubq.pdb"), load("1ubq.pdb").positions.copy()
    moved[whole.alpha_carbons[10]] += 0.2
    pc.save(whole.with_positions(moved), tmp_path / "moved.pdb")
    expected = deviation(whole, pc.load(tmp_path / "moved.pdb")).rmsd
    path = trace_of(tmp_path)
    there, back = (
        rmsd_table(*pair).iloc[0]
        for pair in ((path, [tmp_path / "moved.pdb"]), (tmp_path / "moved.pdb", [path]))
    )
    for row in (there, back):
        assert row["message"] == "" and row["measured_atoms"] == 76 and row["matched_by"] == "numbers"
        assert row["rmsd_angstrom"] == pytest.approx(expected, abs=RMSD_ANGSTROM)
        assert row["tm_score"] > 0.95
    assert rmsd_table(path, [path]).iloc[0]["rmsd_angstrom"] < 1e-9
    assert "no atom of 'name CB'" in rmsd_table(STRUCTURES / "1ubq.pdb", [path], "name CB").iloc[0]["message"]
    with expect_refusal(fault=Fault.ONLY_ALPHA):
        pc.load(path)


def test_modified_residues_and_alternates_of_a_trace_count_once(tmp_path):
    x = [(4.0 * k, float(k % 2), 0.0) for k in range(5)]
    names = ("ALA", "MSE", "SEP", "HSD", "GLY")
    lines = [
        f"HETATM{k:5d}  CA {alt}{name} A{k:4d}    {at[0]:8.3f}{at[1]:8.3f}{at[2]:8.3f}{occ:6.2f}  0.00\n"
        for k, (name, at) in enumerate(zip(names, x, strict=True), -1)
        for alt, occ in ([("A", 0.4), ("B", 0.6)] if name == "SEP" else [(" ", 1.0)])
    ]
    water = "HETATM   99 CA    CA A  99       0.000   0.000   0.000  1.00  0.00          CA\n"
    (tmp_path / "x.pdb").write_text("".join(lines) + water + "END\n")
    trace = alpha_trace(parse(tmp_path / "x.pdb")[0], "x.pdb", 1)
    assert trace.residue_name.tolist() == ["ALA", "MET", "SER", "HIS", "GLY"]
    assert trace.residue_number.tolist() == ["-1", "0", "1", "2", "3"] and trace.n_atoms == 5


def test_a_batch_report_has_a_row_for_every_model_and_every_failure(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    lines = [line for line in (STRUCTURES / "ala10.pdb").read_text().splitlines(True) if line[:4] == "ATOM"]
    two = tmp_path / "two.pdb"
    two.write_text("".join(f"MODEL {n:8d}\n{''.join(lines)}ENDMDL\n" for n in (1, 5)) + "END\n")
    (tmp_path / "bad.pdb").write_text("nothing\n")
    table = rmsd_table(STRUCTURES / "ala10.pdb", [two, tmp_path / "bad.pdb", tmp_path / "none.pdb"])
    assert table["model"].tolist()[:2] == [1, 5] and len(table) == 4
    assert (table["message"] == "").tolist() == [True, True, False, False]
    assert run("rmsd", STRUCTURES / "ala10.pdb", "two.pdb", "bad.pdb", "--json", "-o", "r.csv") == 4
    rows = json.loads(capsys.readouterr().out)["results"]
    assert [row["file"] for row in rows] == ["two.pdb", "two.pdb", "bad.pdb"]
    assert rows[0]["rmsd_angstrom"] < 1e-9 and rows[2]["rmsd_angstrom"] is None
    assert (tmp_path / "r.csv").read_text().count("\n") == 4
    run("rmsd", STRUCTURES / "ala10.pdb", "two.pdb")
    assert "two.pdb" in capsys.readouterr().out
    assert run("rmsd", STRUCTURES / "ala10.pdb", "bad.pdb") == 2
    assert "none.pdb" in refusal("rmsd", "none.pdb", "two.pdb")


def with_chains(source, folder, *names):
    """A file in which the chains bear other names, and come in the order of these."""
    structure = gemmi.read_structure(str(source))
    model = structure[0]
    copies = [chain.clone() for chain in model]
    for chain in copies:
        model.remove_chain(chain.name)
    for chain, name in zip(copies, names, strict=True):
        chain.name = name
    for chain in sorted(copies, key=lambda chain: chain.name):
        model.add_chain(chain)
    for record in (structure.connections, structure.cispeps, structure.helices, structure.sheets):
        record.clear()
    structure.write_pdb(str(folder / f"{''.join(names)}.pdb"))
    return folder / f"{''.join(names)}.pdb"


@pytest.mark.parametrize(("name", "names"), [("2beg_abeta_fibril.pdb", "CADEB")], ids=["fibril"])
def test_equal_chains_are_matched_by_where_they_are(tmp_path, name, names):
    """Names of equal chains say nothing: an RMSD of tens of angstrom beside a TM-score of 1 before."""
    whole, other = shared(name), with_chains(shared(name), tmp_path, *names)
    row = rmsd_table(whole, [other]).iloc[0]
    assert row["rmsd_angstrom"] < 0.002 and row["tm_score"] > 0.999 and row["coverage"] == 1.0
    assert row["chain_mapping"] == ",".join(f"{a}:{b}" for a, b in zip("ABCDE", names, strict=False))
    same = rmsd_table(whole, [whole]).iloc[0]
    assert same["matched_by"] == "numbers"
    assert same["chain_mapping"] == ",".join(f"{a}:{a}" for a in sorted(names))


def test_copies_of_a_heteromer_are_matched_each_with_its_own_kind(tmp_path, capsys):
    """Insulin twice, as (AB)2, the copies exchanged, one mutated and one cut: A stays with A, B with B."""
    structure = gemmi.read_structure(str(STRUCTURES / "3i40.pdb"))
    structure.remove_ligands_and_waters()
    structure.connections.clear()
    for chain, name in zip(list(structure[0]), "CD", strict=True):
        copy = chain.clone()
        copy.name = name
        for atom in (atom for residue in copy for atom in residue):
            at = atom.pos
            atom.pos = gemmi.Position(60.0 - at.x, 25.0 - at.y, at.z + 7.0)
        structure[0].add_chain(copy)
    structure.write_pdb(str(tmp_path / "four.pdb"))
    other = with_chains(tmp_path / "four.pdb", tmp_path, "C", "D", "A", "B")
    cut = gemmi.read_structure(str(other))
    for _ in range(4):
        del cut[0]["B"][-1]
    mutated = cut[0]["D"][4]
    mutated.name = "ALA"
    for k in reversed(range(len(mutated))):
        if mutated[k].name not in ("N", "CA", "C", "O", "CB"):
            del mutated[k]
    cut.write_pdb(str(tmp_path / "cut.pdb"))
    for path, coverage in ((other, 1.0), (tmp_path / "cut.pdb", 98 / 102)):
        d = deviation(pc.load(tmp_path / "four.pdb"), pc.load(path))
        assert d.rmsd < 0.002 and d.match.coverage == pytest.approx(coverage)
        assert d.match.chain_mapping == "A:C,B:D,C:A,D:B"
    run("rmsd", tmp_path / "four.pdb", tmp_path / "cut.pdb")
    assert "A:C,B:D,C:A,D:B" in capsys.readouterr().out
    run("validate", other, "--reference", tmp_path / "four.pdb", "--json")
    (found,) = json.loads(capsys.readouterr().out)["results"]
    assert found["lddt"] > 0.999 and found["ca_rmsd_to_reference_angstrom"] < 0.002
    assert found["chain_mapping"] == "A:C,B:D,C:A,D:B"


def test_a_design_on_the_same_backbone_is_measured_and_by_its_numbers():
    """Nothing in common but the fold, as sequences of designs have, and backbones in glycine."""
    s = load("1ubq.pdb")
    x = s.positions.copy()
    x += 0.03 * np.random.default_rng(0).normal(size=x.shape)
    renamed = s.topology.__class__()
    chain = renamed.addChain("A")
    kept = np.isin(s.atom_name, ["N", "CA", "C", "O"])
    for r, residue in enumerate(s.topology.residues()):
        made = renamed.addResidue("GLY", chain, residue.id)
        for k in np.flatnonzero(kept & (s.atom_residue == r)).tolist():
            renamed.addAtom(str(s.atom_name[k]), [*s.topology.atoms()][k].element, made)
    d = deviation(s, pc.Structure("backbone", renamed, x[kept]))
    assert d.match.how == "fold" and d.match.coverage == 1.0 and d.match.identity < 0.1
    alpha = s.alpha_carbons
    assert d.rmsd == pytest.approx(10 * rmsd(x[alpha], s.positions[alpha]), abs=1e-9)
