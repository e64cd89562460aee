"""Restraints on a few atoms, by hand; what is refused, word for word."""

import numpy as np
import pytest
from fixtures.samples import load

import protochain as pc
from protochain.chains.contacts import radii
from protochain.minimisers.restraints import Hold, Leash, SoftRepulsion, Sum, Tethers


def test_tethers_pull_each_atom_home_by_its_own_weight():
    tethers = Tethers(np.array([[1.0, 0.0, 0.0], [0.0, 2.0, 0.0]]), np.array([3.0, 10.0]))
    value, forces = tethers(np.array([[1.0, 2.0, 0.0], [1.0, 2.0, -1.0]]))
    assert value == 0.5 * 3.0 * 4.0 + 0.5 * 10.0 * 2.0 and type(value) is float
    assert forces.tolist() == [[0.0, -6.0, 0.0], [-10.0, 0.0, 10.0]]
    s = load("ala10.pdb")
    held = Tethers.of_heavy_atoms(s, 7.0)
    assert held.home is s.positions
    assert held.weight.tolist() == [0.0 if element == "H" else 7.0 for element in s.atom_element]


def turned(x):
    """Turn by a right angle about z, and move."""
    return x @ np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]) + [1.0, 2.0, 3.0]


def test_a_leash_is_a_wall_from_nine_tenths_of_its_limit():
    s = load("1l2y.pdb")
    alpha = s.alpha_carbons
    home = s.positions[alpha]
    # A breath: x -> (1 + a) x about the middle has an RMSD of a times the radius of gyration.
    middle = home - home.mean(axis=0)
    radius = np.sqrt(np.mean(np.sum(middle**2, axis=1)))
    for share, beyond in ((0.5, 0.0), (0.95, 0.05), (1.2, 0.3)):
        limit = 0.4  # angstrom
        x = s.positions.copy()
        x[alpha] += share * 0.04 / radius * middle
        leash = Leash(s, limit)
        size, gradient = leash.rmsd(turned(x))
        assert size == pytest.approx(share * 0.04, rel=1e-9)
        assert gradient == pytest.approx(turned(middle) / radius / len(alpha) - turned(0 * middle) / radius /
                                         len(alpha), abs=1e-9)  # fmt: skip
        # At the limit it has risen to 10 kJ/mol a residue.
        strength = 2.0 * 10.0 * 20 / (0.1 * 0.04) ** 2
        value, forces = leash(x)
        assert value == pytest.approx(0.5 * strength * (beyond * 0.04) ** 2, rel=1e-6)
        along = middle / radius / len(alpha)
        assert forces[alpha] == pytest.approx(-strength * beyond * 0.04 * along, rel=1e-6, abs=1e-9)
        assert not np.delete(forces, alpha, axis=0).any()
        assert leash.allows(x) is (share <= 1.0)
    assert Leash(s, 10.0 * leash.rmsd(x)[0]).allows(x)
    size, gradient = leash.rmsd(s.positions)
    assert size < 1e-12 and np.abs(gradient).max() < 1e-2


def test_soft_repulsion_parts_unbonded_atoms_nearer_than_its_share_of_contact():
    s = load("ala10.pdb")
    first, other, third = 0, s.n_atoms - 1, s.n_atoms // 2
    x = 5.0 * np.arange(s.n_atoms)[:, None] * np.array([1.0, 0.0, 0.0])
    x[other] = x[first] + [0.0, 0.06, 0.08]
    reach = 0.7 * (radii(s)[first] + radii(s)[other])
    value, forces = SoftRepulsion(s)(x)
    assert value == pytest.approx(0.5 * 1e4 * (reach - 0.1) ** 2, rel=1e-9)
    push = 1e4 * (reach - 0.1) * np.array([0.0, 0.6, 0.8])
    assert forces[other] == pytest.approx(push, rel=1e-9) and forces[first] == pytest.approx(-push, rel=1e-9)
    assert not np.delete(forces, [first, other], axis=0).any()
    # Two pairs on one atom add up; at one point there is energy but no direction.
    x[third] = x[first] - [0.0, 0.06, 0.08]
    both = SoftRepulsion(s)(x)[1]
    assert both[other] == pytest.approx(push, rel=1e-9)
    x[third], x[other] = x[first] + [5.0, 7.0, 0.0], x[first]
    value, forces = SoftRepulsion(s)(x)
    assert value == pytest.approx(0.5 * 1e4 * reach**2, rel=1e-9) and not forces.any()


def test_a_sum_adds_energies_and_forces():
    def one(x):
        return 1.5, x

    value, forces = Sum([one, lambda x: (2.0, np.ones_like(x)), one])(np.array([[1.0, 2.0, 3.0]]))
    assert value == 5.0 and forces.tolist() == [[3.0, 5.0, 7.0]]


def term(x):
    return 1.0, np.zeros_like(x)


def test_restraints_come_springs_first_then_the_term_then_the_leash():
    s = load("ala10.pdb")
    found = Hold((100.0, 0.0), 0.5, term).restraints(s)
    kinds = [[type(part).__name__ for part in each.parts] for each in found]
    assert kinds == [["Tethers", "partial", "Leash"], ["partial", "Leash"]]
    assert found[0].parts[1].args == (term,) and found[0].parts[2].limit == 0.5
    assert found[0].parts[0].weight.max() == 100.0
    assert Hold((0.0, 0.0)).restraints(s) == [None, None]


def test_what_holds_is_read_from_numbers_words_and_callables():
    for given, strengths in (
        (5, (5.0,)), (2.5, (2.5,)), ((1000, 100.0, 0), (1000.0, 100.0, 0.0)), ("1e3 1", (1000.0, 1.0)),
        ((), ()), ("", ()), (np.array([3.0, 2.0]), (3.0, 2.0)),
    ):  # fmt: skip
        assert Hold.of(given) == Hold(strengths, np.inf, None)
        assert Hold.of(given, 0.5) == Hold(strengths, 0.5, None)
    assert Hold.of(term, 0.5) == Hold((), 0.5, term)
    assert Hold.of((3.0, 0.0)).record() == [3.0, 0.0] and Hold().record() == []
    assert Hold((3.0,), term=term).record() == [3.0, pc.energies.custom.name_of(term)]


OR = " in kJ/mol/nm^2, as '1000 100 0', or a file of restraints"


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"restraints": -0.5}, "restraints -0.5: give strengths in kJ/mol/nm^2, none below 0"),
        ({"restraints": (1.0, np.inf)}, "restraints 1 inf: give strengths in kJ/mol/nm^2, none below 0"),
        ({"restraints": "much"}, "restraints 'much': no such file; give strengths{OR}"),
        ({"restraints": [[]]}, "restraints [[]]: give strengths{OR}"),
        ({"restraints": (), "max_rmsd": 0.0}, "max_rmsd 0: give a number of angstrom above 0"),
        ({"restraints": (), "max_rmsd": np.nan}, "max_rmsd nan: give a number of angstrom above 0"),
    ],
)  # fmt: skip
def test_what_cannot_hold_is_refused(given, said):
    with pytest.raises(pc.ProtochainError) as refusal:
        Hold.of(**given)
    assert str(refusal.value) == said.replace("{OR}", OR)
