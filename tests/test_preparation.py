"""The choices made while a file is read: alternates, residues of one number, disulfides, histidines."""

import gemmi
import numpy as np
import pytest
from conftest import shared

import protochain as pc
from protochain.structure.bridges import disulfides
from protochain.structure.changes import summarised
from protochain.structure.conformation import likeliest, same_place
from protochain.structure.draft import Draft, Member, Part, atom
from protochain.structure.protonate import protonate
from protochain.structure.templates import templates


def residue(name, number, occupancies):
    """A residue of a number with insertion code, and of atoms (name, altloc, occupancy)."""
    made = gemmi.Residue()
    made.name, made.seqid = name, gemmi.SeqId(*number)
    for atom_name, altloc, occupancy in occupancies:
        one = atom(atom_name, atom_name[0], [0.0, 0.0, 0.0])
        one.altloc, one.occ = altloc, occupancy
        made.add_atom(one)
    return made


def test_of_two_residues_in_one_place_the_likelier_is_kept_and_not_the_larger():
    backbone = ("N", "CA", "C", "O", "CB")
    serine = residue("SER", (22, " "), [(name, "A", 0.6) for name in (*backbone, "OG")])
    ring = ("CG", "CD1", "CD2", "CE1", "CE2", "CZ", "OH")
    tyrosine = residue("TYR", (22, " "), [(name, "B", 0.4) for name in (*backbone, *ring)])
    for group in ([serine, tyrosine], [tyrosine, serine]):
        found = likeliest([each.clone() for each in group], "")
        assert (found.residue.name, found.altloc, found.others) == ("SER", "A", ["TYR B"])
        assert found.occupancy == pytest.approx(0.6)


def test_of_two_locations_the_likelier_is_kept_though_fewer_atoms_have_it():
    atoms = [("CG", "A", 0.7), ("CG", "B", 0.3), ("CD", "B", 0.3), ("CE", "B", 0.3)]
    found = likeliest([residue("LYS", (3, " "), atoms)], "")
    assert found.altloc == "A" and found.occupancy == pytest.approx(0.7)


def test_residues_of_one_number_and_different_insertion_codes_are_different_places():
    chain = gemmi.Chain("H")
    for name, code, altloc in (("SER", " ", "A"), ("THR", " ", "B"), ("SER", "A", "A"), ("ARG", "B", "A")):
        chain.add_residue(residue(name, (82, code), [("N", altloc, 0.5)]))
    groups = [[(each.name, each.seqid.icode) for each in group] for group in same_place(chain)]
    assert groups == [[("SER", " "), ("THR", " ")], [("SER", "A")], [("ARG", "B")]]


def drafted(*members):
    return Draft("made", "made", [Part("A", list(members))])


def cysteine(number, *sulphur):
    return Member("CYS", str(number), "", "A", [atom("SG", "S", list(sulphur))])


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 1, 0), (1, 0, 2)])
def test_a_cysteine_between_two_others_is_bonded_to_the_nearer_only(order):
    near, middle, far = cysteine(1, 0, 0, 0), cysteine(2, 2.05, 0, 0), cysteine(3, 4.6, 0, 0)
    ((first, second),) = disulfides(drafted(*[(near, middle, far)[k] for k in order]))
    assert {first, second} == {near, middle}


def test_a_cysteine_requested_in_two_bonds_is_refused():
    members = [cysteine(number, 9.0 * number, 0, 0) for number in (1, 2, 3)]
    with pytest.raises(pc.ProtochainError, match="A:2-A:3: A:1 and A:2 are bonded, and no cysteine has two"):
        disulfides(drafted(*members), [("A:1", "A:2"), ("A:2", "A:3")])


def ring_and_acceptors(*places):
    """A regular imidazole with acceptors 3 angstrom from a nitrogen, at an angle from its bisector."""
    names = ("CG", "ND1", "CE1", "NE2", "CD2")
    turns = np.radians(72.0) * np.arange(5)
    radius = 0.5 * 1.36 / np.sin(np.radians(36.0))
    outward = dict(zip(names, np.stack([np.cos(turns), np.sin(turns), 0 * turns], axis=1), strict=True))
    ring = Member("HIS", "1", "", "A", [atom(n, n[0], (radius * outward[n]).tolist()) for n in names])
    parts = [Part("A", [ring])]
    for donor, degrees in places:
        c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        way = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ outward[donor]
        at = radius * outward[donor] + 3.0 * way
        water = Member("HOH", "2", "", "A", [atom("O", "O", at.tolist())])
        parts.append(Part("A", [water], obstacle=True))
    return Draft("made", "made", parts)


def state(draft):
    (_, template) = protonate(draft, templates(), set(), 7.0)[0]
    return template.name[-3:]


@pytest.mark.parametrize("side", [-1, 1])
@pytest.mark.parametrize(("degrees", "bonded"), [(0, True), (30, True), (41, False), (60, False)])
def test_histidines_hydrogen_goes_where_an_acceptor_is_straight_ahead(degrees, bonded, side):
    """A hydrogen 1 angstrom ahead sees the acceptor within 50 degrees where NE2 sees it within 35.2."""
    assert np.degrees(np.arctan2(np.sin(r := np.radians(35.2)), np.cos(r) - 1 / 3)) == pytest.approx(
        50, abs=0.1
    )
    at = ("NE2", side * degrees)
    assert state(ring_and_acceptors(at)) == ("HIE" if bonded else "HID")
    other = ("ND1", side * degrees)
    assert state(ring_and_acceptors(("NE2", 0), other)) == ("HID" if bonded else "HIE")


# --- What was changed, in few lines


@pytest.mark.parametrize(
    ("name", "first", "lines"),
    [
        ("3i40_insulin.pdb", "35 waters left out: the solvent is implicit", 3),
        ("6lfo_gap_model.pdb", "split at 6 gaps in the chains, with charged termini: R:67-72 (10.7 ang", 4),
    ],
)
def test_changes_are_few_lines_losses_first_and_histidines_one(name, first, lines):
    s = pc.load(shared(name))
    assert s.changes[0].startswith(first) and len(s.changes) <= lines < len(s.repairs)
    assert sum("taken as HI" in line or line.startswith("HIS states") for line in s.changes) == 1
    assert "hydrogens added" in s.changes[-1]


def test_histidines_are_told_by_state():
    changes = summarised(
        [
            "residue 5 HIS of chain A taken as HID",
            "residue 9 HIS of chain A taken as HIE",
            "residue 12A HIS of chain (blank) taken as HID",
            "residue 4 HIP of chain B: taken as HIS in protonation state HIP",
            "residue 5 ASP of chain A taken as ASH",
        ]
    )
    assert changes == (
        "residue 5 ASP of chain A taken as ASH",
        "HIS states: HID A:5, 12A; HIE A:9; HIP B:4",
    )


def test_every_line_is_told_once_alone_or_in_a_group():
    hydrogens = "12 hydrogens added at pH 7 (0 were in the file)"
    gap = (
        "chain A is broken between 3 and 5A (5.0 angstrom): split there, with charged termini; to avoid it, "
        "model the missing residues"
    )
    lost = [
        "residue 4 SER of chain A: alternate location A kept (occupancy 0.60), SER B left out",
        "residue 7 GLY of chain A: left out: it is bonded to no other residue",
        "model 1 used, 9 other models left out",
    ]
    changed = [
        "something that no rule knows",
        "residue 3 LYS of chain B: missing OXT added",
        "disulfide bond between residue 3 CYS of chain A and residue 9 CYS of chain A",
    ]
    many = [f"residue {n} LYS of chain A: missing CE, NZ added" for n in range(20)]
    places = ", ".join(f"A:{n} LYS" for n in range(8))
    assert summarised([hydrogens, *changed, "3 waters left out", *lost, gap, "1 HEM left out", *many]) == (
        "left out: 1 HEM, 3 waters",
        gap,
        *lost,
        *changed,
        f"missing atoms added in 20 residues: {places} and 12 more",
        hydrogens,
    )
    assert summarised(()) == ()
