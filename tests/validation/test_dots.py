"""Molecular surfaces in dots, and shape complementarity: closed forms, a grid, and the program of others."""

import numpy as np
import pytest
import shape_complementarity as other_program
from fixtures.samples import load
from scipy.ndimage import distance_transform_edt
from scipy.spatial.distance import cdist

from protochain.structure.select import sides
from protochain.validation.complementarity import BAND, PROBE, WEIGHT, complementarity, shape_complementarity
from protochain.validation.dots import Dots, molecular_surface

DENSITY = 40.0
CLUSTERS = {
    "two apart": ([[0, 0, 0], [9, 0, 0]], [1.5, 1.8]),
    "two with the probe between": ([[0, 0, 0], [5.5, 0, 0]], [1.5, 1.8]),
    "two between which the probe meets itself": ([[0, 0, 0], [6.2, 0, 0]], [1.5, 1.8]),
    "three": ([[0, 0, 0], [4, 0, 0], [2, 3.6, 0]], [1.5, 1.8, 1.7]),
    "four": ([[0, 0, 0], [3, 0, 0], [1.5, 2.6, 0], [1.5, 0.9, 2.4]], [1.5, 1.8, 1.7, 1.6]),
    "one within another": ([[0, 0, 0], [0.2, 0, 0]], [1.9, 1.2]),
    "one all but upon another": ([[0, 0, 0], [0, 1e-3, 0], [3, 0, 0]], [1.5, 1.5, 1.5]),
}


def excluded_volume(x, radius, probe, grid):
    """angstrom^3: where no probe can be that touches no atom, counted on a grid."""
    low, high = x.min(axis=0) - radius.max() - 2 * probe, x.max(axis=0) + radius.max() + 2 * probe
    mesh = np.stack(
        np.meshgrid(*(np.arange(a, b, grid) for a, b in zip(low, high, strict=True)), indexing="ij"), -1
    )
    closed = np.zeros(mesh.shape[:3], dtype=bool)
    for centre, r in zip(x, radius, strict=True):
        closed |= ((mesh - centre) ** 2).sum(axis=-1) < (r + probe) ** 2
    return (grid * distance_transform_edt(closed) > probe).sum() * grid**3


@pytest.mark.parametrize("name", CLUSTERS)
def test_a_surface_is_closed_and_holds_the_volume_that_no_probe_enters(name):
    x, radius = (np.array(each, dtype=float) for each in CLUSTERS[name])
    dots = molecular_surface(x, radius, PROBE, DENSITY)
    # Some dots of each patch's rim are in or out: an edge's length by the distance of dots, of either sign.
    rim = np.sqrt(dots.area.sum() / DENSITY)
    assert np.abs((dots.area[:, None] * dots.normal).sum(axis=0)).max() < 0.5 * rim
    volume = (dots.area * (dots.x * dots.normal).sum(axis=1)).sum() / 3.0
    # The nearest open point lies a share of a step beyond the edge, which two grids take out; what is left,
    # as they lie, is two hundredths of the volume of a ball.
    counted = 2.0 * excluded_volume(x, radius, PROBE, 0.1) - excluded_volume(x, radius, PROBE, 0.2)
    assert volume == pytest.approx(counted, rel=0.025)
    assert np.allclose(np.linalg.norm(dots.normal, axis=1), 1.0)
    assert np.allclose(dots.probe, dots.x + PROBE * dots.normal)
    away = np.linalg.norm(dots.probe[:, None] - x, axis=2) - radius - PROBE
    # The probe that touches at one dot sweeps no other away.
    assert cdist(dots.x, dots.probe).min() > PROBE - 1e-6
    assert away.min() > -1e-9 and np.abs(away.min(axis=1)).max() < 1e-9


def test_the_surface_of_a_ball_is_its_own():
    dots = molecular_surface(np.zeros((1, 3)), np.array([1.5]), PROBE, DENSITY)
    assert dots.area.sum() == pytest.approx(4 * np.pi * 1.5**2) and len(dots) == np.ceil(
        4 * np.pi * 1.5**2 * DENSITY
    )


def test_part_of_a_surface_is_that_of_the_whole():
    """Asked for of some atoms, dots are those of the whole that the probe at these atoms alone makes."""
    s = load("ala10.pdb")
    heavy = s.atom_element != "H"
    x, radius = 10.0 * s.positions[heavy], np.full(heavy.sum(), 1.8)
    wanted = np.arange(len(x)) < 30
    every, some = (molecular_surface(x, radius, PROBE, 15.0, mask) for mask in (None, wanted))
    touched = np.abs(np.linalg.norm(every.probe[:, None] - x, axis=2) - radius - PROBE) < 1e-6
    alone = every[~(touched & ~wanted).any(axis=1)]
    assert 100 < len(some) < len(every) and len(some) == len(alone)
    assert some.area.sum() == pytest.approx(alone.area.sum())


def plane(height, up, n=60, step=0.2):
    x = np.stack(np.meshgrid(np.arange(n) * step, np.arange(n) * step), -1).reshape(-1, 2)
    x = np.column_stack([x, np.full(len(x), height)])
    normal = np.tile([0.0, 0.0, 1.0 if up else -1.0], (len(x), 1))
    return Dots(x, normal, np.full(len(x), step**2), x)


@pytest.mark.parametrize("gap", [0.0, 0.5])
def test_of_parallel_planes_it_falls_with_their_gap(gap):
    assert complementarity(plane(0.0, True), plane(gap, False)) == pytest.approx(np.exp(-WEIGHT * gap**2))


def test_of_planes_turned_the_same_way_it_is_minus_one():
    assert complementarity(plane(0.0, True), plane(0.0, True)) == pytest.approx(-1.0)


@pytest.mark.parametrize("gap", [0.0, 0.4])
def test_of_a_ball_in_a_cup_it_is_that_of_planes(gap):
    n = 4000
    z = 1.0 - (np.arange(n) + 0.5) / n
    turn = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(n)
    way = np.column_stack([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z])
    ball = Dots(5.0 * way, way, np.full(n, 1.0), way)
    cup = Dots((5.0 + gap) * way, -way, np.full(n, 1.0), way)
    assert complementarity(ball, cup) == pytest.approx(np.exp(-WEIGHT * gap**2))


def test_the_median_is_by_area_and_both_sides_count():
    """Three fifths of a plane lie under a flat part, the rest under a tilted one: the flat part decides."""
    flat, tilted = np.array([0.0, 0.0, -1.0]), np.array([0.0, 0.6, -0.8])
    x = np.array([[0.0, 0, 0], [10, 0, 0]])
    below = Dots(x, np.tile([0.0, 0, 1], (2, 1)), np.array([3.0, 2.0]), x)
    above = Dots(x, np.array([flat, tilted]), np.array([1.0, 4.0]), x)
    assert complementarity(below, above) == pytest.approx(0.5 * (1.0 + 0.8))


@pytest.mark.parametrize(("name", "first", "second"), [("3i40.pdb", "A", "B"), ("1ysa.pdb", "C", "D")])
def test_it_is_that_of_another_program(name, first, second):
    """Of the crate sc-rs, which follows CCP4's: its dots lie elsewhere, and there are some thousand."""
    s = load(name)
    atoms = [np.flatnonzero(side[s.atom_residue]) for side in sides(s, first, second)]
    names = s.residue_name[s.atom_residue]
    heavy = [its[(s.atom_element[its] != "H") & ~s.kept[its]] for its in atoms]
    # Its search is of all pairs of dots: take what is near.
    x = 10.0 * s.positions
    near = [
        a[np.linalg.norm(x[a][:, None] - x[b], axis=2).min(axis=1) < 8.0]
        for a, b in (heavy, heavy[::-1])
    ]  # fmt: skip
    given = [(x[a], s.atom_name[a].tolist(), names[a].tolist()) for a in near]
    found = shape_complementarity(s, s.positions, *near)
    assert found == pytest.approx(
        other_program.compute_sc(*given[0], *given[1], parallel=False).sc, abs=0.015
    )
    assert 0.6 < found < 0.8


def test_sides_that_bury_nothing_have_none():
    s = load("3i40.pdb")
    atoms = [np.flatnonzero(side[s.atom_residue]) for side in sides(s, "A", "B")]
    for gap in (0.5 * BAND + 4.0, 1000.0):
        x = s.positions + gap * (s.residue_chain[s.atom_residue] == "B")[:, None]
        assert np.isnan(shape_complementarity(s, x, *atoms))
