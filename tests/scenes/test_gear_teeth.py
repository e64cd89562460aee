"""A tooth's stiffness by finite elements, plane stress, of a rim and one tooth on it."""

import numpy as np
import pytest
import skfem
from skfem.helpers import eye, sym_grad, trace

from bench.scenes.gear import ELEMENTS
from bench.scenes.gear import teeth as weber
from bench.scenes.gear.geometry import GearPair
from bench.scenes.gear.mesh import Gear
from bench.scenes.gear.quasi import at_rest
from bench.scenes.gear.teeth import Bent, flattening, mesh_stiffness, pair_stiffness

E, NU = 206e9, 0.3
"""Steel."""


def tooth(wheel, n):
    """Mesh of 8 n by 2 n quadrilaterals on 8 n by 6 n of a rim of four modules, a pitch to either side."""
    across, side = np.linspace(-1.0, 1.0, 2 * n + 1), np.linspace(0.0, 1.0, 2 * n + 1)[1:]
    deep = np.linspace(wheel.root - 4.0 * wheel.module, wheel.root, 8 * n + 1)
    high = np.linspace(wheel.root, wheel.tip, 8 * n + 1)[1:]
    far, foot = 1.5 * 2.0 * np.pi / wheel.teeth, wheel.half_angle(np.array(wheel.root))
    wing = foot + (far - foot) * side
    angles = np.concatenate([-wing[::-1], foot * across, wing])
    rim = deep[:, None] * np.exp(1j * angles)
    top = high[:, None] * np.exp(1j * wheel.half_angle(high)[:, None] * across)
    numbers = np.arange(rim.size).reshape(rim.shape)
    above = np.vstack([numbers[-1:, 2 * n : 4 * n + 1], rim.size + np.arange(top.size).reshape(top.shape)])
    quads = [
        np.stack([a[:-1, :-1], a[1:, :-1], a[1:, 1:], a[:-1, 1:]]).reshape(4, -1) for a in (numbers, above)
    ]
    points = np.concatenate([rim.ravel(), top.ravel()])
    return skfem.MeshQuad(np.array([points.real, points.imag]), np.hstack(quads))


def compliance(wheel, n, place=0.0):
    """Give of the tooth's middle along the line of action, m^2/N, under the force at a place.

    What its flank gives way about the force is left to the law of contact.
    """
    mesh = tooth(wheel, n)
    basis = skfem.Basis(mesh, skfem.ElementVector(skfem.ElementQuad2()))

    @skfem.BilinearForm
    def energy(u, v, _):
        strain, other = sym_grad(u), sym_grad(v)
        stress = E / (1.0 - NU**2) * ((1.0 - NU) * strain + NU * eye(trace(strain), 2))
        return (stress * other).sum(axis=(0, 1))

    # The line of action crosses the middle of the tooth.
    radius = wheel.touched(place)
    lean = np.arccos(wheel.base / radius) - wheel.half_angle(np.array(radius))
    along, middle = -np.array([np.sin(lean), np.cos(lean)]), wheel.base / np.cos(lean)

    @skfem.LinearForm
    def pushed(v, w):
        # Spread over the tooth by a bell of half a module, so that no point of the mesh matters.
        bell = np.exp(-0.5 * ((w.x[0] - middle) ** 2 + w.x[1] ** 2) / (0.25 * wheel.module) ** 2)
        return bell * (along[0] * v[0] + along[1] * v[1])

    load = pushed.assemble(basis)
    load /= load @ basis.project(lambda x: np.array([along[0] + 0.0 * x[0], along[1] + 0.0 * x[0]]))
    held = basis.get_dofs(
        lambda x: (
            (np.hypot(*x) < wheel.root - 3.99 * wheel.module)
            | (np.abs(np.arctan2(x[1], x[0])) > 1.5 * 2.0 * np.pi / wheel.teeth - 1e-6)
        )
    )
    moved = skfem.solve(*skfem.condense(energy.assemble(basis), load, D=held))
    return float(load @ moved)


def test_teeth_of_finite_elements_are_as_stiff_as_the_scene_says():
    pair = GearPair()
    coarse, fine = (1.0 / sum(compliance(wheel, n) for wheel in pair.wheels) for n in (3, 6))
    assert fine == pytest.approx(coarse, rel=0.01)
    assert pytest.approx(fine, rel=0.01) == ELEMENTS
    # ISO 6336-1, c'_th = 1/q of teeth that touch, for discs of standard teeth; some 300 N/mm.
    q = 1e-9 * (0.04723 + 0.15551 / pair.teeth[0] + 0.25791 / pair.teeth[1])
    assert 1.0 / fine + flattening(pair, 3e5) == pytest.approx(q, rel=0.06)


def test_stiffness_along_the_flank_is_that_of_finite_elements():
    pair = GearPair()
    for place, room in ((pair.path[0], 0.12), (-5e-3, 0.03), (0.0, 0.03), (5e-3, 0.03), (pair.path[1], 0.12)):
        solid = sum(compliance(wheel, 3, at) for wheel, at in zip(pair.wheels, (place, -place), strict=True))
        assert pair_stiffness(pair, np.array(place)) == pytest.approx(1.0 / solid, rel=room)


def test_the_polynomial_of_a_compliance_is_the_integral():
    pair = GearPair()
    for wheel, sign, series in zip(pair.wheels, (1.0, -1.0), weber.along(pair), strict=True):
        for place in np.linspace(*pair.path, 23):
            assert series(place) == pytest.approx(weber.compliance(wheel, sign * place), rel=2e-5)


@pytest.mark.parametrize("teeth", [(20, 40), (31, 47), (25, 100), (40, 40)])
def test_mesh_stiffness_is_that_of_iso_6336(teeth):
    pair = GearPair(teeth)
    give = flattening(pair, 3e5)
    one = pair_stiffness(pair, np.linspace(*pair.path, 201), give)
    q = 1e-9 * (0.04723 + 0.15551 / teeth[0] + 0.25791 / teeth[1])
    assert one.max() == pytest.approx(1.0 / q, rel=0.05)
    assert mesh_stiffness(pair, give) / one.max() == pytest.approx(0.75 * pair.contact_ratio + 0.25, rel=0.05)
    # At the ends of the path of contact a pair is a third softer.
    assert one[[0, -1]] / one.max() == pytest.approx(0.65, abs=0.03)


def test_springs_of_teeth_push_with_the_gradient_of_their_energy():
    model, q = at_rest(Gear(along=True), 2e-3)
    (springs,) = (part for part in model.conservative if isinstance(part, Bent))
    q = q + 1e-5 * np.random.default_rng(3).normal(size=len(q))

    def energy(at):
        return springs.add(at, None, None, np.zeros_like(at))

    torques = np.zeros_like(q)
    springs.add(q, None, None, torques)
    steps = 1e-7 * np.eye(len(q))
    gradient = np.array([energy(q + step) - energy(q - step) for step in steps]) / 2e-7
    # Each freedom by its own scale: the wheels' torques are of second order in the bending.
    assert -torques == pytest.approx(gradient, rel=1e-5, abs=1e-8 * np.abs(gradient).max())
