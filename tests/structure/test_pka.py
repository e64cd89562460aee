"""pKa by PROPKA: those that it finds in the file itself, each at its residue."""

import gzip
import io
import sys

import pytest
from fixtures.refusals import expect_refusal
from fixtures.samples import STRUCTURES, shared

import protochain as pc
from protochain.structure.molecule.member import Member, atom
from protochain.structure.molecule.repairs import Kind
from protochain.structure.preparation.protonate import _state_at_ph

STATES = {"ASP": "ASH", "GLU": "GLH", "HIS": "HIP", "CYS": "CYM", "LYS": "LYN"}


def by_propka_alone(text):
    """Residues whose state at pH 7 is not that of their kind, by PROPKA's own reader of the file."""
    run = pytest.importorskip("propka.run")
    made = run.single("x.pdb", ["-q"], io.StringIO(text), write_pka=False)
    found = {}
    for group in made.conformations["AVR"].groups:
        acid = group.residue_type in ("ASP", "GLU", "HIS")
        if group.residue_type in STATES and (group.pka_value >= 7.0) == acid and group.pka_value < 90.0:
            place = group.atom.chain_id, str(group.atom.res_num), STATES[group.residue_type]
            found[place] = group.pka_value
    return found


@pytest.mark.parametrize("name", ["4ake.pdb.gz", "1hpv_oldformat.pdb"])
def test_states_are_those_of_propka_on_the_file(name):
    """Of HIV protease one of the two catalytic aspartates is protonated."""
    path = STRUCTURES / name if name.startswith("4ake") else shared(name)
    opened = gzip.open if path.suffix == ".gz" else open
    with opened(path, "rt") as file:
        expected = by_propka_alone(file.read())
    assert len(expected) == 1
    s = pc.load(path, ph="auto")
    noted = [each.facts for each in s.repairs if each.kind is Kind.STATE_BY_PKA]
    at = {(f["residue"].chain, f["residue"].number, f["state"]): f["pka"] for f in noted}
    assert at.keys() == expected.keys()
    for place, pka in at.items():
        assert pka == pytest.approx(expected[place], abs=0.02)
        (r,) = [
            r for r in range(s.n_residues) if (str(s.residue_chain[r]), str(s.residue_number[r])) == place[:2]
        ]
        names = {*s.atom_name[s.atom_residue == r].tolist()}
        assert {"HIP": {"HD1", "HE2"}, "ASH": {"HD2"}}[place[2]] <= names
    # What the file shows, or pH 7 alone decides, is another matter.
    assert not any(each.kind is Kind.STATE_BY_PKA for each in pc.load(path).repairs)


def test_without_the_package_one_line_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "propka.run", None)
    with pytest.raises(pc.ProtochainError, match=r'^propka .* pip install "protochain\[pka\]"$'):
        pc.load(STRUCTURES / "1hel.pdb", ph="auto")
    with expect_refusal("ph"):
        pc.load(STRUCTURES / "1hel.pdb", ph="some")


def test_an_acid_that_holds_a_metal_has_no_proton_at_any_ph():
    member = Member("ASP", "1", "", "A", [atom("OD1", "O", [0.0, 0.0, 0.0])])
    assert _state_at_ph(member, 2.0) == "ASH"
    member.metals.append(member.atoms[0])
    assert _state_at_ph(member, 2.0) == ""
