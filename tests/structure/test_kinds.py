"""Kinds of file that people bring: nothing is lost, bonded or turned without a word; all is read again."""

import pytest

from bench.files import fate, file_kinds

QUICK = (
    "gromacs-lysh-hisb", "cif-without-label-alt-id", "mirror-image", "ligand-charge-in-mmcif",
    "sulphate-1.45-from-nz", "omega-40", "zinc-at-a-carboxylate", "cut-after-a-record", "one-number-for-all",
    "one-chain-upon-another", "cif-without-elements", "chlorophenol-gro", "asx-atoms-cif", "dna-letters-gro",
    "rna-charmm-crd", "rna-five-prime-triphosphate-pdb", "loop-after-the-chain-pqr",
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
