"""Sequences of FASTA files: chains by record, and designs of ProteinMPNN and LigandMPNN."""

import json

import pandas as pd
import pytest
from fixtures.command_line import refusal, run
from fixtures.refusals import expect_refusal
from fixtures.samples import STRUCTURES

import protochain as pc
from protochain.core.checks import designs, sequences
from protochain.structure.molecule.residues import STANDARD

PROTEIN_MPNN = """>x, score=1.72, global_score=1.72, fixed_chains=[], designed_chains=['A', 'B'], seed=37
GGG/GG
>T=0.1, sample=1, score=0.78, global_score=0.78, seq_recovery=0.40
ACD/EF
"""
LIGAND_MPNN = """>x, T=0.1, seed=111, num_res=5, num_ligand_res=0, use_ligand_context=True
GGG:GG
>x, id=1, T=0.1, seed=111, overall_confidence=0.44, ligand_confidence=0.44, seq_rec=0.49
ACD:EF
>x, id=2, T=0.1, seed=111, overall_confidence=0.44, ligand_confidence=0.44, seq_rec=0.49
ACD:
EG
"""
MONOMERS = ">T=0.1, sample=1, score=0.7\nACD\n>T=0.1, sample=2, score=0.7\nACE\n"


@pytest.mark.parametrize(
    ("text", "number", "expected"),
    [
        (PROTEIN_MPNN, 1, "A=GGG/B=GG"), (PROTEIN_MPNN, 2, "A=ACD/B=EF"), (LIGAND_MPNN, 2, "ACD/EF"),
        (LIGAND_MPNN, 3, "ACD/EG"), (MONOMERS, 2, "ACE"), (">A\nACD\n>B\nEF\n", 0, "A=ACD/B=EF"),
        (">x\nACD:EF\n", 0, "ACD/EF"), (MONOMERS.split("\n>")[0] + "\n", 0, "ACD"), ("ACD/EF\n", 0, "ACD/EF"),
        (">A\nACD\n>B\nEF\n", 2, "EF"),
    ],
)  # fmt: skip
def test_a_design_is_a_record_of_all_chains(text, number, expected, tmp_path):
    path = tmp_path / "x.fa"
    path.write_text(text)
    assert sequences(f"{path}#{number}" if number else path, "sequence") == expected


NAMED = ">first|x\nACD\n>second binder\nACE\n"
NAMES = {
    PROTEIN_MPNN: ["x", "sample_1"], LIGAND_MPNN: ["x", "x_1", "x_2"], MONOMERS: ["sample_1", "sample_2"],
}  # fmt: skip


@pytest.mark.parametrize(
    "titles",
    [
        {"a": "a", "a_3": "a_3", " a": "a_3_3"},
        {"..": "1", ".hidden": "hidden", "a/b": "a_b", "A_b": "A_b_4", "../c": "_c", "x" * 300: "x" * 100},
        {"\ufefflong|name": "long_name", "second": "second"},
    ],
)
def test_names_of_designs_are_names_of_different_files(titles, tmp_path):
    path, mark = tmp_path / "x.fa", "\ufeff"
    text = "".join(f">{title.strip(mark)}\nACD\n" for title in titles)
    path.write_text(mark * any(mark in title for title in titles) + text)
    names = [name for name, _ in designs(f"{path}#designs")]
    assert names == [*titles.values()]


def test_records_of_equal_length_are_chains_or_designs_as_stated(tmp_path, capsys):
    """A FASTA file of a homodimer, or two designs of one chain: nothing in the file decides."""
    path = tmp_path / "x.fa"
    path.write_text(NAMED)
    for call in (lambda: sequences(path, "sequence"), lambda: pc.Setup(sequence=path)):
        with expect_refusal("sequence"):
            call()
    assert "x.fa#designs" in refusal("mutate", STRUCTURES / "ala10.pdb", "--sequence", path)
    assert sequences(f"{path}#chains", "sequence") == "first=ACD/second=ACE"
    assert sequences(f"{path}#designs", "sequence") == f"{path}#designs"
    assert designs(f"{path}#designs") == [("first_x", "ACD"), ("second", "ACE")]
    assert designs(f"{path}#chains") == designs(f"{path}#2") == []
    with expect_refusal("sequence", match=".*x.fa#2"):
        pc.Setup(sequence=f"{path}#designs").load(STRUCTURES / "ala10.pdb")
    with expect_refusal("sequence", match="has 2 records"):
        sequences(f"{path}#0", "sequence")
    path.write_text(LIGAND_MPNN)
    assert sequences(f"{path}#chains", "sequence") == "GGG/GG/ACD/EF/ACD/EG"


@pytest.mark.parametrize("text", NAMES)
def test_several_designs_have_names_and_one_structure_refuses_them(text, tmp_path):
    path = tmp_path / "x.fa"
    path.write_text(text)
    n = text.count(">")
    assert sequences(path, "sequence") == str(path)
    assert [name for name, _ in designs(str(path))] == NAMES[text]
    assert [letters for _, letters in designs(str(path))] == [
        sequences(f"{path}#{number}", "sequence") for number in range(1, n + 1)
    ]
    with pytest.raises(pc.ProtochainError, match=rf"has {n} records; choose one as .*x.fa#{n}"):
        sequences(f"{path}#{n + 1}", "sequence")
    with pytest.raises(pc.ProtochainError, match=rf"has {n} records; choose one as .*x.fa#{n}"):
        pc.Setup(sequence=path).load(STRUCTURES / "ala10.pdb")


@pytest.mark.parametrize("text", ["AAA", ">A\nACD\n>B\nEFG\n", ">chain1\nACD\n>chain2\nEF\n", ">x\nACD\n"])
def test_chains_and_letters_are_no_designs(text, tmp_path):
    path = tmp_path / "x.fa"
    path.write_text(text)
    assert designs(str(path)) == designs(text) == []


@pytest.fixture
def backbone(tmp_path, monkeypatch):
    """Folder with a decapeptide, its designs with the input first, and one that is too long."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "ala10.pdb").symlink_to(STRUCTURES / "ala10.pdb")
    letters = {
        "ala10, score=1.7": "A" * 10,
        "T=0.1, sample=1, score=0.7": "AAAVAALAAA",
        "T=0.1, sample=2": "A" * 11,
    }
    (tmp_path / "designs.fa").write_text("".join(f">{head}\n{body}\n" for head, body in letters.items()))
    return tmp_path


def test_each_design_is_a_mutant(backbone, capsys):
    """As mutate builds it from the mutations. The input has a change of 0, a wrong length its reason."""
    options = ("--sequence", "designs.fa", "--solvent", "vacuum", "--workers", "1")
    assert run("mutate", "ala10.pdb", *options, "--json") == 4
    printed = json.loads(capsys.readouterr().out)
    table = pd.read_csv("ala10.mutants/mutants.csv")
    assert table["record"].tolist() == ["ala10", "sample_1", "sample_2"]
    assert [row["record"] for row in printed["results"]] == table["record"].tolist()
    assert table["status"].tolist() == ["converged", "converged", "refused"]
    assert "11 letters for chain A" in table["message"][2]
    alone = pc.mutate("ala10.pdb", "A:A4V,A:A7L", solvent="vacuum")
    assert table["mutations"][1] == "A:A4V,A:A7L"
    assert table["ddg_kj_mol"].tolist()[:2] == pytest.approx([0.0, alone.ddg], abs=1e-6)
    written = pc.load("ala10.mutants/sample_1.pdb")
    assert "".join(STANDARD[name] for name in written.residue_name) == "AAAVAALAAA"
    assert sorted(path.name for path in (backbone / "ala10.mutants").glob("*.pdb")) == [
        "ala10.pdb",
        "sample_1.pdb",
    ]
    assert "exists" in refusal("mutate", "ala10.pdb", *options)
    (backbone / "designs.fa").write_text(f">ala10, score=1.7\n{'A' * 10}\n>T=0.1, sample=1\n{'A' * 11}\n")
    assert run("mutate", "ala10.pdb", *options, "--force", "--json") == 4
    assert "ala10.mutants/sample_1.pdb" not in json.loads(capsys.readouterr().out)["files"]
    assert not (backbone / "ala10.mutants" / "sample_1.pdb").exists()
    assert "give one of" in refusal("mutate", "ala10.pdb", "A:A4V", *options)
    assert "output folder" in refusal("mutate", "ala10.pdb", *options, "-o", "x.pdb")


def test_only_the_designed_chain_of_a_complex_changes(tmp_path, capsys):
    """ProteinMPNN writes the letters of designed chains alone, with X for residues that the file lacks."""
    residues = pc.load(STRUCTURES / "3i40.pdb", keep=()).residue_name
    letters = "".join(STANDARD[name] for name in residues)
    first, second = letters[:21], letters[21:]
    path = tmp_path / "binder.fa"
    head = ">3i40, score=1.7, global_score=1.7, fixed_chains=['A'], designed_chains=['B'], seed=37"
    design = f"XX{second[:3]}X{second[3:8]}V{second[9:]}X"
    path.write_text(f"{head}\n{second}\n>T=0.1, sample=1, score=0.7\n{design}\n")
    s = pc.Setup(sequence=f"{path}#2", keep=()).load(STRUCTURES / "3i40.pdb")
    after = "".join(STANDARD[name] for name in s.residue_name)
    assert (after[:21], after[21:]) == (first, f"{second[:8]}V{second[9:]}")
    assert second[8] != "V"


def test_one_design_is_one_mutant(backbone, capsys):
    assert run("mutate", "ala10.pdb", "--sequence", "designs.fa#2", "--solvent", "vacuum", "--json") == 0
    assert json.loads(capsys.readouterr().out)["mutations"] == "A:A4V,A:A7L"
    assert "has this sequence already" in refusal("mutate", "ala10.pdb", "--sequence", "AAAAAAAAAA")


def test_relax_and_batch_have_a_row_for_each_design(backbone, capsys):
    options = ("--sequence", "designs.fa", "--solvent", "vacuum", "--workers", "1", "--max-iterations", "2")
    assert run("relax", "ala10.pdb", "-o", "relaxed", *options) == 4
    table = pd.read_csv("relaxed/relaxed.csv")
    assert table["structure"].tolist() == ["ala10.ala10", "ala10.sample_1", "ala10.sample_2"]
    assert table["output"].notna().tolist() == [True, True, False]
    relaxed = pc.load(backbone / "relaxed" / "ala10.sample_1.relaxed.pdb")
    assert "".join(STANDARD[name] for name in relaxed.residue_name) == "AAAVAALAAA"
    capsys.readouterr()
    assert (
        run("batch", "ala10.pdb", "--methods", "relax", "--sequence", "designs.fa", "--dry-run", "--json")
        == 0
    )
    names = [row["structure"] for row in json.loads(capsys.readouterr().out)["structures"]]
    assert names == table["structure"].tolist()


def test_equal_designs_are_separate(backbone):
    """Cold sampling of ProteinMPNN repeats sequences. Each has its row, also after --resume."""
    lines = [f">T=0.1, sample={number}\nAAAVAALAAA\n" for number in (1, 2)]
    (backbone / "equal.fa").write_text("".join(lines))
    options = ("--sequence", "equal.fa", "--solvent", "vacuum", "--workers", "1")
    for more in ((), ("--resume",)):
        assert run("relax", "ala10.pdb", "-o", "relaxed", *options, *more) == 0
        table = pd.read_csv("relaxed/relaxed.csv")
        assert table["structure"].tolist() == ["ala10.sample_1", "ala10.sample_2"]
        assert table["output"].nunique() == 2


@pytest.mark.parametrize("output", ["-", "x.pdb.gz", "x.csv"])
def test_several_results_need_a_folder(backbone, output):
    for command in (("mutate", "ala10.pdb", "--sequence", "designs.fa"), ("build", "designs.fa")):
        assert "require an output folder" in refusal(*command, "-o", output)
    assert not (backbone / output).exists()


def test_build_has_a_chain_for_each_record(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "x.fa").write_text(">A\nACDE\n>B other\nGAG\n")
    assert run("build", "x.fa", "-o", "built.v2", "--json") in (0, None)
    rows = json.loads(capsys.readouterr().out)["results"]
    assert [(row["record"], row["n_residues"]) for row in rows] == [("A", 4), ("B", 3)]
    for row, letters in zip(rows, ("ACDE", "GAG"), strict=True):
        assert "".join(STANDARD[name] for name in pc.load(row["output"]).residue_name) == letters
    assert "output folder" in refusal("build", "x.fa", "-o", "x.pdb")
    (tmp_path / "x.fa").write_text(">A\nAC\n>B\nGJ\n")
    assert "x.fa: record B: sequence: letter 2 is 'J'" in refusal("build", "x.fa", "-o", "none")
    assert not (tmp_path / "none").exists()
    (tmp_path / "x.fa").write_text(">A\nGAG\n")
    assert run("build", "x.fa", "-o", "one.pdb") in (0, None)
    assert pc.load("one.pdb").n_residues == 3
