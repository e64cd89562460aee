"""Kinds of file that people bring: nothing is lost, bonded or turned without a word; all is read again."""

import pytest
from fixtures import fate, file_kinds
from fixtures.repairs import sentences

import protochain as pc

QUICK = (
    "chains-that-share-an-id", "ions-that-share-a-number", "ligand-atoms-that-share-a-name",
    "gromacs-lysh-hisb", "cif-without-label-alt-id", "charmm-hydrogens-trp-cage", "ace-nme", "sep",
    "mirror-image", "ligand-charge-in-mmcif", "sulphate-1.45-from-nz", "covalent-stated", "omega-40",
    "zinc-at-a-carboxylate", "cut-after-a-record", "one-number-for-all", "one-chain-upon-another", "c-alphas",
    "cif-without-elements", "chlorophenol-gro", "asx-atoms-cif", "dna-letters-gro", "rna-charmm-crd",
    "rna-five-prime-triphosphate-pdb", "loop-after-the-chain-pqr",
)  # fmt: skip
"""A few of each family, one at least for each fault that the collection found."""


def check(kind: file_kinds.Kind, folder) -> fate.Fate:
    if not kind.is_here:
        pytest.skip(f"{kind.needs} is not here")
    path, meant = kind.make(folder)
    found = fate.fate(path, meant, options=kind.options)
    assert fate.faults(found, path.name, kind.refused, kind.links, kind.keeps) == []
    return found


@pytest.mark.parametrize("name", QUICK)
def test_a_kind_of_file_is_taken_whole_or_says_what_it_lost(name, tmp_path):
    check(next(kind for kind in file_kinds.KINDS if kind.name == name), tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("kind", file_kinds.KINDS, ids=[kind.name for kind in file_kinds.KINDS])
def test_every_kind_of_file_is_taken_whole_or_says_what_it_lost(kind, tmp_path):
    check(kind, tmp_path)


def test_kinds_have_names_of_their_own_and_are_many():
    assert len({kind.name for kind in file_kinds.KINDS}) == len(file_kinds.KINDS)
    assert sum(kind.is_made for kind in file_kinds.KINDS) >= 750


def test_what_shares_its_ids_is_told_apart_and_said(tmp_path):
    kinds = {kind.name: kind for kind in file_kinds.KINDS}

    def load(name):
        return pc.load(kinds[name].make(tmp_path)[0])

    chains = load("chains-that-share-an-id")
    assert {*chains.residue_chain} == {"A", "B"} and any("A called B" in line for line in sentences(chains))
    ions = load("ions-that-share-a-number")
    assert (ions.residue_name == "NA").sum() == 2 and any("renumbered: 1" in line for line in sentences(ions))
    ligand = load("ligand-atoms-that-share-a-name")
    names = ligand.atom_name[(ligand.residue_name == "LIG")[ligand.atom_residue]]
    assert len({*names}) == len(names) == 9 and any(
        "share a name numbered" in line for line in sentences(ligand)
    )
