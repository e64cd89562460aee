"""Flexible beams of finite segments, and small motions about a state, against beams of textbooks."""

import numpy as np
import pytest

from protochain.core.errors import MechanicsError
from protochain.mechanics.multibody import centre_of_mass, pose
from protochain.mechanisms import Mechanism
from protochain.mechanisms.linear import frequencies, state_matrix
from protochain.mechanisms.segments import Beam, add_beam

ROOTS = np.array([1.87510407, 4.69409113, 7.85475744])
"""Of cos b cosh b = -1."""
DIFFERENCES = 1e-6
"""Relative error of frequencies by differences: rounding over the nudge, magnified by the stiffest mode."""


def clamped(beam, cells, **more):
    m = Mechanism()
    segments = add_beam(m, "beam", beam, cells, **more)
    return m, segments


def test_a_beam_becomes_rods_and_hinges_in_order():
    beam = Beam(2.0, 3.0, (5.0, 7.0), twist=11.0, polar=0.01, rigid=0.1)
    m, segments = clamped(beam, 4, bends="xz")
    model = m.build()
    assert segments.bodies == tuple(f"beam {k}" for k in range(5))
    assert segments.hinges == (
        "beam 1x",
        "beam 1z",
        "beam 2x",
        "beam 2z",
        "beam 3x",
        "beam 3z",
        "beam 4x",
        "beam 4z",
    )
    # The cells are 0.4 long, the first hinge 0.2 + 0.2 from the root.
    np.testing.assert_allclose(beam.lengths(4), [0.4, 0.4, 0.4, 0.4, 0.4], rtol=1e-15)
    state = model.state()
    np.testing.assert_allclose(state.point(*segments.tip), [2.0, 0.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(
        [state.point(f"beam {k}")[0] for k in range(5)], [0.0, 0.4, 0.8, 1.2, 1.6], atol=1e-15
    )
    assert model.tree.mass.sum() == pytest.approx(6.0, rel=1e-15)
    np.testing.assert_allclose(
        centre_of_mass(model.tree, pose(model.tree, model.q)), [1.0, 0.0, 0.0], atol=1e-15
    )
    assert np.count_nonzero(model.tree.mass == 0.0) == 4


def test_the_springs_are_those_of_their_axes():
    """Static energy of one turned hinge each: k q^2 / 2 with k = EI / h, h the flexible length of a cell."""
    m, segments = clamped(Beam(2.0, 3.0, (5.0, 7.0), twist=11.0, polar=0.01, rigid=0.1), 4, bends="xyz")
    model = m.build()
    for hinge, stiffness in zip(segments.hinges, [11.0 / 0.4, 5.0 / 0.4, 7.0 / 0.4] * 4, strict=True):
        q = model.q.copy()
        q[model.bodies.freedom(hinge)[0]] = 0.1
        assert model.system.at(q, model.qd).potential == pytest.approx(0.005 * stiffness, rel=1e-14)


def test_frequencies_are_a_beams_with_an_error_of_one_over_n_squared():
    beam = Beam(2.0, 3.0, 5.0)
    unit = np.sqrt(5.0 / (3.0 * 2.0**4))
    errors = [frequencies(clamped(beam, n)[0].build())[:3] / unit / ROOTS**2 - 1.0 for n in (8, 16)]
    np.testing.assert_allclose(100.0 * errors[1], [0.09, 0.31, 0.51], atol=0.005)
    np.testing.assert_allclose(np.log2(errors[0] / errors[1]), 2.0, atol=0.02)


def test_rigid_ends_are_left_out_of_what_bends():
    """Deflection by a small force at the tip: the sum over the cells of (l - x)^2 h / EI."""
    beam, cells, force = Beam(1.0, 1.0, 2.0, rigid=0.125), 6, 1e-4
    m, segments = clamped(beam, cells)
    m.load("force", *segments.tip, force=(0.0, force, 0.0))
    model = m.build()
    at = model.start()
    flexibility = -np.linalg.inv(state_matrix(model)[cells:, :cells])
    turned = flexibility @ model.system.accelerations(0.0, at.q, at.qd, *model.system.forces(
        0.0, at.q, at.qd, at.factors)[1:], at.factors)[0]  # fmt: skip
    places = 0.125 + 0.125 * (np.arange(6) + 0.5)
    np.testing.assert_allclose(turned, force * (1.0 - places) * 0.125 / 2.0, rtol=DIFFERENCES)


def test_damping_is_the_time_constant_of_every_hinge():
    m, _ = clamped(Beam(1.0, 1.0, 1.0), 5, damping=0.02)
    matrix = state_matrix(m.build())
    np.testing.assert_allclose(matrix[5:, 5:], 0.02 * matrix[5:, :5], rtol=DIFFERENCES, atol=1e-4)


def test_small_motions_of_a_pendulum_and_of_a_free_body_on_a_spring():
    m = Mechanism(gravity=(0.0, -9.0, 0.0))
    m.body("rod", mass=2.0, com=(0.0, -0.5, 0.0), inertia=(1.0 / 6.0, 0.0, 1.0 / 6.0))
    m.hinge("pin", parent="world", child="rod")
    m.torsion("damper", "pin", damping=0.4)
    matrix = state_matrix(m.build())
    # w^2 = m g l / 2 / (m l^2 / 3), c / (m l^2 / 3).
    np.testing.assert_allclose(matrix, [[0.0, 1.0], [-13.5, -0.6]], rtol=1e-8, atol=1e-8)
    m = Mechanism()
    m.body("ball", mass=0.5, inertia=0.1)
    for axis in range(3):
        end = 10.0 * np.eye(3)[axis]
        for side in (1.0, -1.0):
            m.spring(f"{axis}{side}", ("ball", (0, 0, 0)), ("world", side * end), stiffness=2.0, rest=10.0)
    # Springs across are slack to first order: each axis has two along it.
    np.testing.assert_allclose(frequencies(m.build()), np.sqrt(8.0), rtol=1e-5)


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"length": 0.0}, "must be above zero"), ({"mass": -1.0}, "none below zero"),
        ({"rigid": 0.5}, "leaves no free part"), ({"bending": (1.0, -1.0)}, "none below zero"),
        ({"bending": np.nan}, "finite"),
    ],
)  # fmt: skip
def test_beams_that_are_none_are_refused(fields, words):
    with pytest.raises(MechanicsError, match=words):
        Beam(**{"length": 1.0, "mass": 1.0, "bending": 1.0, **fields})


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"cells": 0}, "0 cells; give a whole number"), ({"cells": 2.5}, "2.5 cells"),
        ({"bends": "zz"}, "give axes of xyz"), ({"bends": ""}, "give axes of xyz"),
        ({"bends": "w"}, "give axes of xyz"), ({"bends": "x"}, "no stiffness about x"),
        ({"damping": -1.0}, "none below zero"), ({"name": "taken"}, "named twice"),
    ],
)  # fmt: skip
def test_segments_that_cannot_be_are_refused(given, words):
    m = Mechanism()
    m.body("taken 0", 1.0)
    arguments = {"name": "beam", "beam": Beam(1.0, 1.0, 1.0), "cells": 2, **given}
    with pytest.raises(MechanicsError, match=words):
        add_beam(m, **arguments)
