"""What colours the residues of a page."""

from types import SimpleNamespace

import numpy as np
import pytest
from fixtures.samples import energy, load

import protochain as pc
from protochain.comparison.colourings import colourings
from protochain.energies.custom import CustomEnergy
from protochain.results.viewer import DISPLACEMENT, Colouring, pockets, scene


def test_energies_are_the_shares_of_residues_and_their_change():
    s = load("1ubq.pdb")
    moved = s.with_positions(s.positions * 1.002)
    found = {each.name: each for each in colourings({"start": s, "end": moved}, energy("1ubq.pdb"))}
    tables = [pc.energy_terms(each, "residue", energy=energy("1ubq.pdb")) for each in (s, moved)]
    for name, column in (("energy, kJ/mol", "total"), ("angles, kJ/mol", "angles")):
        for end, table in zip(("start", "end"), tables, strict=True):
            assert found[name].values[end] == pytest.approx(table[column].to_numpy())
    change = tables[1]["total"] - tables[0]["total"]
    assert [*found["change of energy, kJ/mol"].values] == ["end"]
    assert found["change of energy, kJ/mol"].values["end"] == pytest.approx(change.to_numpy())
    assert "CMAP, kJ/mol" not in found
    last = s.atom_residue == 75
    heavy = last & (s.atom_element != "H")
    assert found["B factor of the input"].values["end"][75] == pytest.approx(s.b_factor[heavy].mean())


def test_of_a_callable_there_are_no_energies():
    s = load("1l2y.pdb")
    assert colourings({"start": s}, CustomEnergy(lambda x: (0.0, 0.0 * x))) == []


def test_a_scale_tells_most_values_apart_and_is_about_zero_where_they_have_a_sign():
    s = load("ala10.pdb")
    values = np.array([-3.0, 1.0, 2.0, *[0.5] * 7])
    made = scene({"a": s}, [Colouring("both", {"a": values}, True), Colouring("one", {"a": values + 4.0})])
    both, one = made["colourings"]
    assert both["low"] == -both["high"] and 2.0 < both["high"] <= 3.0
    assert [each["is_signed"] for each in (both, one)] == [True, False]
    assert one["low"] == 1.0 and 5.0 < one["high"] <= 6.0
    assert one["values"] == [(values + 4.0).tolist()] and made["chosen"] == -1
    nothing = scene({"a": s}, [Colouring("none", {"a": np.full(10, np.nan)})])["colourings"][0]
    assert (nothing["low"], nothing["high"], nothing["values"]) == (0.0, 0.0, [[None] * 10])


def test_displacements_are_of_all_ends_on_one_scale():
    s = load("ala10.pdb")
    far = s.positions.copy()
    far[0] += [0.5, 0.0, 0.0]
    made = scene({"start": s, "end": s.with_positions(far)}, chosen=DISPLACEMENT)
    assert made["chosen"] == 0 and made["colourings"][0]["values"] is None
    assert 0.1 <= made["colourings"][0]["high"] <= 2.0
    assert made["residues"] == [f"A:{k}" for k in range(1, 11)]


def test_a_pocket_has_the_residues_near_its_ligand_at_any_end_and_the_bonds_between_both():
    """Not bonds within the ligand or within the protein, whichever end is the donor."""
    x = np.array([[0.0, 0, 0], [0.3, 0, 0], [3.0, 0, 0], [0.1, 0.3, 0], [0.2, 0.3, 0], [9.0, 0, 0]])
    later = x + np.array([0, 0, 0, 1, 1, 0])[:, None] * [2.7, 0.0, 0.0]
    s = SimpleNamespace(
        atom_residue=np.array([0, 1, 2, 3, 3, 4]), atom_name=np.array([*"NOSABN"]),
        residue_chain=np.array([*"AAABA"]), residue_number=np.array([*"57917"]),
        ligands=(SimpleNamespace(atoms=np.array([3, 4])),), residue="B:LIG{}".format,
    )  # fmt: skip
    bonds = np.array([[3, 4], [0, 3], [4, 1], [0, 1], [5, 2]])
    (one,) = pockets(s, bonds, x)
    (both,) = pockets(s, bonds, x, later)
    assert one["ligand"] == [{"chain": "B", "resi": 1}] and one["name"] == "B:LIG3"
    assert [place["resi"] for place in one["near"]] == [5, 7]
    assert [place["resi"] for place in both["near"]] == [5, 7, 9]
    ends = [[(end["resi"], end["atom"]) for end in bond] for bond in one["bonds"]]
    assert ends == [[(5, "N"), (1, "A")], [(1, "B"), (7, "O")]]
