"""Heavy atoms that are missing, too many or under other names: what is added where, and what is said."""

import random

import gemmi
import numpy as np
import pytest

import protochain as pc
from protochain.structure import complete as module
from protochain.structure.complete import add_heavy_atoms
from protochain.structure.draft import Draft, Member, Part, atom
from protochain.structure.templates import templates


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
    add_heavy_atoms(draft, templates())
    return draft


def refused(*members, known=None, **kinds):
    with pytest.raises(pc.ProtochainError) as error:
        add_heavy_atoms(drafted(*members, **kinds), templates() if known is None else known)
    return str(error.value)


def glycine(number, *more):
    return member("GLY", number, *BACKBONE, *more)


def test_an_open_end_gets_its_oxygen_and_a_continued_one_loses_it():
    first, second, third = glycine(1, "OXT"), glycine(2, "H", "OXT"), glycine(3, "H")
    draft = completed(first, second, third)
    assert draft.repairs == [
        "residue 1 GLY of chain A: OXT left out: the chain continues",
        "residue 2 GLY of chain A: OXT left out: the chain continues",
        "residue 3 GLY of chain A: missing OXT added",
    ]
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
    made = module._terminal_oxygen(Draft("x", "x"), carboxyl(np.array([-1.5, 0, 0]), np.array([0, 1.2, 0])))
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
        made = module._terminal_oxygen(Draft("x", "x"), bent)
        assert made.pos.dist(bent.atom("C").pos) == pytest.approx(1.25, abs=1e-9)
        return
    with pytest.raises(pc.ProtochainError) as error:
        module._terminal_oxygen(Draft("x", "x"), bent)
    assert (
        str(error.value) == "x: residue 7 GLY of chain A: CA, C and O are collinear; correct the coordinates"
    )


def test_residues_and_atoms_without_parameters_are_named():
    assert refused(member("LIG", 1, "C"), obstacle=True) == (
        "x: residue 1 LIG of chain A: the force field has no parameters for it; remove it"
    )
    assert refused(glycine(1), member("LIG", 2, "C")) == (
        "x: residue 2 LIG of chain A: the force field has no parameters for it at the end of a chain; "
        "remove it"
    )
    assert refused(glycine(1), glycine(2, "HQ", "OXT", "CX", "CY")) == (
        "x: residue 2 GLY of chain A: atom CX does not belong to GLY; rename or remove it"
    )
    assert refused(glycine(1), member("HYP", 2, *BACKBONE, "CB"), glycine(3)) == (
        "x: residue 2 HYP of chain A: atom CD missing; build it, or remove the residue"
    )
    assert refused(member("HOH", 1, "H1"), obstacle=True) == (
        "x: residue 1 HOH of chain A: atom O missing; build it, or remove the residue"
    )


def test_renamed_atoms_are_listed_up_to_four():
    serine = member("SER", 2, "N", "CA", "C", "OT1", "CB", "OG", "HB1")
    draft = completed(glycine(1), serine, glycine(3, "OXT"))
    assert names(serine)[3] == "O" and draft.repairs == [
        "atoms renamed: OT1 to O of residue 2 SER of chain A, HB1 to HB3 of residue 2 SER of chain A"
    ]
    four = [member("GLY", k, "N", "CA", "C", "OT1") for k in range(1, 6)]
    said = [f"OT1 to O of residue {k} GLY of chain A" for k in range(1, 5)]
    assert completed(*four[:4]).repairs[0] == f"atoms renamed: {', '.join(said)}"
    again = [member("GLY", k, "N", "CA", "C", "OT1") for k in range(1, 7)]
    assert completed(*again).repairs[0] == f"atoms renamed: {', '.join(said)} and 2 more"


def test_neighbours_are_residues_within_fifteen_angstrom_of_the_first_atoms():
    far = [member("GLY", k, "N", "CA", x=x) for k, x in enumerate((0.0, 14.9, 15.0, -14.9, -15.1))]
    assert module._around(far, far[0]) == [far[0], far[1], far[3]]


def test_neighbours_are_written_without_hydrogens_and_numbered_by_place():
    text = module._as_mmcif([glycine(40, "H"), member("SER", 30, "N", "CB")]).read()
    block = gemmi.cif.read_string(text).sole_block()
    wanted = [
        "label_atom_id",
        "label_comp_id",
        "auth_seq_id",
        "auth_asym_id",
        "pdbx_PDB_model_num",
        "Cartn_x",
    ]
    rows = [list(row) for row in block.find("_atom_site.", wanted)]
    assert rows == [
        *([name, "GLY", "1", "A", "1", f"{2 * k}"] for k, name in enumerate(BACKBONE, 1)),
        ["N", "SER", "2", "A", "1", "2"], ["CB", "SER", "2", "A", "1", "4"],
    ]  # fmt: skip
    # One polymer.
    assert [list(row) for row in block.find("_entity.", ["type"])] == [["polymer"]]
    assert len(block.find_values("_struct_asym.id")) == 1


def test_the_random_generator_is_seeded_for_a_while():
    state = random.getstate()
    with module._seeded():
        assert random.random() == random.Random(1).random()
    assert random.getstate() == state
    with pytest.raises(KeyError), module._seeded():
        raise KeyError
    assert random.getstate() == state


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


def test_missing_atoms_of_a_side_chain_are_built_where_they_belong():
    part = serines()
    without(part[0], "CB", "OG"), without(part[1], "OG")
    draft = completed(*part)
    assert draft.repairs == [
        "residue 5 SER of chain A: missing CB, OG added", "residue 6 SER of chain A: missing OG added",
    ]  # fmt: skip
    assert names(part[0])[-2:] == ["CB", "OG"] and names(part[1])[-1] == "OG"
    assert [a.element.name for a in part[0].atoms[-2:]] == ["C", "O"]
    assert (
        part[0].atom("CB").b_iso
        == part[0].atom("OG").b_iso
        == pytest.approx(np.mean([a.b_iso for a in part[0].atoms[:-2]]))
    )
    # On its side of CA, and one bond from it.
    alpha, n, c, beta = (np.array(part[0].atom(name).pos.tolist()) for name in ("CA", "N", "C", "CB"))
    assert np.dot(np.cross(n - alpha, c - alpha), beta - alpha) > 1.0
    assert 1.4 < np.linalg.norm(beta - alpha) < 1.65
    assert 1.2 < part[1].atom("OG").pos.dist(part[1].atom("CB").pos) < 1.6


def test_a_residue_is_built_alone_and_twice_the_same():
    part = serines()
    without(part[0], "OG"), without(part[1], "OG", "OXT")
    first, second = module._built(part, part[1]), module._built(part, part[1])
    assert set(first) == {"N", "CA", "C", "O", "CB", "OG"} and first == second
    assert first["OG"][0] == "O" and first["CA"][1] == pytest.approx(
        part[1].atom("CA").pos.tolist(), abs=1e-6
    )


def test_an_atom_that_cannot_be_built_is_named(monkeypatch):
    monkeypatch.setattr(module, "_built", lambda neighbours, one: {})
    assert refused(without(serines()[0], "OG"), serines()[1]) == (
        "x: residue 5 SER of chain A: atom OG is missing and cannot be built; add it there"
    )
