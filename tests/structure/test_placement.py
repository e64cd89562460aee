"""Hydrogens placed on molecules made by hand, where their positions follow on paper."""

import numpy as np
import pytest

from protochain.core.arrays import sphere
from protochain.structure.molecule import hydrogens as module
from protochain.structure.molecule.hydrogens import place_hydrogens

LENGTH = {"C": 0.109, "N": 0.101, "O": 0.096, "S": 0.1336, "P": 0.109}
SHIFT = np.array([1.0, -2.0, 0.5])
TETRAHEDRAL, ROUNDED = np.radians(109.5), 1.01e-6


def placed(atoms, *bonds):
    """Positions after placement of atoms (element, position or None, charge)."""
    x = np.array([[np.nan] * 3 if at is None else at for _, at, *_ in atoms], dtype=float)
    charge = np.array([rest[0] if rest else 0.0 for _, _, *rest in atoms])
    given = x.copy()
    found = place_hydrogens(x, [element for element, *_ in atoms], charge, np.array(bonds))
    known = ~np.isnan(given[:, 0])
    assert np.array_equal(found[known], given[known]) and np.array_equal(x, given, equal_nan=True)
    hydrogens = found[~known]
    moved = place_hydrogens(x + SHIFT, [element for element, *_ in atoms], charge, np.array(bonds)) - SHIFT
    assert np.abs(moved - found).max() < 2 * ROUNDED
    assert np.array_equal(hydrogens, np.round(hydrogens, 6)) and np.isfinite(found).all()
    return found


def at(found, expected):
    assert np.abs(np.asarray(found) - expected).max() < ROUNDED


@pytest.mark.parametrize("element", list(LENGTH))
def test_a_fourth_bond_is_opposite_to_three(element):
    axes = [("C", (0.15 if k else 0.3) * row) for k, row in enumerate(np.eye(3))]
    x = placed([(element, [0, 0, 0]), *axes, ("H", None)], (0, 1), (0, 2), (0, 3), (0, 4))
    at(x[4], -LENGTH[element] * np.ones(3) / np.sqrt(3.0))


A, B = np.array([0.15, 0, 0]), np.array([0, 0.14, 0])
BACK, UP = -np.array([1.0, 1.0, 0]) / np.sqrt(2.0), np.array([0, 0, -1.0])
PAIR = [np.cos(0.5 * TETRAHEDRAL) * BACK + side * np.sin(0.5 * TETRAHEDRAL) * UP for side in (1, -1)]
"""Directions to two hydrogens beside bonds along x and y: the first on the side of y cross x."""


def test_two_hydrogens_stand_above_and_below_two_bonds():
    atoms = [("C", [0.0, 0, 0]), ("C", A), ("C", B), ("H", None), ("H", None)]
    at(placed(atoms, (0, 1), (0, 2), (0, 3), (0, 4))[3:], 0.109 * np.array(PAIR))
    at(placed(atoms, (0, 2), (0, 1), (0, 3), (0, 4))[3:], 0.109 * np.array(PAIR[::-1]))


def test_one_hydrogen_of_a_carbon_or_nitrogen_in_a_plane_lies_in_it():
    ring = [("C", A), ("C", B), ("H", None)]
    at(placed([("C", [0.0, 0, 0]), *ring], (0, 1), (0, 2), (0, 3))[3], 0.109 * BACK)
    # A nitrogen is planar beside a carbon with three neighbours, and beside no other.
    more = [("C", A + np.array([0.1, 0.1, k])) for k in (-0.1, 0.0, 0.1)]
    bonds = [(0, 1), (0, 2), (0, 3), (1, 4), (1, 5)]
    at(placed([("N", [0.0, 0, 0]), *ring, *more[:2]], *bonds)[3], 0.101 * BACK)
    at(placed([("N", [0.0, 0, 0]), *ring, *more], *bonds, (1, 6))[3], 0.101 * PAIR[0])
    at(placed([("N", [0.0, 0, 0]), ("S", A), *ring[1:], *more[:2]], *bonds)[3], 0.101 * PAIR[0])
    at(placed([("S", [0.0, 0, 0]), *ring, *more[:2]], *bonds)[3], 0.1336 * PAIR[0])


NEAR, HEAVY, LIGHT = [0.15, 0, 0], [0.2, 0.1, 0], [0.2, 0.0, 0.1]
"""A neighbour along x, and atoms behind it towards y and z."""


def around(degrees, turns):
    angle, turns = np.radians(degrees), np.radians(turns)
    return np.array([[np.cos(angle), np.sin(angle) * np.cos(t), np.sin(angle) * np.sin(t)] for t in turns])


def test_hydrogens_of_an_amide_lie_in_its_plane_the_last_one_opposite():
    amide = [("N", [0.0, 0, 0]), ("C", NEAR), ("O", HEAVY), ("C", [0.2, -0.1, 0])]
    two = placed([*amide, ("H", None), ("H", None)], (0, 1), (1, 2), (1, 3), (0, 4), (0, 5))
    at(two[4:], 0.101 * around(120, (0, 180)))
    imine = placed(
        [("C", [0.0, 0, 0]), *amide[1:], ("N", [-0.1, 0.1, 0]), ("H", None)],
        *((0, 1), (1, 2), (1, 3), (0, 4), (0, 5)),
    )
    at(imine[5], 0.109 * module._unit(np.array([np.sqrt(0.5) - 1.0, -np.sqrt(0.5), 0])))


@pytest.mark.parametrize("element", ["C", "N"])
def test_hydrogens_of_a_methyl_are_staggered_against_a_heavy_atom(element):
    atoms = [
        (element, [0.0, 0, 0]), ("C", NEAR), ("H", LIGHT), ("C", HEAVY), ("H", None), ("H", None),
        ("H", None),
    ]  # fmt: skip
    bonds = [(0, 1), (1, 2), (1, 3), (0, 4), (0, 5), (0, 6)]
    at(placed(atoms, *bonds)[4:], LENGTH[element] * around(109.5, (180, 300, 60)))
    # Without a heavy atom behind, against the first hydrogen, here along z.
    light = placed([*atoms[:3], ("H", [0.2, 0.1, 0]), *atoms[4:]], *bonds)
    at(light[4:], LENGTH[element] * around(109.5, (270, 30, 150)))


def test_a_methyl_needs_something_to_be_staggered_against():
    """Nothing behind, or all in line: against the axis that is most nearly perpendicular."""
    ethane = [("C", [0.0, 0, 0]), ("C", NEAR), ("H", None), ("H", None), ("H", None)]
    bonds = [(0, 1), (0, 2), (0, 3), (0, 4)]
    at(placed(ethane, *bonds)[2:], 0.109 * around(109.5, (180, 300, 60)))
    # The arm has no part across the axis: x cross y is z.
    in_line = placed([*ethane, ("N", [0.3, 0, 0])], *bonds, (1, 5))
    at(in_line[2:5], 0.109 * around(109.5, (270, 30, 150)))


def oracle(parent, choices, length, others):
    """Place of least energy: 1389.35 q q / (4 r[angstrom]) kJ/mol angstrom, and (2 / r)^12."""
    energies = []
    for way in choices:
        total = 0.0
        for x, product in others:
            r = 10.0 * np.linalg.norm(parent + length * way - x)
            total += 1389.35 * product / (4.0 * r * r) + (2.0 / r) ** 12
        energies.append(total)
    return parent + length * choices[int(np.argmin(np.round(energies, 6)))]


@pytest.mark.parametrize(("element", "degrees"), [("O", 108.5), ("S", 96.0), ("P", 109.5)])
@pytest.mark.parametrize("seed", range(4))
def test_a_hydroxyl_turns_to_the_lowest_energy_within_reach(element, degrees, seed):
    rng = np.random.default_rng(seed)
    away = np.array([0.31, 0.31, 0.45, 0.599, 0.601])
    ways = rng.normal(size=(5, 3))
    around_it = away[:, None] * ways / np.linalg.norm(ways, axis=1)[:, None]
    charges = [0.3, -0.5, -0.8, -4.0 * (seed % 2), -9.0]
    others = [("C", x, q) for x, q in zip(around_it, charges, strict=True)]
    atoms = [(element, [0.0, 0, 0], -0.6), ("C", NEAR, 3.0), ("H", None, 0.4), ("C", HEAVY, 0.2), *others]
    x = placed(atoms, (0, 1), (0, 2), (1, 3))
    # Neither the parent, nor its neighbours, nor what is beyond 0.6 nm.
    seen = [(np.array(HEAVY), 0.08), *((x, 0.4 * q) for x, q in zip(around_it[:4], charges, strict=False))]
    choices = around(degrees, np.arange(0, 360, 10))
    at(x[2], oracle(np.zeros(3), choices, LENGTH[element], seen))


def test_what_was_turned_before_counts_for_what_turns_after():
    """Two hydroxyls, their oxygens 0.3 nm apart: the second hydrogen avoids the first one."""
    pair = [
        ("O", [0.0, 0, 0], 0.0), ("C", NEAR), ("C", HEAVY), ("H", None, 1.0),
        ("O", [0.0, 0, 0.25], 0.0), ("C", [0.15, 0, 0.25]), ("C", [0.2, 0.1, 0.25]), ("H", None, 1.0),
        ("N", [-0.1, -0.1, 0.12], -0.2),
    ]  # fmt: skip
    x = placed(pair, (0, 1), (1, 2), (0, 3), (4, 5), (5, 6), (4, 7))
    choices = around(108.5, np.arange(0, 360, 10))
    heavy = [np.array(pair[k][1]) for k in (1, 2, 5, 6)]
    acceptor = (np.array(pair[8][1]), -0.2)
    first = oracle(
        np.zeros(3),
        choices,
        0.096,
        [(heavy[1], 0.0), (heavy[2], 0.0), (heavy[3], 0.0), (np.array(pair[4][1]), 0.0), acceptor],
    )
    second = oracle(
        np.array(pair[4][1]), choices, 0.096,
        [(heavy[3], 0.0), (heavy[0], 0.0), (heavy[1], 0.0), (np.zeros(3), 0.0), acceptor, (first, 1.0)],
    )  # fmt: skip
    at(x[3], first)
    at(x[7], second)
    alone = oracle(
        np.array(pair[4][1]), choices, 0.096, [(np.zeros(3), 0.0), (heavy[0], 0.0), (heavy[1], 0.0), acceptor]
    )
    assert np.abs(alone - second).max() > 0.01


def test_the_first_hydrogen_of_a_water_points_anywhere_and_the_second_follows():
    water = [("O", [0.0, 0, 0], -0.8), ("H", None, 0.4), ("H", None, 0.4), ("O", [0.0, 0.0, 0.28], -0.8)]
    x = placed(water, (0, 1), (0, 2))
    ways = sphere(36)
    at(x[1], oracle(np.zeros(3), ways, 0.096, [(np.array([0, 0, 0.28]), -0.32)]))
    angle = np.degrees(np.arccos(x[1] @ x[2] / np.linalg.norm(x[1]) / np.linalg.norm(x[2])))
    assert angle == pytest.approx(104.52, abs=0.01)
    assert np.linalg.norm(x[1:3], axis=1) == pytest.approx([0.096, 0.096], abs=2e-6)


def test_directions_of_a_sphere_are_spread_on_a_golden_spiral():
    for n in (1, 36):
        z = [1.0 - (2 * k + 1) / n for k in range(n)]
        turn = [k * np.pi * (3.0 - 5.0**0.5) for k in range(n)]
        expected = [
            [np.sqrt(1 - h * h) * np.cos(t), np.sqrt(1 - h * h) * np.sin(t), h]
            for h, t in zip(z, turn, strict=True)
        ]
        assert np.allclose(sphere(n), expected, atol=1e-15)
    assert module._unit(np.array([0.0, 3.0, 4.0])).tolist() == [0.0, 0.6, 0.8]
    assert module._unit(np.array([0.0, 0.5e-9, 0.0])).tolist() == [1.0, 0.0, 0.0]
    assert module._unit(np.array([0.0, 1.5e-9, 0.0])).tolist() == [0.0, 1.0, 0.0]
    assert module._perpendicular_axis(np.array([-0.9, 0.1, 0.3])).tolist() == [0.0, 1.0, 0.0]
