"""Disulfides, amide bonds, what is kept and how it is held, and alternates, on residues made by hand."""

import re

import gemmi
import numpy as np
import pytest
from fixtures.drafts import disulfides, kept_of, linked
from fixtures.repairs import kinds, noted, sentences

import protochain as pc
from protochain.structure.molecule.links import is_metal
from protochain.structure.molecule.member import Member, atom
from protochain.structure.molecule.repairs import Kind
from protochain.structure.molecule.templates import Template
from protochain.structure.preparation import fragments
from protochain.structure.preparation.hetero_molecules import (
    HeteroResidue,
    check_words,
    rename_water,
    report_hetero,
)
from protochain.structure.preparation.model_choice import group_alternates, pick_altloc
from protochain.structure.preparation.prepare import run
from protochain.structure.preparation.recognise import template_by_element
from protochain.structure.preparation.sites import measure, moves, ties
from protochain.structure.preparation.structure_draft import Draft, Evidence, Part


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
    assert kinds(draft) == [Kind.BRIDGE] * bonded
    draft = drafted(*pair)
    draft.stated_bonds = [(place(2), place(1))]
    disulfides(draft)
    assert kinds(draft) == [Kind.BRIDGE_IGNORED] * (not bonded)
    assert bonded or "3.0 angstrom" in sentences(draft)[0]


def test_a_bond_of_the_file_between_cysteines_that_is_too_long_is_said_once(tmp_path):
    pc.save(pc.from_sequence("CAAAC"), tmp_path / "plain.pdb")
    bond = f"{'SSBOND   1 CYS A    1    CYS A    5':59}  1555   1555  2.03\n"
    (tmp_path / "far.pdb").write_text(bond + (tmp_path / "plain.pdb").read_text())
    told = [kind for kind in kinds(pc.load(tmp_path / "far.pdb")) if "IGNORED" in kind.name]
    assert told == [Kind.BRIDGE_IGNORED]


def test_atoms_of_the_protein_as_near_as_bonded_ones_are_named_unless_something_joins_their_residues():
    def near(name, length, number=3):
        first, last = member("CYS", 1, ("SG", 0.0)), member("CYS", number, (name, length))
        draft = drafted(first, *[member("GLY", 2, ("CA", 9.0))] * (number > 2), last)
        linked(draft)
        return draft

    assert kinds(near("CB", 1.82)) == [Kind.NEAR]
    assert "SG of A:CYS1 and CB of A:CYS3 (1.82" in sentences(near("CB", 1.82))[0]
    assert [*map(kinds, (near("CB", 2.2), near("SG", 2.05), near("CB", 1.82, 2)))] == [[]] * 3


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 1, 0), (1, 0, 2)])
def test_a_cysteine_between_two_others_is_bonded_to_the_nearer_only(order):
    near, middle, _ = three = cysteines(0.0, 2.05, 4.6)
    ((first, second),) = disulfides(drafted(*(three[k] for k in order)))
    assert [first, second] in ([near, middle], [middle, near])


def test_bonds_are_in_the_order_of_their_cysteines_and_the_nearest_first():
    a, b, c, d, e = cysteines(50.0, 0.0, 52.1, 2.0, 4.1)
    draft = drafted(a, b, c, d, e)
    draft.stated_bonds = [
        (place(1), place(3)),
        (place(1, "CB"), place(3)),
        (place(9), place(1)),
        (place(5), place(8)),
    ]
    assert disulfides(draft) == [(a, c), (b, d)]
    assert kinds(draft) == [Kind.BRIDGE]
    assert disulfides(drafted(member("ALA", 1), member("CYS", 2))) == []


def test_bonds_asked_for_are_added_to_those_found_or_take_their_place():
    a, b, c, d = cysteines(0.0, 2.0, 30.0, 40.0)
    b.insertion_code = "B"
    draft = drafted(a, b, c, d)
    assert disulfides(draft, [("A:4", "A:3"), ("A:2B", "A:1")]) == [(a, b), (d, c)]
    assert kinds(draft) == [Kind.BRIDGE, Kind.BRIDGE_FAR] and "10.0 angstrom" in sentences(draft)[1]
    draft = drafted(a, c)
    draft.stated_bonds = [(("A", "1", "SG"), ("A", "3", "SG"))]
    assert disulfides(draft, [("A:1", "A:3")]) == [(a, c)] and "ignored" not in "".join(sentences(draft))
    draft = drafted(a, b, c, d)
    assert disulfides(draft, ["none", ("A:3", "A:2B")]) == [(c, b)]
    assert kinds(draft)[0] is Kind.BRIDGES_DROPPED and draft.repairs[0].facts["pairs"] == ("A:1-A:2B",)
    assert len(draft.repairs) == 2
    draft = drafted(a, b, c, d)
    assert disulfides(draft, ["none"]) == [] and len(draft.repairs) == 1
    draft = drafted(a, c)
    assert disulfides(draft, ["none"]) == [] and draft.repairs == []
    for members, bonds, why in (
        ((a, b), [("A:1", "B:1")], "no cysteine B:1; its cysteines are A:1, A:2B"),
        ((member("ALA", 1),), [("A:1", "A:2")], "A:ALA1 is no cysteine"),
        ((a, c), [("A:1", "A:1")], "give two"),
        ((a, b, c), ["none", ("A:1", "A:3"), ("A:2B", "A:3")], "A:1 and A:3 are bonded"),
        ((a, b, c), [("A:2B", "A:3")], "A:1 and A:2B are bonded"),
    ):
        with pytest.raises(pc.ProtochainError, match=why):
            disulfides(drafted(*members), bonds)
    c.metals = [c.atom("SG")]
    with pytest.raises(pc.ProtochainError, match="A:3 is bonded to a molecule kept with the protein"):
        disulfides(drafted(a, c), [("A:1", "A:3")])
    a.metals = [a.atom("SG")]
    assert disulfides(drafted(a, b)) == []
    a.metals, b.links = [], [b.atom("CB")]
    assert disulfides(drafted(a, b)) == [(a, b)]
    b.links = [b.atom("SG")]
    assert disulfides(drafted(a, b)) == []


def crosslinked(*members):
    """Ends of the bonds between residues of a chain that are none along it."""
    draft = drafted(*members)
    where = {
        id(m): fragments.Place(part, *part.neighbours(i))
        for part in draft.parts for i, m in enumerate(part.members)
    }  # fmt: skip
    return [(link.atom.name, link.hetero_atom.name) for link in fragments._amides(draft, where)]


@pytest.mark.parametrize(("amine", "nitrogen"), [("LYS", "NZ"), ("ORN", "NE"), ("DAB", "ND")])
@pytest.mark.parametrize(("acid", "carbon"), [("ASP", "CG"), ("GLU", "CD")])
def test_side_chains_are_joined_by_an_amide_bond_where_an_oxygen_lacks(amine, nitrogen, acid, carbon):
    lone, bond = member(amine, 1, ("CA", 0.1), (nitrogen, 0.0)), (nitrogen, carbon)
    for far in (1.71, 1.69):
        found = crosslinked(lone, member(acid, 2, ("CA", 0.2), (carbon, 9.0)), member(acid, 3, (carbon, far)))
        assert found == [bond] * (far < 1.7)
    # With both oxygens it is an acid, and the two only overlap.
    oxygens = [({"CG": "OD", "CD": "OE"}[carbon] + number, 1.0) for number in "12"]
    assert crosslinked(lone, member(acid, 2, (carbon, 0.1), *oxygens)) == []
    for one in oxygens:
        assert crosslinked(lone, member(acid, 2, (carbon, 0.1), one)) == [bond]
    assert crosslinked(lone, member("ALA", 2, (carbon, 0.1))) == []
    assert crosslinked(member(acid, 2, (carbon, 0.1)), member("ARG", 1, (nitrogen, 0.0))) == []
    assert crosslinked(lone, member(acid, 2, ("CB", 0.1))) == []


CENTRE = 0.5


@pytest.mark.parametrize(
    ("residue", "kind"),
    [
        (member("HOH", 1, ("O", CENTRE)), "water"),
        (member("ZN", 1, ("N", CENTRE)), "ions"),
        (member("DA", 1, ("P", CENTRE), ("O", CENTRE + 1)), "nucleic"),
        (member("LIG", 1, ("C", CENTRE), ("O", CENTRE + 1)), "ligands"),
    ],
)
def test_molecules_are_kept_by_kind_or_by_either_name(residue, kind):
    def kept(word):
        given = HeteroResidue(residue, "OLD", [noted("oddly")])
        draft = drafted(glycine())
        parts = kept_of(draft, [given], (word,), {})
        assert given.kind == kind and draft.left_out == ({} if parts else {_told(kind): 1})
        assert (noted("oddly") in draft.repairs) == bool(parts)
        return [part.members for part in parts] == [[residue]]

    every = ("none", "near", "all", "water", "ions", "nucleic", "ligands", residue.name, "OLD")
    near = {"near"} if kind != "water" else set()
    assert {word for word in every if kept(word)} == {"all", kind, residue.name, "OLD", *near}
    told = f"keep QWK: .*: 1 {_told(kind).rstrip('s')}$"
    for words in (("QWK",), ("OLD", "QWK"), ("near", "QWK")):
        with pytest.raises(pc.ProtochainError, match=told):
            kept_of(drafted(glycine()), [HeteroResidue(residue, "OLD")], words, {})
    assert kept_of(drafted(glycine()), [HeteroResidue(residue, "OLD")], (), {}) == []


def _told(kind):
    return "waters" if kind == "water" else "OLD"


def glycine():
    return member("GLY", 1, ("N", 0.0), ("CA", 0.0), ("HA", 9.0))


def candidates(*places, name="LIG"):
    return [HeteroResidue(member(name, k, ("C", x), ("H", x + 90.0)), name) for k, x in enumerate(places, 2)]


@pytest.mark.parametrize(
    ("places", "near"),
    [
        ((4.9, 5.1, -4.9), (0, 1, 2)),
        ((5.1, -5.1, -4.9), (1, 2)),
        # One joins the next, in any order; a gap of 2 angstrom ends the row.
        ((6.7, 8.6, 4.9, 10.7), (0, 1, 2)),
        ((6.9, 8.8, 4.8), ()),
    ],
)
def test_near_is_five_angstrom_from_heavy_atoms_of_the_protein_or_joined_to_what_is(places, near):
    """The protein's heavy atoms are at 0, its hydrogen at 9."""
    given = candidates(*places)
    if near == ():
        given[2].member.atoms[0].pos.y = 1.7
    draft = drafted(glycine())
    parts = kept_of(draft, given, ("near",), {})
    run(draft, (report_hetero,))
    kept = [part.members[0] for part in parts]
    assert kept == [given[k].member for k in near]
    gone = len(places) - len(near)
    assert draft.left_out == ({"LIG": gone} if gone else {})
    assert (kinds(draft)[:1] == [Kind.LEFT_OUT]) == bool(gone)


@pytest.mark.parametrize("word", ["near", "ligands", "LIG", "NA+", "A", "12345"])
def test_words_that_can_be_a_name_or_are_a_kind_are_taken(word):
    check_words([word])


@pytest.mark.parametrize("word", ["ligand", "lig", "ABCDEF", "", "A B", "ALL*"])
def test_other_words_are_refused(word):
    with pytest.raises(pc.ProtochainError, match=re.escape(f"keep {word!r} is not known")):
        check_words(["near", word])


def template(name, *heavy):
    return Template(name, {**dict.fromkeys(heavy, "C"), "H": "H"}, {}, (), {"O1P": "OP1"})


DNA = {
    "DA": template("DA", "P", "O3'"),
    "5'-P-DA": template("5'-P-DA", "P", "O3'"),
    "DA5": template("DA5", "O3'"),
    "DA3": template("DA3", "P", "O3'"),
    "DAN": template("DAN", "O3'"),
    "LIG": template("LIG", "C"),
    "ALA": template("ALA", "C"),
}


@pytest.mark.parametrize(("far", "bonded"), [(2.5, True), (9.99, True), (10.0, False)])
def test_bonded_nucleotides_are_a_strand_and_others_stand_alone(far, bonded):
    first = member("DA", 1, ("P", -5.0), ("O3'", 0.0), chain="B")
    second = member("DA", 2, ("P", far), ("O3'", 9.0), chain="B")
    water, last = member("LIG", 3, ("C", 9.1), chain="B"), member("LIG", 4, ("C", 9.1), chain="C")
    draft = Draft("x", "x")
    given = [HeteroResidue(each, each.name) for each in (first, second, water, last)]
    parts = kept_of(draft, given, ("all",), DNA)
    run(draft, (report_hetero,))
    strands = [[first, second]] if bonded else [[first], [second]]
    assert [part.members for part in parts] == [*strands, [water], [last]]
    assert all(part.obstacle and not part.cyclic for part in parts)
    assert [part.chain_id for part in parts] == ["B"] * (len(parts) - 1) + ["C"]
    assert kinds(draft) == [Kind.KEPT, *([] if bonded else 2 * [Kind.PHOSPHATE])]
    assert all((each.atom("P") is not None) is bonded for each in (first, second))
    assert all(each.template is None for each in (first, second, water, last))


def test_each_strand_is_one_part_and_ends_of_two_are_not_joined():
    """Where numbers go on from one chain to the next, O3' and P of a duplex may be 10 angstrom apart."""
    strands = [
        [member("DA", n, ("P", at + 7.0 * n), ("O3'", at + 7.0 * n + 5.4), chain=chain) for n in numbers]
        for chain, numbers, at in (("B", (1, 2, 3), 0.0), ("C", (4, 5, 6), 5.0))
    ]
    given = [HeteroResidue(each, each.name) for strand in strands for each in strand]
    assert [part.members for part in kept_of(Draft("x", "x"), given, ("all",), DNA)] == strands


def test_of_a_strand_the_nucleotides_that_the_templates_do_not_fit_are_kept_by_element():
    first = member("DA", 1, ("P", -5.0), ("O3'", 0.0))
    second = member("DA", 2, ("P", 1.6), ("O3'", 9.0), ("CX", 10.0))
    third = member("DA", 3, ("P", 10.6), ("O3'", 18.0))
    draft = Draft("x", "x")
    parts = kept_of(draft, [HeteroResidue(each, "DA") for each in (first, second, third)], ("all",), DNA)
    assert [(part.members, part.mobile) for part in parts] == [
        ([first], True),
        ([second], False),
        ([third], True),
    ]
    assert (first.template, third.template) == (None, None)
    assert second.template.element == {"P": "P", "O3'": "O", "CX": "C"}
    assert [[a.name for a in each.links] for each in (first, second, third)] == [["O3'"], [], ["P"]]
    assert first.atom("P") and third.atom("P")
    (stays,) = (each for each in draft.repairs if each.kind is Kind.NUCLEOTIDES_STAY)
    assert [each.number for each in stays.facts["residues"]] == ["2"]


def test_a_template_fits_the_same_heavy_atoms_by_any_name_and_no_amino_acid():
    for name, atoms, fits in (
        ("LIG", ("C",), True), ("LIG", ("C", "H9"), True), ("LIG", ("C", "O"), False), ("XXX", ("C",), False),
        ("ALA", ("C",), False), ("DA", ("P", "O3'"), True),
    ):  # fmt: skip
        residue = member(name, 1, *((atom_name, float(k)) for k, atom_name in enumerate(atoms)))
        kept_of(Draft("x", "x"), [HeteroResidue(residue, name)], ("all",), DNA)
        assert (residue.template is None) is fits, (name, atoms)
    known = {"LIG": template("LIG", "OP1")}
    residue = member("LIG", 1, ("O1P", 0.0))
    kept_of(Draft("x", "x"), [HeteroResidue(residue, "LIG")], ("all",), known)
    assert residue.template is None


def test_all_of_a_phosphate_is_left_out_of_the_first_nucleotide_only():
    names = ("P", "OP1", "OP2", "OP3", "O1P", "O2P", "O3P", "O5'", "O3'", "O2'")
    strand = member("A", 1, *((name, 0.0) for name in names))
    ligand = member("ATP", 2, ("P", 9.0))
    draft = Draft("x", "x")
    known = {"AN": template("AN", "O5'", "O3'", "O2'"), "DGN": template("DGN", "O5'")}
    kept_of(draft, [HeteroResidue(strand, "A"), HeteroResidue(ligand, "ATP")], ("all",), known)
    assert [a.name for a in strand.atoms] == ["O5'", "O3'", "O2'"] and [a.name for a in ligand.atoms] == ["P"]
    clean = Draft("x", "x")
    kept_of(clean, [HeteroResidue(member("DG", 1, ("O5'", 0.0)), "DG")], ("all",), known)
    run(clean, (report_hetero,))
    assert len(clean.parts) == 1
    assert kinds(clean) == [Kind.KEPT]


def test_molecules_by_element_have_bonds_by_distance():
    """C-O bonds up to 0.73 + 0.66 + 0.4 = 1.8 angstrom, and not below 0.5."""
    ligand = member("LIG", 1, ("C1", 0.0), ("O1", 1.7), ("O2", -1.9), ("C2", 0.4), ("H1", 1.8), ("H2", -9.0))
    reach = [gemmi.Element(e).covalent_r for e in "CO"]
    assert 1.7 < sum(reach) + 0.4 < 1.9
    ligand.atoms[1].charge = -1
    made = template_by_element(ligand)
    assert made.name == "LIG" and made.synonyms == {}
    assert made.element == {"C1": "C", "O1": "O", "O2": "O", "C2": "C", "H1": "H", "H2": "H"}
    assert made.charge == {"C1": 0.0, "O1": -1.0, "O2": 0.0, "C2": 0.0, "H1": 0.0, "H2": 0.0}
    # Each hydrogen is bonded to the nearest heavy atom, however far.
    assert {frozenset(bond) for bond in made.bonds} == {
        frozenset(pair) for pair in (("C1", "O1"), ("O1", "C2"), ("O1", "H1"), ("O2", "H2"))
    }
    assert len(made.bonds) == 4


@pytest.mark.parametrize(("given", "name"), [("HOH", "HOH"), ("DOD", "HOH"), ("ATP", "XXX"), ("Q?Q", "XXX")])
def test_waters_of_the_tables_get_the_name_of_water(given, name):
    found = rename_water(member("XXX", 5, ("O", 1.0), code="B"), given)
    assert (found.name, found.seqid, found.atoms[0].name) == (name, "5B", "O")


# --- Bonds to what is kept


def beside(*parts):
    """A cysteine, a histidine and an aspartate, and molecules beside them."""
    return Draft(
        "x",
        "x",
        [Part("A", [*parts[0]]), *(Part("B", [each], Evidence.ELEMENTS) for each in parts[1:])],
    )


def ion(symbol, number, *place):
    return Member(symbol.upper(), str(number), "", "B", [atom(symbol.upper(), symbol, list(place))])


def placed(name, number, **atoms):
    return Member(name, str(number), "", "A", [atom(n, n[0], list(x)) for n, x in atoms.items()])


@pytest.mark.parametrize(
    ("name", "donor", "metal", "limit"),
    [
        ("CYS", "SG", "Zn", 1.99 + 0.75), ("HIS", "NE2", "Zn", 1.99 + 0.5), ("ASP", "OD1", "Ca", 2.36 + 0.5),
        ("ASP", "OD1", "K", 2.74 + 0.5), ("CYS", "SG", "Cd", 2.3 + 0.75), ("HIS", "NE2", "Fe", 2.04 + 0.5),
    ],
)  # fmt: skip
def test_donors_are_bonded_to_a_metal_up_to_its_usual_distance_and_some(name, donor, metal, limit):
    near = limit - {"SG": 0.75}.get(donor, 0.5) - 0.6
    for far, bonded in (
        (limit - 0.01, True),
        (limit + 0.01, False),
        (near - 0.01, False),
        (near + 0.01, True),
    ):
        residue = placed(name, 1, CA=(9.0, 9.0, 0.0), **{donor: (far, 0.0, 0.0)}, H=(0.5, 0.0, 0.0))
        draft = beside([residue], ion(metal, 7, 0.0, 0.0, 0.0))
        links = linked(draft)
        assert [(each.atom.name, each.is_metal) for each in links] == [(donor, True)] * bonded
        assert [a.name for a in residue.metals] == [donor] * bonded and residue.links == []
        assert kinds(draft) == [Kind.ION_HELD] * bonded
        assert not bonded or f"{donor} of A:{name}1 ({far:.2f}" in sentences(draft)[0]


def test_carbon_and_the_amides_of_a_chain_are_no_donors_unless_the_file_says_so():
    for names, stated, bonded in (
        ({"N": 2.0, "CA": 9.0}, False, False), ({"N": 2.0, "CA": 9.0}, True, True), ({"N": 2.0}, False, True),
        ({"CB": 2.0}, False, False), ({"CB": 3.29}, True, True), ({"CB": 3.31}, True, False),
        ({"CB": 0.7}, True, False),
    ):  # fmt: skip
        residue = placed("ALA", 1, **{name: (x, 0.0, 0.0) for name, x in names.items()})
        draft = beside([residue], ion("Zn", 7, 0.0, 0.0, 0.0))
        first = next(iter(names))
        draft.stated_bonds = [(("B", "7", "ZN"), ("A", "1", first))] * stated
        assert [each.atom.name for each in linked(draft)] == [first] * bonded, names
        # What the file says and is not done is reported.
        said = [f"{each}" for each in draft.repairs if each.kind is Kind.BOND_IGNORED]
        assert len(said) == (stated and not bonded)
        assert not said or f"it is {names[first]:.2f} angstrom long" in said[0]


def sugar(*extra):
    """C1 of a sugar at the origin, with its ring, beside an asparagine whose ND2 is 1.44 angstrom away."""
    ring = {"C1": (0, 0, 0), "C2": (-0.5, 1.44, 0), "O5": (-0.48, -0.68, 1.16), "C5": (-1.9, -0.7, 1.2)}
    atoms = [atom(name, name[0], list(map(float, x))) for name, x in ring.items()]
    made = Member("NAG", "5", "", "B", [*atoms, *(atom(name, name[0], list(x)) for name, x in extra)])
    made.source = template_by_element(made)
    return made


def asparagine(far, *extra):
    at = {"ND2": (far, 0.0, 0.0), "CG": (far + 0.7, -1.1, 0.0), "CB": (far + 2.2, -1.1, 0.0)}
    return placed("ASN", 1, **at, **dict(extra))


def alanine(*extra):
    at = {"N": (1.44, 0.0, 0.0), "CA": (2.14, -1.1, 0.0), "C": (3.64, -1.1, 0.0)}
    return placed("ALA", 1, **at, **dict(extra))


def test_a_known_kind_of_bond_is_made_at_its_length_and_waters_have_none():
    usual = sum(gemmi.Element(e).covalent_r for e in "NC")
    for far, bonded in ((usual + 0.29, True), (usual + 0.31, False), (usual - 0.31, False)):
        residue, beside_it = asparagine(far), sugar()
        draft = beside([residue], beside_it)
        (link,) = linked(draft) or [None]
        assert (link is not None) is bonded
        assert [a.name for a in residue.links] == ["ND2"] * bonded and residue.metals == []
        if bonded:
            assert (link.member, link.atom.name, link.hetero, link.hetero_atom.name) == (
                residue, "ND2", beside_it, "C1",
            )  # fmt: skip
            assert not link.is_metal and kinds(draft) == [Kind.BONDED]
    water = Member("HOH", "5", "", "B", [atom("O", "O", [0.0] * 3)])
    assert linked(beside([placed("ASN", 1, ND2=(1.4, 0.0, 0.0))], water)) == []
    assert linked(beside([placed("ASN", 1, ND2=(1.4, 0.0, 0.0))])) == []


BONDS_TO_SUGARS = {
    "ASN": {"ND2": "CG", "OD1": ""}, "ASP": {"OD1": "CG", "OD2": "CG"}, "GLU": {"OE1": "CD", "OE2": "CD"},
    "SER": {"OG": "CB"}, "THR": {"OG1": "CB"}, "TYR": {"OH": "CZ"}, "CYS": {"SG": "CB"}, "LYS": {"NZ": "CE"},
    "HIS": {"ND1": "CG", "NE2": "CD2"}, "TRP": {"CD1": "CG", "NE1": ""}, "GLN": {"NE2": "", "OE1": ""},
    "ARG": {"NE": "", "NH1": "", "NH2": ""}, "MET": {"SD": ""},
}  # fmt: skip
"""Atoms that bond to C1 of a sugar, each with its neighbour, or none if no protein has such a bond."""


@pytest.mark.parametrize("name", BONDS_TO_SUGARS)
def test_every_atom_that_is_known_to_bond_to_sugars_does_without_a_record(name):
    for donor, neighbour in BONDS_TO_SUGARS[name].items():
        far = sum(gemmi.Element(e).covalent_r for e in (donor[0], "C"))
        residue = placed(name, 1, **{donor: (far, 0.0, 0.0), neighbour or "CB": (far + 0.7, -1.2, 0.0)})
        draft = beside([residue], sugar())
        assert [link.atom.name for link in linked(draft)] == [donor] * bool(neighbour), donor
        assert kinds(draft) == [Kind.BONDED if neighbour else Kind.NEAR]


@pytest.mark.parametrize(
    ("residue", "other", "why"),
    [
        (asparagine(1.44), sugar(("O1", (-0.48, -0.68, -1.16))), ""),
        (asparagine(1.44), sugar(("O1", (-0.48, -0.68, -1.16)), ("H1", (0.65, -0.3, 0.8))), "four others"),
        (asparagine(1.44), sugar(("C9", (0.9, 0.0, 1.1))), "an angle of 39 degrees"),
        (asparagine(1.44, ("H1", (1.4, 0.9, 0.0)), ("H2", (1.4, -0.3, 0.9))), sugar(), "two hydrogens"),
        (asparagine(1.44, ("OD1", (-1.9, -0.7, -0.2))), sugar(), "another close pair"),
        (placed("ARG", 1, NH1=(1.44, 0.0, 0.0), CZ=(2.1, -1.1, 0.0)), sugar(), "no known kind"),
        (alanine(("H1", (1.4, 0.9, 0.0))), sugar(), ""),
        (alanine(("H1", (1.4, 0.9, 0.0)), ("H2", (1.4, -0.3, 0.9))), sugar(), "two hydrogens of an amide"),
    ],
)  # fmt: skip
def test_what_cannot_be_a_bond_is_an_overlap_and_is_named(residue, other, why):
    residue = Member(residue.name, "1", "", "A", list(residue.atoms))
    draft = beside([residue], other)
    assert bool(linked(draft)) is not bool(why), why
    assert bool(residue.links) is not bool(why)
    if why:
        assert kinds(draft) == [Kind.NEAR]
        # What the file states is believed, if there is a valence.
        draft = beside([residue], other)
        draft.stated_bonds = [(("A", "1", residue.atoms[0].name), ("B", "5", "C1"))]
        assert len(linked(draft)) == 1


def test_a_bond_of_the_file_that_cannot_be_is_said_to_be_ignored():
    for far, bonded in ((0.81, True), (0.79, False), (2.13, True), (2.15, False), (5.0, False)):
        draft = beside([placed("ARG", 1, NH1=(far, 0.0, 0.0))], sugar())
        draft.stated_bonds = [(("B", "5", "C1"), ("A", "1", "NH1"))]
        assert len(linked(draft)) == bonded
        assert (Kind.BOND_IGNORED in kinds(draft)) is not bonded
    full = sugar(("O1", (-0.48, -0.68, -1.16)), ("C8", (0.1, 0.9, -1.2)))
    draft = beside([placed("SER", 1, OG=(1.44, 0.0, 0.0))], full)
    draft.stated_bonds = [(("A", "1", "OG"), ("B", "5", "C1"))]
    assert linked(draft) == [] and "C1 of B:NAG5 has no valence" in sentences(draft)[0]


def test_an_ion_moves_if_the_protein_alone_holds_it_on_all_sides():
    def site(n, kept=(), absent=(), symbol="Zn"):
        places = 1.35 * np.array([[1, 1, 1], [-1, -1, 1], [-1, 1, -1], [1, -1, -1]])
        holders = [placed("CYS", k, SG=tuple(x)) for k, x in enumerate(places[:n].tolist(), 1)]
        metal = ion(symbol, 7, 0.0, 0.0, 0.0)
        water = {
            far: Member("HOH", "8", "", "B", [atom("O", "O", [0.0, far, 0.0])]) for far in (*kept, *absent)
        }
        draft = beside(holders, metal, *(water[far] for far in kept))
        draft.omitted = [water[far] for far in absent]
        links = linked(draft)
        assert len(links) == n and (kinds(draft)[0] is Kind.ION_MOVES) is moves(draft, metal, links)
        assert not moves(draft, metal, [])
        return moves(draft, metal, links)

    assert site(4) and site(4, kept=[3.31]) and site(4, absent=[3.31])
    assert (
        not site(3) and not site(4, kept=[3.29]) and not site(4, absent=[3.29]) and not site(4, symbol="Ca")
    )
    # More than one atom is no ion.
    pair = Member("ZN2", "9", "", "B", [*ion("Zn", 7, 0.0, 0.0, 0.0).atoms, atom("O", "O", [9.0, 9.0, 9.0])])
    bound = beside([placed("CYS", 1, SG=(2.3, 0.0, 0.0))], pair)
    assert len(linked(bound)) == 1 and not moves(bound, pair, linked(bound))


def tied(draft, bonds):
    """Springs of a draft whose atoms are numbered in order, by atoms."""
    links = linked(draft)
    at, x, element = {}, [], []
    for member_ in draft.members:
        at[id(member_)] = {a.name: len(x) + k for k, a in enumerate(member_.atoms)}
        x += [a.pos.tolist() for a in member_.atoms]
        element += [a.element.name for a in member_.atoms]
    found = ties(links, at, np.array(x) / 10.0, element, np.array(bonds))
    assert len({tie.atoms for tie in found}) == len(found)
    return {tie.atoms: (tie.rest, tie.stiffness) for tie in found}


def test_springs_hold_distances_and_angles_of_a_metal_site():
    """CB 0, HB 1, SG 2; CB 3, SG 4; zinc 5: a right angle at zinc, and at the first sulphur."""
    first = placed("CYS", 1, CB=(2.3, 1.8, 0.0), HB=(2.3, 2.8, 0.0), SG=(2.3, 0.0, 0.0))
    second = placed("CYS", 2, CB=(0.0, 4.1, 0.0), SG=(0.0, 2.2, 0.0))
    draft = beside([first, second], ion("Zn", 7, 0.0, 0.0, 0.0))
    found = tied(draft, [[0, 1], [0, 2], [1, 2], [2, 5], [3, 4], [4, 5]])
    # The second CB is in line with zinc, whose angle gets no spring, and hydrogens get none.
    assert found == {
        (2, 5): (pytest.approx(0.23), 4.8e5), (4, 5): (pytest.approx(0.22), 4.8e5),
        (0, 2, 5): (pytest.approx(np.pi / 2), 540.0), (2, 5, 4): (pytest.approx(np.pi / 2), 300.0),
    }  # fmt: skip
    for degrees, held in ((169.9, True), (170.1, False)):
        turn = np.radians(180.0 - degrees)
        second.atom("CB").pos = gemmi.Position(1.9 * np.sin(turn), 2.2 + 1.9 * np.cos(turn), 0.0)
        assert ((3, 4, 5) in tied(draft, [[0, 1], [0, 2], [2, 5], [3, 4], [4, 5]])) is held


@pytest.mark.parametrize(("far", "length"), [(1.5, 0.15), (2.0, 0.144)])
def test_springs_of_a_covalent_bond_hold_the_angles_at_both_ends(far, length):
    """CG 0, ND2 1; C1 2, O5 3, H1 4. Too long a bond is drawn in, too small an angle opened."""
    residue = placed("ASN", 1, CG=(far, 1.3, 0.0), ND2=(far, 0.0, 0.0))
    atoms = [atom("C1", "C", [0.0] * 3), atom("O5", "O", [0.8, 0.0, 1.4]), atom("H1", "H", [-1.0, 0.0, 0.0])]
    draft = beside([residue], Member("NAG", "5", "", "B", atoms))
    draft.stated_bonds = [(("A", "1", "ND2"), ("B", "5", "C1"))]
    assert tied(draft, [[0, 1], [1, 2], [2, 3], [2, 4]]) == {
        (1, 2): (pytest.approx(length), 2.7e5), (0, 1, 2): (pytest.approx(np.pi / 2), 500.0),
        (1, 2, 3): (pytest.approx(np.pi / 2), 500.0),
    }  # fmt: skip


def test_distances_are_in_nm_and_angles_at_the_middle():
    assert measure(np.array([[0.0, 0.3, 0.0], [0.4, 0.0, 0.0]])) == pytest.approx(0.5)
    assert measure(np.array([[1.0, 0, 0], [0, 0, 0], [-1.0, 1.0, 0]])) == pytest.approx(0.75 * np.pi)
    assert measure(np.array([[1.0, 0, 0], [0, 0, 0], [-2.0, 0, 0]])) == pytest.approx(np.pi)
    assert is_metal("Zn") and is_metal("Na") and not is_metal("S")


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
    return found.residue.name, found.altloc, found.occupancy, found.unused_altlocs, found.repeated


def test_one_location_is_kept_with_what_all_share_and_what_only_another_has():
    mixed = residue(
        "SER", ("N", "", 1.0), ("CA", "B", 0.5), ("CA", "A", 0.5), ("OG", "B", 0.25), ("HB", "B", 1.0),
        ("HG", "A", 0.5), ("H", "", 1.0),
    )  # fmt: skip
    found = pick_altloc([mixed.clone()], "")
    # B: 0.5, 0.25 and 1.0; A: 0.5 and 0.5.
    assert told(found) == ("SER", "B", pytest.approx(1.75 / 3), ["SER A"], ["CA"])
    assert [(a.name, a.pos.x, a.altloc) for a in found.residue] == [
        ("N", 0.0, "\0"), ("CA", 1.0, "\0"), ("OG", 3.0, "\0"), ("HB", 4.0, "\0"), ("H", 6.0, "\0"),
    ]  # fmt: skip
    other = pick_altloc([mixed.clone()], "A")
    assert told(other) == ("SER", "A", 0.5, ["SER B"], ["CA"])
    assert [(a.name, a.pos.x) for a in other.residue] == [
        ("N", 0.0), ("CA", 2.0), ("OG", 3.0), ("HG", 5.0), ("H", 6.0),
    ]  # fmt: skip
    assert told(pick_altloc([mixed.clone()], "C"))[1] == "B"


def test_without_alternates_the_first_of_each_name_is_kept():
    found = pick_altloc([residue("ALA", ("N", "", 0.5), ("CB", "", 0.1), ("N", "", 1.0), ("H", "", 1.0))], "")
    assert told(found) == ("ALA", "", 1.0, [], ["N"])
    assert [(a.name, a.pos.x) for a in found.residue] == [("N", 0.0), ("CB", 1.0), ("H", 3.0)]


def test_a_backbone_that_the_file_gives_once_belongs_to_every_alternative():
    backbone = [(name, "", 1.0) for name in ("N", "CA", "C", "O")]
    first = residue("SER", *backbone, ("H", "", 1.0), ("OG", "A", 0.25))
    second = residue("ALA", ("CA", "B", 0.75), ("CB", "B", 0.75))
    found = pick_altloc([first.clone(), second.clone()], "")
    assert told(found) == ("ALA", "B", 0.75, ["SER A"], [])
    assert [(a.name, a.pos.x) for a in found.residue] == [
        ("CA", 0.0), ("CB", 1.0), ("N", 0.0), ("C", 2.0), ("O", 3.0),
    ]  # fmt: skip
    bare = residue("ALA", ("CB", "B", 0.75))
    assert sorted(a.name for a in pick_altloc([first.clone(), bare], "").residue) == [
        "C",
        "CA",
        "CB",
        "N",
        "O",
    ]


def test_residues_of_one_number_with_alternates_share_a_place():
    chain = gemmi.Chain("A")
    for name, altloc, number in (
        ("SER", "A", 1), ("THR", "B", 1), ("ALA", "", 1), ("GLY", "B", 2), ("LEU", "C", 2),
    ):  # fmt: skip
        chain.add_residue(residue(name, ("N", altloc, 1.0), number=number))
    assert [[each.name for each in group] for group in group_alternates(chain)] == [
        ["SER", "THR"],
        ["ALA"],
        ["GLY", "LEU"],
    ]
    group_alternates(chain)[0][0].name = "XXX"
    assert chain[0].name == "SER"
