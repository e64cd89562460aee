"""Disulfides, amide bonds, obstacles and alternates, on residues made by hand."""

import gemmi
import pytest

import protochain as pc
from protochain.structure.bridges import disulfides, refuse_crosslinks
from protochain.structure.conformation import likeliest, same_place
from protochain.structure.draft import Draft, Member, Part, atom
from protochain.structure.kept import is_wanted, obstacles


def member(name, number, *atoms, chain="A", code=""):
    made = [atom(label, label[0], [x, 0.0, 0.0]) for label, x in atoms]
    return Member(name, str(number), code, chain, made)


def drafted(*members):
    return Draft("x", "x", [Part("A", list(members[:1])), Part("A", list(members[1:]))])


def cysteines(*places):
    return [member("CYS", k, ("CB", x), ("SG", x)) for k, x in enumerate(places, 1)]


def place(number, name="SG"):
    return ("A", str(number), name)


@pytest.mark.parametrize(("far", "bonded"), [(2.99, True), (3.01, False)])
def test_sulphurs_within_three_angstrom_are_bonded_and_that_is_said_unless_stated(far, bonded):
    pair = cysteines(0.0, far)
    other = [member("CYS", 3, ("CB", 0.1)), member("MET", 4, ("SG", 0.2))]
    draft = drafted(*other, *pair)
    assert disulfides(draft) == [tuple(pair)] * bonded
    bond = "disulfide bond between residue 1 CYS of chain A and residue 2 CYS of chain A"
    assert draft.repairs == [bond] * bonded
    draft = drafted(*pair)
    draft.stated = [(place(2), place(1))]
    disulfides(draft)
    said = (
        "disulfide bond of the file between residue 2 CYS of chain A and residue 1 CYS of chain A ignored: "
        "it is 3.0 angstrom long; request it as disulfide if it is real"
    )
    assert draft.repairs == [said] * (not bonded)


def test_bonds_are_in_the_order_of_their_cysteines_and_the_nearest_first():
    a, b, c, d, e = cysteines(50.0, 0.0, 52.1, 2.0, 4.1)
    draft = drafted(a, b, c, d, e)
    draft.stated = [
        (place(1), place(3)),
        (place(1, "CB"), place(3)),
        (place(9), place(1)),
        (place(5), place(8)),
    ]
    assert disulfides(draft) == [(a, c), (b, d)]
    assert draft.repairs == ["disulfide bond between residue 2 CYS of chain A and residue 4 CYS of chain A"]
    assert disulfides(drafted(member("ALA", 1), member("CYS", 2))) == []


def test_exactly_the_bonds_asked_for_are_made():
    a, b, c = cysteines(0.0, 2.0, 30.0)
    b.insertion_code = "B"
    draft = drafted(a, b, c)
    assert disulfides(draft, [("A:3", "A:2B")]) == [(c, b)]
    assert draft.repairs == [
        "disulfide bond between residue 3 CYS of chain A and residue 2B CYS of chain A, as requested"
    ]
    assert disulfides(drafted(a, b, c), []) == []
    for members, asked, why in (
        ((a, b), [("A:1", "B:1")], "disulfide A:1-B:1: no cysteine B:1; its cysteines are A:1, A:2B"),
        ((member("ALA", 1),), [("A:1", "A:2")], "disulfide A:1-A:2: no cysteine A:1; its cysteines are none"),
        ((a, b, c), [("A:1", "A:3"), ("A:2B", "A:3")], "disulfide A:2B-A:3: A:3 is bonded twice"),
    ):
        with pytest.raises(pc.ProtochainError) as refused:
            disulfides(drafted(*members), asked)
        assert str(refused.value) == f"x: {why}"


@pytest.mark.parametrize(("amine", "nitrogen"), [("LYS", "NZ"), ("ORN", "NE"), ("DAB", "ND")])
@pytest.mark.parametrize(("acid", "carbon"), [("ASP", "CG"), ("GLU", "CD")])
def test_side_chains_joined_by_an_amide_bond_are_refused(amine, nitrogen, acid, carbon):
    lone = member(amine, 1, ("CA", 0.1), (nitrogen, 0.0))
    for far in (1.71, 1.69):
        draft = drafted(lone, member(acid, 2, ("CA", 0.2), (carbon, 9.0)), member(acid, 3, (carbon, far)))
        if far > 1.7:
            refuse_crosslinks(draft)
            continue
        with pytest.raises(pc.ProtochainError) as refused:
            refuse_crosslinks(draft)
        assert str(refused.value) == (
            f"x: residue 1 {amine} of chain A and residue 3 {acid} of chain A are joined by an amide bond "
            f"({nitrogen}-{carbon}), which the force fields lack; remove that bond"
        )
    refuse_crosslinks(drafted(lone, member("ALA", 2, (carbon, 0.1))))
    refuse_crosslinks(drafted(member(acid, 2, (carbon, 0.1)), member("ARG", 1, (nitrogen, 0.0))))
    refuse_crosslinks(drafted(lone, member(acid, 2, ("CB", 0.1))))


@pytest.mark.parametrize(
    ("residue", "kinds"),
    [
        (member("HOH", 1, ("O", 0.0)), {"water", "all", "HOH"}),
        (member("ZN", 1, ("Z", 0.0)), {"ions", "all", "ZN"}),
        (member("DA", 1, ("P", 0.0), ("O", 0.0)), {"nucleic", "all", "DA"}),
        (member("LIG", 1, ("C", 0.0), ("O", 0.0)), {"all", "LIG"}),
    ],
)
def test_molecules_are_kept_by_kind_or_name_if_they_have_a_template(residue, kinds):
    known = {"HOH": 1, "ZN": 1, "DA": 1, "LIG": 1}
    every = ("water", "ions", "nucleic", "all", "HOH", "ZN", "DA", "LIG", "waterX")
    assert {kind for kind in every if is_wanted(residue, (kind,), known)} == kinds
    assert not is_wanted(residue, every, {}) and not is_wanted(residue, (), known)


@pytest.mark.parametrize(("far", "bonded"), [(2.49, True), (2.5, False)])
def test_bonded_nucleotides_are_a_strand_and_others_stand_alone(far, bonded):
    first = member("DA", 1, ("P", -5.0), ("O3'", 0.0))
    second = member("DC", 2, ("P", far), ("O3'", 9.0))
    water, last = member("HOH", 3, ("P", 9.1)), member("HOH", 4, ("O", 9.1))
    draft = Draft("x", "x")
    parts = obstacles(draft, "B", [first, second, water, last])
    strands = [[first, second, water], [last]] if bonded else [[first], [second, water], [last]]
    assert [part.members for part in parts] == strands
    assert all(part.obstacle and part.chain_id == "B" and not part.cyclic for part in parts)
    said = "residue {} of chain A: 5' phosphate left out: the force fields do not have it"
    assert draft.repairs == [said.format("1 DA"), *([] if bonded else [said.format("2 DC")])]
    assert (
        (second.atom("P") is not None) is bonded and first.atom("P") is None and water.atom("P") is not None
    )


def test_all_of_a_phosphate_is_left_out_of_the_first_nucleotide_only():
    names = ("P", "OP1", "OP2", "OP3", "O1P", "O2P", "O3P", "O5'", "O3'")
    strand = member("A", 1, *((name, 0.0) for name in names))
    ligand = member("ATP", 2, ("P", 9.0))
    draft = Draft("x", "x")
    obstacles(draft, "A", [strand, ligand])
    assert [a.name for a in strand.atoms] == ["O5'", "O3'"] and [a.name for a in ligand.atoms] == ["P"]
    clean = Draft("x", "x")
    assert len(obstacles(clean, "A", [member("DG", 1, ("O5'", 0.0))])) == 1 and clean.repairs == []


def residue(name, *atoms, number=1):
    """Atoms (name, altloc, occupancy)."""
    made = gemmi.Residue()
    made.name, made.seqid = name, gemmi.SeqId(number, " ")
    for k, (label, altloc, occupancy) in enumerate(atoms):
        one = atom(label, label[0], [float(k), 0.0, 0.0])
        one.altloc, one.occ = altloc or "\0", occupancy
        made.add_atom(one)
    return made


def told(found):
    return found.residue.name, found.altloc, found.occupancy, found.others, found.repeated


def test_one_location_is_kept_with_what_all_share_and_what_only_another_has():
    mixed = residue(
        "SER", ("N", "", 1.0), ("CA", "B", 0.5), ("CA", "A", 0.5), ("OG", "B", 0.25), ("HB", "B", 1.0),
        ("HG", "A", 0.5), ("H", "", 1.0),
    )  # fmt: skip
    found = likeliest([mixed.clone()], "")
    # B: 0.5, 0.25 and 1.0; A: 0.5 and 0.5.
    assert told(found) == ("SER", "B", pytest.approx(1.75 / 3), ["SER A"], ["CA"])
    assert [(a.name, a.pos.x, a.altloc) for a in found.residue] == [
        ("N", 0.0, "\0"), ("CA", 1.0, "\0"), ("OG", 3.0, "\0"), ("HB", 4.0, "\0"), ("H", 6.0, "\0"),
    ]  # fmt: skip
    other = likeliest([mixed.clone()], "A")
    assert told(other) == ("SER", "A", 0.5, ["SER B"], ["CA"])
    assert [(a.name, a.pos.x) for a in other.residue] == [
        ("N", 0.0), ("CA", 2.0), ("OG", 3.0), ("HG", 5.0), ("H", 6.0),
    ]  # fmt: skip
    assert told(likeliest([mixed.clone()], "C"))[1] == "B"


def test_without_alternates_the_first_of_each_name_is_kept():
    found = likeliest([residue("ALA", ("N", "", 0.5), ("CB", "", 0.1), ("N", "", 1.0), ("H", "", 1.0))], "")
    assert told(found) == ("ALA", "", 1.0, [], ["N"])
    assert [(a.name, a.pos.x) for a in found.residue] == [("N", 0.0), ("CB", 1.0), ("H", 3.0)]


def test_a_backbone_that_the_file_gives_once_belongs_to_every_alternative():
    backbone = [(name, "", 1.0) for name in ("N", "CA", "C", "O")]
    first = residue("SER", *backbone, ("H", "", 1.0), ("OG", "A", 0.25))
    second = residue("ALA", ("CA", "B", 0.75), ("CB", "B", 0.75))
    found = likeliest([first.clone(), second.clone()], "")
    assert told(found) == ("ALA", "B", 0.75, ["SER A"], [])
    assert [(a.name, a.pos.x) for a in found.residue] == [
        ("CA", 0.0), ("CB", 1.0), ("N", 0.0), ("C", 2.0), ("O", 3.0),
    ]  # fmt: skip
    bare = residue("ALA", ("CB", "B", 0.75))
    assert sorted(a.name for a in likeliest([first.clone(), bare], "").residue) == ["C", "CA", "CB", "N", "O"]


def test_residues_of_one_number_with_alternates_share_a_place():
    chain = gemmi.Chain("A")
    for name, altloc, number in (
        ("SER", "A", 1), ("THR", "B", 1), ("ALA", "", 1), ("GLY", "B", 2), ("LEU", "C", 2),
    ):  # fmt: skip
        chain.add_residue(residue(name, ("N", altloc, 1.0), number=number))
    assert [[each.name for each in group] for group in same_place(chain)] == [
        ["SER", "THR"],
        ["ALA"],
        ["GLY", "LEU"],
    ]
    same_place(chain)[0][0].name = "XXX"
    assert chain[0].name == "SER"
