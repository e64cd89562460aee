"""Protonation of residues made by hand: states on both sides of a pKa, hydrogens of any name."""

import numpy as np
import pytest
from fixtures.drafts import collected, protonated
from fixtures.repairs import sentences

import protochain as pc
from protochain.core.checks import acidity
from protochain.structure.molecule.member import Member, atom
from protochain.structure.molecule.repairs import Kind
from protochain.structure.molecule.templates import Template
from protochain.structure.preparation import protonate as module
from protochain.structure.preparation.structure_draft import Draft, Part


def member(name, number=1, *atoms, state=""):
    """Atoms (name, x, y, z); an element is the first letter."""
    made = [
        atom(label, label.strip("123")[0], [x, y, z], 10.0 * k) for k, (label, x, y, z) in enumerate(atoms, 1)
    ]
    return Member(name, str(number), "", "A", made, state)


def named(name, *names, state=""):
    return member(name, 1, *((each, 0.0, 0.0, 0.0) for each in names), state=state)


@pytest.mark.parametrize(
    ("residue", "state"),
    [
        (named("HIS", "HD1", "HE2"), "HIP"),
        (named("HIS", "HD1", "HE1"), "HID"),
        (named("HIS", "HE2"), "HIE"),
        (named("HIS", "CA"), ""),
        (named("HIS", "HD1", state="HIE"), "HIE"),
        (named("ASP", "HD1"), "ASH"),
        (named("ASP", "HD2"), "ASH"),
        (named("ASP", "HE1", "HE2"), ""),
        (named("GLU", "HE1"), "GLH"),
        (named("GLU", "HE2"), "GLH"),
        (named("GLU", "HD1", "HD2"), ""),
        (named("LYS", "HD1", "HE2"), ""),
        (named("LYS", "HE2", "HE3"), ""),
        (named("LYS", "HE2", "HE3", "HZ1", "HZ2"), "LYN"),
        (named("LYS", "HE2", "HE3", "HZ1", "HZ2", "HZ3"), ""),
    ],
)
def test_hydrogens_of_the_file_show_a_state(residue, state):
    assert module._state_in_file(residue) == state


@pytest.mark.parametrize(
    ("name", "pka", "below", "above"),
    [
        ("ASP", 4.4, "ASH", ""), ("GLU", 4.4, "GLH", ""), ("HIS", 6.5, "HIP", ""), ("CYS", 8.5, "", "CYM"),
        ("LYS", 10.0, "", "LYN"), ("ALA", 7.0, "", ""),
    ],
)  # fmt: skip
def test_a_state_changes_at_its_pka(name, pka, below, above):
    found = [module._state_at_ph(named(name), ph) for ph in (0.0, pka, pka + 0.01, 14.0)]
    assert found == [below, below, above, above]


MADE = Template(
    "X", {"C1": "C", "HA": "H", "HB": "H", "O1": "O", "HO": "H", "N1": "N"}, {},
    (("C1", "HA"), ("HB", "C1"), ("O1", "HO")), {"HOO": "HO"},
)  # fmt: skip


def matched(*atoms):
    """Number renamed, atoms afterwards (name, x, y, z, B), and what is said."""
    draft, one = Draft("x", "x"), member("XXX", 1, *atoms)
    renamed = collected(draft, module._match_hydrogens(one, MADE))
    after = [(a.name, *np.round(a.pos.tolist(), 6).tolist(), a.b_iso) for a in one.atoms]
    assert [a.element.name for a in one.atoms] == [a.name[0] for a in one.atoms]
    return renamed, after, sentences(draft)


HEAVY = (("C1", 0.0, 0.0, 0.0), ("O1", 3.0, 0.0, 0.0), ("N1", 9.0, 0.0, 0.0))


def test_a_hydrogen_belongs_to_the_nearest_heavy_atom_and_takes_a_name_that_is_free():
    given = (("HB", 0.0, 1.0, 0.0), ("HQ", 0.0, -1.0, 0.0), ("HA2", 3.0, 1.5, 0.0))
    renamed, after, said = matched(*HEAVY, *given)
    assert (renamed, said) == (2, [])
    assert after == [
        ("C1", 0, 0, 0, 10), ("HA", 0, -1, 0, 50), ("HB", 0, 1, 0, 40), ("O1", 3, 0, 0, 20),
        ("HO", 3, 1.5, 0, 60), ("N1", 9, 0, 0, 30),
    ]  # fmt: skip


def test_hydrogens_too_far_or_too_many_are_left_out_and_missing_ones_have_no_place():
    given = (("HO", 3.0, 1.501, 0.0), ("H1", 0, 1, 0), ("H2", 0, 1.1, 0), ("H3", 0, 1.2, 0), ("HN", 9, 1, 0))
    renamed, after, said = matched(*HEAVY, *given)
    assert said == ["A:XXX1: hydrogens left out, not of its state: HO, H3, HN"]
    assert [row[0] for row in after] == ["C1", "HA", "HB", "O1", "HO", "N1"] and renamed == 2
    assert after[1:3] == [("HA", 0, 1, 0, 50), ("HB", 0, 1.1, 0, 60)]
    assert np.isnan(after[4][1:4]).all() and after[4][4] == 20.0
    assert matched(*HEAVY, ("HOO", 3.0, 1.0, 0.0))[1][4][:3] == ("HO", 3.0, 1.0)


def glycines(*more):
    """Three residues of a chain, 20 angstrom apart; more atoms for the middle one."""
    backbone = (("N", 0.0, 0.0, 0.0), ("CA", 1.5, 0.0, 0.0), ("C", 3.0, 0.0, 0.0), ("O", 3.0, 1.2, 0.0))
    ends = [
        member("GLY", number, *((name, x + 20 * number, y, z) for name, x, y, z in backbone))
        for number in (1, 3)
    ]
    return [ends[0], member("GLY", 2, *backbone, *more), ends[1]]


def test_hydrogens_are_counted_and_said():
    draft = Draft("x", "x", [Part("A", glycines(("H", 0, 1, 0), ("HZ", 1.5, 1, 0), ("HY", 1.5, -1, 0)))])
    done = protonated(draft, 6.5)
    assert [template.name for _, template in done] == ["NGLY", "GLY", "CGLY"]
    assert [m for m, _ in done] == draft.members
    assert [[a.name for a in m.atoms] for m, _ in done] == [
        ["N", "H1", "H2", "H3", "CA", "HA2", "HA3", "C", "O"],
        ["N", "H", "CA", "HA2", "HA3", "C", "O"],
        ["N", "H", "CA", "HA2", "HA3", "C", "O"],
    ]
    assert sentences(draft) == [
        "2 hydrogens with an unknown name renamed after the parent atom",
        "8 hydrogens added at pH 6.5 (3 were in the file)",
    ]


def chain(*middle):
    """Alanines around residues, without atoms but a carbon: only templates are looked at."""
    names = ("ALA", *middle, "ALA")
    return [member(name, k, ("CA", 9.0 * k, 0.0, 0.0)) for k, name in enumerate(names)]


def test_states_that_are_chosen_are_said_and_those_of_the_file_are_not():
    residues = chain("HIS", "ASP", "CYS", "CYS", "HIS", "GLU")
    residues[5].state = "HIE"
    draft = Draft("x", "x", [Part("A", residues)])
    done = protonated(draft, 4.4, [(residues[3], residues[3])])
    assert [template.name for _, template in done] == [
        "NALA",
        "HIP",
        "ASH",
        "CYX",
        "CYS",
        "HIE",
        "GLH",
        "CALA",
    ]
    assert sentences(draft)[:3] == [
        "A:HIS1 modelled as HIP", "A:ASP2 modelled as ASH",
        "A:GLU6 modelled as GLH",
    ]  # fmt: skip
    assert sentences(draft)[3].endswith("hydrogens added at pH 4.4 (0 were in the file)")
    ends = [member("ASP", 1, ("CA", 0.0, 0.0, 0.0)), member("HIS", 2, ("CA", 9.0, 0.0, 0.0))]
    draft = Draft("x", "x", [Part("A", ends)])
    done = protonated(draft, 2.0)
    assert [template.name for _, template in done] == ["NASP", "CHIP"]
    assert sentences(draft)[:2] == [
        "A:ASP1: kept in its usual state: the force field has no terminal ASH",
        "A:HIS2 modelled as HIP",
    ]


def test_half_a_disulfide_without_the_other_is_named():
    alone = chain("CYS", "CYS")
    alone[1].raw_name = alone[2].raw_name = "CYX"
    draft = Draft("x", "x", [Part("A", alone)])
    done = protonated(draft, 7.0, [(alone[2], alone[2])])
    assert [template.name for _, template in done][1:3] == ["CYS", "CYX"]
    (said,) = (repair for repair in draft.repairs if repair.kind is Kind.NO_PARTNER)
    assert said.facts["residue"] == alone[1].residue and "CYX" in str(said)


def test_a_ph_is_between_0_and_14():
    acidity(0.0, "ph")
    acidity(14.0, "ph")
    for wrong in (-0.01, 14.01, float("nan")):
        with pytest.raises(pc.ProtochainError) as refused:
            acidity(wrong, "ph")
        assert str(refused.value) == f"pH {wrong:g}: give a number from 0 to 14"


@pytest.mark.parametrize(
    ("name", "metal", "linked", "state"),
    [
        ("HIS", ["ND1"], [], "HIE"), ("HIS", ["NE2"], [], "HID"), ("HIS", [], ["ND1"], "HIE"),
        ("HIS", ["ND1", "NE2"], [], "HIE"), ("HIS", ["O"], [], ""), ("CYS", ["SG"], [], "CYM"),
        ("CYS", [], ["SG"], "CYM"), ("CYS", ["O"], [], ""), ("LYS", ["NZ"], [], "LYN"),
        ("LYS", ["O"], [], ""), ("LYS", [], ["NZ"], ""), ("CYS", ["N"], [], ""), ("ASP", ["OD1"], [], ""),
    ],
)  # fmt: skip
def test_a_pair_of_electrons_that_is_bonded_bears_no_hydrogen(name, metal, linked, state):
    one = named(name, *metal, *linked)
    one.metals, one.links = one.atoms[: len(metal)], one.atoms[len(metal) :]
    assert module._lone_pair(one) == state
