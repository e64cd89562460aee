"""Heavy atoms that are missing, too many or under other names: what is added where, and what is said."""

import numpy as np
import pytest
from fixtures.drafts import collected
from fixtures.repairs import kinds, sentences

import protochain as pc
from protochain.structure.molecule.member import Member, atom
from protochain.structure.molecule.repairs import Kind
from protochain.structure.preparation import complete as module
from protochain.structure.preparation.complete import add_heavy_atoms
from protochain.structure.preparation.prepare import run
from protochain.structure.preparation.structure_draft import Draft, Evidence, Part
from protochain.structure.sidechains.ideal import Site


def member(name, number, *atoms, x=0.0):
    """Atoms by name, two angstrom from each other."""
    made = [
        atom(label, label[0], [x + 2.0 * k, 0.3 * k * k, 0.0], 10.0 * k) for k, label in enumerate(atoms, 1)
    ]
    return Member(name, str(number), "", "A", made)


BACKBONE = ("N", "CA", "C", "O")


def drafted(*members, **kinds):
    return Draft("x", "x", [Part("A", list(members), **kinds)])


def names(one):
    return [a.name for a in one.atoms]


def completed(*members, **kinds):
    draft = drafted(*members, **kinds)
    return run(draft, (add_heavy_atoms,))


def refused(*members, known=None, **kinds):
    draft = drafted(*members, **kinds)
    if known is not None:
        draft.templates = known
    with pytest.raises(pc.ProtochainError) as error:
        run(draft, (add_heavy_atoms,))
    return str(error.value)


def glycine(number, *more):
    return member("GLY", number, *BACKBONE, *more)


def test_an_open_end_gets_its_oxygen_and_a_continued_one_loses_it():
    first, second, third = glycine(1, "OXT"), glycine(2, "H", "OXT"), glycine(3, "H")
    draft = completed(first, second, third)
    assert kinds(draft) == [Kind.INNER_OXT, Kind.INNER_OXT, Kind.OXT_ADDED]
    assert [names(m) for m in draft.members] == [[*BACKBONE], [*BACKBONE, "H"], [*BACKBONE, "H", "OXT"]]
    oxygen = third.atoms[-1]
    assert oxygen.element.name == "O" and oxygen.b_iso == 10.0
    assert completed(glycine(1), glycine(2, "OXT")).repairs == []
    assert names(completed(glycine(1), glycine(2), cyclic=True).members[1]) == [*BACKBONE]


def carboxyl(alpha, oxygen):
    """A residue with C at (1, 2, 3)."""
    c = np.array([1.0, 2.0, 3.0])
    made = [("CA", c + alpha), ("C", c), ("O", c + oxygen)]
    atoms = [atom(name, name[0], x.tolist(), b) for (name, x), b in zip(made, (5.0, 6.0, 7.0), strict=True)]
    return Member("GLY", "7", "", "A", atoms)


def test_the_second_oxygen_halves_the_angle_outside():
    bent = carboxyl(np.array([-1.5, 0, 0]), np.array([0, 1.2, 0]))
    made = module._terminal_oxygen(Draft("x", "x"), bent, "OXT")
    diagonal = 1.25 / np.sqrt(2.0)
    assert (made.name, made.element.name, made.b_iso) == ("OXT", "O", 5.0)
    assert made.pos.tolist() == pytest.approx([1.0 + diagonal, 2.0 - diagonal, 3.0], abs=1e-9)


@pytest.mark.parametrize(
    ("angle", "possible"),
    [(np.pi - 0.0009, False), (np.pi - 0.0015, True), (0.07, True), (0.05, False), (0, False)],
)
def test_the_second_oxygen_needs_an_angle(angle, possible):
    """Two unit vectors add up to 2 cos(angle / 2): 0.001 or 1.999 and more are refused."""
    bent = carboxyl(np.array([1.5, 0, 0]), 1.2 * np.array([np.cos(angle), np.sin(angle), 0.0]))
    if possible:
        made = module._terminal_oxygen(Draft("x", "x"), bent, "OXT")
        assert made.pos.dist(bent.atom("C").pos) == pytest.approx(1.25, abs=1e-9)
        return
    with pytest.raises(pc.ProtochainError, match="A:GLY7: no place for OXT"):
        module._terminal_oxygen(Draft("x", "x"), bent, "OXT")


def test_residues_and_atoms_without_parameters_are_named():
    hydroxyproline = (glycine(1), member("HYP", 2, *BACKBONE, "CB"), glycine(3))
    for refusal, words in (
        (
            refused(member("LIG", 1, "C"), evidence=Evidence.ELEMENTS),
            "A:LIG1: the force field has no",
        ),
        (refused(glycine(1), member("LIG", 2, "C")), "at the end of a chain"),
        (refused(glycine(1), glycine(2, "HQ", "OXT", "CX", "CY")), "atom CX does not belong to GLY"),
        (refused(*hydroxyproline), "A:HYP2: atom CD missing"),
        (
            refused(member("HOH", 1, "H1"), evidence=Evidence.ELEMENTS),
            "A:HOH1: atom O missing",
        ),
        (refused(member("ACE", 4, "C", "CH3"), *serines()), "A:ACE4: atom O missing"),
    ):
        assert words in refusal


def serines():
    """Two serines of standard geometry."""
    s = pc.from_sequence("SS")
    return [
        Member("SER", f"{r + 5}", "", "A", [
            atom(str(s.atom_name[i]), str(s.atom_element[i]), (10.0 * s.positions[i]).tolist(), 1.0 + i)
            for i in range(s.n_atoms) if s.atom_residue[i] == r
        ])
        for r in range(2)
    ]  # fmt: skip


def without(one, *gone):
    one.atoms = [a for a in one.atoms if a.name not in gone]
    return one


def at(one, name):
    return np.array(one.atom(name).pos.tolist())


def test_missing_atoms_of_a_side_chain_are_built_where_they_belong():
    part = serines()
    without(part[0], "CB", "OG"), without(part[1], "OG")
    mean = np.mean([a.b_iso for a in part[0].atoms])
    draft = drafted(*part)
    run(draft, (add_heavy_atoms,))
    assert sentences(draft) == [
        "A:SER5: missing CB, OG added", "A:SER6: missing OG added",
    ]  # fmt: skip
    # Hydrogens of the atoms that get a neighbour are placed anew, those of N are not.
    assert names(part[0]) == ["N", "H1", "H2", "H3", "CA", "C", "O", "CB", "OG"]
    assert names(part[1])[-1] == "OG" and {"H", "HA"} < {*names(part[1])} and "HB2" not in names(part[1])
    assert [a.element.name for a in part[0].atoms[-2:]] == ["C", "O"]
    assert part[0].atom("CB").b_iso == part[0].atom("OG").b_iso == pytest.approx(mean)
    # On its side of CA, and one bond from it.
    alpha, n, c, beta = (at(part[0], name) for name in ("CA", "N", "C", "CB"))
    assert np.dot(np.cross(n - alpha, c - alpha), beta - alpha) > 1.0
    assert np.linalg.norm(beta - alpha) == pytest.approx(1.53, abs=0.02)
    for one in part:
        assert one.atom("OG").pos.dist(one.atom("CB").pos) == pytest.approx(1.42, abs=0.01)
        assert np.array_equal(np.round(at(one, "OG"), 4), at(one, "OG"))


def test_an_atom_between_others_is_not_chosen_but_fitted():
    part = serines()
    beta = at(part[0], "CB")
    without(part[0], "CB")
    draft = drafted(*part)
    run(draft, (add_heavy_atoms,))
    assert np.linalg.norm(at(part[0], "CB") - beta) < 0.1
    assert sentences(draft) == ["A:SER5: missing CB added"]


def test_a_residue_of_a_d_name_is_built_in_the_mirror():
    part = serines()
    part[0].is_d = True
    completed(without(part[0], "CB", "OG"), part[1])
    alpha, n, c, beta = (at(part[0], name) for name in ("CA", "N", "C", "CB"))
    assert np.dot(np.cross(n - alpha, c - alpha), beta - alpha) < -1.0
    assert part[0].atom("OG").pos.dist(part[0].atom("CB").pos) == pytest.approx(1.42, abs=0.01)


def test_the_hand_is_that_of_the_atoms_then_of_the_name_then_of_the_chain(monkeypatch):
    draft = Draft("x", "x")
    whole, d = serines()
    d.is_d = True
    assert collected(draft, module._site(Part("A", [whole, d]), 1)).sign == 1
    without(d, "CB")
    assert collected(draft, module._site(Part("A", [whole, d]), 1)).sign == -1
    without(whole, "CB")
    site = collected(draft, module._site(Part("A", [whole, d]), 0))
    assert (site.sign, site.member, site.before, site.after) == (1, whole, None, d) and not sentences(draft)
    monkeypatch.setattr(module, "_is_misnamed", lambda part, i: True)
    assert collected(draft, module._site(Part("A", [whole, d]), 0)).sign == -1
    assert kinds(draft) == [Kind.BUILT_AS_D]
    assert collected(draft, module._site(Part("A", [whole, d]), 1)).sign == -1 and len(draft.repairs) == 1


@pytest.mark.parametrize(
    ("phi", "hands", "named_d", "misnamed"),
    [
        ((1, 1, 1, -1), (0, -1, -1, 1), (), True),
        ((1, 1, 1, -1), (0, -1, 1, 1), (), False),
        ((-1, 1, 1, -1), (0, -1, -1, 1), (), False),
        ((1, -1, 1, -1), (0, -1, 1, 1), (), False),
        ((1, 1, 1, -1), (0, -1, -1, -1), (1, 2), False),
        ((0, 1, 1, 1), (0, -1, -1, -1), (), False),
    ],
)
def test_names_are_wrong_where_most_of_positive_phi_are_of_the_other_hand(
    phi, hands, named_d, misnamed, monkeypatch
):
    part = Part("A", [glycine(k) for k in range(4)])
    for k in named_d:
        part.members[k].is_d = True
    monkeypatch.setattr(module, "_phi", lambda part, k: phi[k])
    monkeypatch.setattr(module, "chirality", lambda member: hands[part.members.index(member)])
    assert module._is_misnamed(part, 0) is misnamed


def bare(number, **atoms):
    return Member("GLY", str(number), "", "A", [atom(n, n[0], list(map(float, x))) for n, x in atoms.items()])


def test_phi_turns_from_the_carbon_before():
    before = bare(1, C=(1, 0, 0))
    one = bare(2, N=(0, 0, 0), CA=(0, 0, 1), C=(0.5, np.sqrt(0.75), 1))
    part = Part("A", [before, one])
    assert module._phi(part, 1) == pytest.approx(np.pi / 3) and module._phi(part, 0) == 0.0
    part = Part("A", [one, before])
    assert module._phi(part, 0) == 0.0
    part.cyclic = True
    assert module._phi(part, 0) == pytest.approx(np.pi / 3)


@pytest.mark.parametrize(("aside", "flat"), [(0.06, True), (0.07, False)])
def test_a_backbone_on_one_line_is_refused_where_something_is_built(aside, flat):
    """1.5 angstrom times 0.0667 are 0.1 square angstrom."""
    one = Member("SER", "1", "", "A", bare(1, N=(-1.5, 0, 0), CA=(0, 0, 0), C=(1.5, aside, 0)).atoms)
    if not flat:
        module._check_backbone(Draft("x", "x"), one)
        return
    with pytest.raises(pc.ProtochainError, match="A:SER1: N, CA and C are collinear"):
        module._check_backbone(Draft("x", "x"), one)


def test_atoms_that_leave_no_place_for_others_are_refused():
    draft, one = Draft("x", "x"), serines()[0]
    wrong = Site(one, -1, None, None)
    module._check_chirality(draft, wrong, {"OG", "O"})
    module._check_chirality(draft, Site(one, 1, None, None), {"CA", "CB"})
    for name in ("CA", "CB", "N", "C"):
        with pytest.raises(pc.ProtochainError, match=r"A:SER5: .* missing at CA"):
            module._check_chirality(draft, wrong, {name, "OG"})


def test_the_oxygen_of_a_peptide_bond_halves_the_angle_outside():
    one = bare(1, N=(-2, 1.4, 0), CA=(-1.5, 0, 0), C=(0, 0, 0))
    after = bare(2, N=(0, -1.33, 0), CA=(1, -2, 0), C=(2, -2, 0))
    wanted = pytest.approx(np.array([1.0, 1.0, 0.0]) * 1.23 / np.sqrt(2.0), abs=1e-9)
    draft = Draft("x", "x", [Part("A", [one, after])])
    assert module._carbonyl_oxygen(draft, draft.parts[0], 0) == wanted
    ring = Part("A", [after, one], cyclic=True)
    assert module._carbonyl_oxygen(Draft("x", "x", [ring]), ring, 1) == wanted
    end = bare(1, N=(-2, 1.4, 0), CA=(-1.5, 0, 0), C=(0, 0, 0), OXT=(0, -1.25, 0))
    alone = Part("A", [end])
    assert module._carbonyl_oxygen(Draft("x", "x", [alone]), alone, 0) == wanted


def test_the_oxygens_of_an_end_have_room():
    one = bare(1, N=(-2, 1.4, 0), CA=(-1.5, 0, 0), C=(0, 0, 0))
    part = Part("A", [one])
    draft = Draft("x", "x", [part])
    free = module._carbonyl_oxygen(draft, part, 0)
    # As far from N as the other oxygen: at right angles to the plane of N, CA and C.
    slope = np.radians(120.4 - 90.0)
    assert free == pytest.approx(1.23 * np.array([np.sin(slope), 0.0, np.cos(slope)]), abs=1e-6)
    # An atom there leaves room elsewhere, for both; a hydrogen does not count.
    for element, moves in (("C", True), ("H", False)):
        other = Member("LIG", "9", "", "B", [atom("X", element, (1.5 * free).tolist())])
        draft = Draft("x", "x", [part, Part("B", [other], evidence=Evidence.ELEMENTS)])
        found = module._carbonyl_oxygen(draft, part, 0)
        assert bool(np.linalg.norm(found - free) > 0.5) is moves
        opposite = found * [1.0, -1.0, -1.0]
        rooms = [np.linalg.norm(x - 1.5 * free) for x in (found, opposite)]
        assert not moves or min(rooms) > np.linalg.norm(0.5 * free) + 0.3
