"""Chemistry of small molecules that public structures have: each line of a manifest of such cases."""

import csv

import pytest
from fixtures.samples import ROOT

from protochain.ligands import sources
from protochain.ligands.protonation import at_ph

FOLDER = ROOT.parent / "shared" / "cases" / "chemistry5"


def rows(name):
    path = FOLDER / name
    if not path.exists():
        return []
    with path.open() as lines:
        return list(csv.DictReader(lines, delimiter="\t"))


pytestmark = pytest.mark.skipif(not FOLDER.exists(), reason="needs ../shared/cases/chemistry5")


@pytest.mark.parametrize("row", rows("charges.tsv"), ids=lambda row: row["name"])
def test_charges_at_ph_7(row):
    assert at_ph(sources.read(row["smiles"]), 7.0)[0].charge == int(row["must"])
