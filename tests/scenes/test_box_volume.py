"""Contact of boxes by the volume of their overlap: volume, gradient, and what two cubes keep in an impact."""

import numpy as np
import pytest
from fixtures.refusals import expect_refusal
from scipy.optimize import linprog
from scipy.spatial import ConvexHull, HalfspaceIntersection, QhullError
from scipy.spatial.transform import Rotation

from bench.soil.box_volume import WHOLE, box_in_box, overlap
from bench.soil.parts import Law
from bench.soil.pile import Pile
from protochain.core.errors import Fault, MechanicsError

EDGE, MASS = 0.05, 0.2
SPACE = tuple(np.empty(shape) for shape in ((12, 7), (12, 7), (8, 8), (8, 8)))


def box(centre, rotation, half):
    return tuple(map(float, centre)), tuple(map(float, np.ravel(rotation))), tuple(map(float, half))


def volume(one, other):
    return overlap(*box(*one), *box(*other), *SPACE)[1]


def by_half_spaces(one, other):
    """Volume by scipy's intersection of twelve half-spaces, about a point that linear programming finds."""
    rows = []
    for centre, rotation, half in (one, other):
        for k in range(3):
            for sign in (1.0, -1.0):
                n = sign * rotation[:, k]
                rows.append([*n, -(n @ centre) - half[k]])
    rows = np.array(rows)
    left, bounds = np.column_stack([rows[:, :3], np.ones(12)]), [(None, None)] * 3 + [(0, None)]
    inside = linprog([0, 0, 0, -1], left, -rows[:, 3], bounds=bounds)
    if inside.status != 0 or inside.x[3] < 1e-9:
        return 0.0
    try:
        return ConvexHull(HalfspaceIntersection(rows, inside.x[:3]).intersections).volume
    except QhullError:
        return 0.0


def random_pair(rng, reach=1.0):
    def one():
        rotation = Rotation.random(random_state=rng).as_matrix()
        return rng.normal(size=3) * 0.3 * reach, rotation, rng.uniform(0.2, 1.0, 3)

    return one(), one()


def smallest(half):
    """Area of the smallest face."""
    return 4.0 * min(np.prod(np.delete(half, k)) for k in range(3))


def test_the_volume_is_that_of_twelve_half_spaces():
    rng = np.random.default_rng(0)
    met = 0
    for _ in range(100):
        one, other = random_pair(rng, 3.0)
        exact = by_half_spaces(one, other)
        assert volume(one, other) == pytest.approx(exact, rel=1e-9, abs=1e-12)
        assert volume(other, one) == pytest.approx(exact, rel=1e-9, abs=1e-12)
        met += exact > 0.0
    assert 25 < met < 95


def test_forces_are_the_gradient_of_the_energy():
    """Of V^2 / (2 S^2), for motions and turns of the first box, by central differences."""
    rng, h, met = np.random.default_rng(1), 1e-6, 0
    for _ in range(60):
        one, other = random_pair(rng, 2.0)
        face = min(smallest(b[2]) for b in (one, other))
        number, _, normal = box_in_box(*box(*one), *box(*other), *SPACE)
        if number == 0 or not np.any(normal):
            continue
        met += 1
        found = SPACE[2][:number].copy()
        push = (found[:, 3] * found[:, 4])[:, None] * found[:, 5:]
        force = -np.sum(push, axis=0)
        moment = -np.sum(np.cross(found[:, :3] - one[0], push), axis=0)

        def energy(shift, turn, one=one, other=other, face=face):
            moved = one[0] + shift, Rotation.from_rotvec(turn).as_matrix() @ one[1], one[2]
            return 0.5 * (volume(moved, other) / face) ** 2

        none, size = np.zeros(3), np.abs(force).max() + 1e-6
        for k, e in enumerate(np.eye(3)):
            slope = (energy(h * e, none) - energy(-h * e, none)) / (2 * h)
            assert force[k] == pytest.approx(-slope, abs=1e-6 * size)
            slope = (energy(none, h * e) - energy(none, -h * e)) / (2 * h)
            assert moment[k] == pytest.approx(-slope, abs=1e-6 * size)
        assert np.sum(found[:, 3] ** 2 * found[:, 4]) == pytest.approx(2.0 * energy(none, none), rel=1e-12)
        assert normal @ force < 0.0
    assert met > 20


def test_boxes_that_touch_do_not_press_and_one_within_another_has_no_way_out():
    half = np.full(3, 0.5)
    one = box(np.zeros(3), np.eye(3), half)
    for x in (1.0, 1.5):
        assert box_in_box(*one, *box([x, 0, 0], np.eye(3), half), *SPACE)[0] == 0
    turned = Rotation.from_euler("xyz", [0.3, 0.2, 0.1]).as_matrix()
    assert box_in_box(*box([0.01, 0, 0], turned, 0.1 * half), *one, *SPACE)[1] == WHOLE
    with expect_refusal(fault=Fault.OVERLAP, kind=MechanicsError, match="cube 0 lies in cube 1"):
        Pile([EDGE, EDGE], [MASS, MASS], Law(1e6, 0.0, by="volume"), np.zeros(3)).start(np.zeros((2, 3)))
