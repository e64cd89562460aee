"""Sequences of FASTA files: chains by record, and designs of ProteinMPNN and LigandMPNN."""

import pytest

import protochain as pc
from protochain.core.checks import sequences

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
        (PROTEIN_MPNN, 1, "GGG/GG"), (PROTEIN_MPNN, 2, "ACD/EF"), (LIGAND_MPNN, 2, "ACD/EF"),
        (LIGAND_MPNN, 3, "ACD/EG"), (MONOMERS, 2, "ACE"), (">A\nACD\n>B\nEF\n", 0, "A=ACD/B=EF"),
        (">x\nACD:EF\n", 0, "ACD/EF"), (MONOMERS.split("\n>")[0] + "\n", 0, "ACD"), ("ACD/EF\n", 0, "ACD/EF"),
        (">A\nACD\n>B\nEF\n", 2, "EF"),
    ],
)  # fmt: skip
def test_a_design_is_a_record_of_all_chains(text, number, expected, tmp_path):
    path = tmp_path / "x.fa"
    path.write_text(text)
    assert sequences(f"{path}#{number}" if number else path, "sequence") == expected


@pytest.mark.parametrize("text", [PROTEIN_MPNN, LIGAND_MPNN, MONOMERS])
def test_several_designs_without_a_number_are_refused(text, tmp_path):
    path = tmp_path / "x.fa"
    path.write_text(text)
    n = text.count(">")
    for given in (path, f"{path}#{n + 1}"):
        with pytest.raises(pc.ProtochainError, match=rf"has {n} records; choose one as .*x.fa#{n}"):
            sequences(given, "sequence")
