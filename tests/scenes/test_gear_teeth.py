"""A tooth's stiffness by finite elements, plane stress, of a rim and one tooth on it."""

import numpy as np
import pytest
import skfem
from skfem.helpers import eye, sym_grad, trace

from bench.scenes.gear import ELEMENTS
from bench.scenes.gear.geometry import GearPair

E, NU = 206e9, 0.3
"""Steel."""


def half_angle(wheel, radius):
    """Half of a tooth's angle at a radius: involute, radial below its base, with a fillet at the root."""
    at = np.maximum(radius, wheel.base)
    lean = np.arccos(wheel.base / at)
    half = 0.5 * wheel.thickness / wheel.pitch + np.tan(wheel.pressure_angle) - wheel.pressure_angle
    fillet = 0.38 * wheel.module
    low = np.maximum(fillet - (radius - wheel.root), 0.0)
    return half - np.tan(lean) + lean + (fillet - np.sqrt(fillet**2 - low**2)) / radius


def tooth(wheel, n):
    """Mesh of 8 n by 2 n quadrilaterals on 8 n by 6 n of a rim of four modules, a pitch to either side."""
    across, side = np.linspace(-1.0, 1.0, 2 * n + 1), np.linspace(0.0, 1.0, 2 * n + 1)[1:]
    deep = np.linspace(wheel.root - 4.0 * wheel.module, wheel.root, 8 * n + 1)
    high = np.linspace(wheel.root, wheel.tip, 8 * n + 1)[1:]
    far, foot = 1.5 * 2.0 * np.pi / wheel.teeth, half_angle(wheel, wheel.root)
    wing = foot + (far - foot) * side
    angles = np.concatenate([-wing[::-1], foot * across, wing])
    rim = deep[:, None] * np.exp(1j * angles)
    top = high[:, None] * np.exp(1j * half_angle(wheel, high)[:, None] * across)
    numbers = np.arange(rim.size).reshape(rim.shape)
    above = np.vstack([numbers[-1:, 2 * n : 4 * n + 1], rim.size + np.arange(top.size).reshape(top.shape)])
    quads = [
        np.stack([a[:-1, :-1], a[1:, :-1], a[1:, 1:], a[:-1, 1:]]).reshape(4, -1) for a in (numbers, above)
    ]
    points = np.concatenate([rim.ravel(), top.ravel()])
    return skfem.MeshQuad(np.array([points.real, points.imag]), np.hstack(quads))


def compliance(wheel, n):
    """Give of the tooth's middle along the line of action, m^2/N, under a force there at the pitch circle.

    What its flank gives way about the force is left to the law of contact.
    """
    mesh = tooth(wheel, n)
    basis = skfem.Basis(mesh, skfem.ElementVector(skfem.ElementQuad2()))

    @skfem.BilinearForm
    def energy(u, v, _):
        strain, other = sym_grad(u), sym_grad(v)
        stress = E / (1.0 - NU**2) * ((1.0 - NU) * strain + NU * eye(trace(strain), 2))
        return (stress * other).sum(axis=(0, 1))

    # The line of action through the pitch point of the flank crosses the middle of the tooth.
    lean = np.exp(1j * half_angle(wheel, wheel.pitch))
    flank, corner = 1j * np.exp(-1j * wheel.pressure_angle) * lean, wheel.pitch * lean
    along = np.array([flank.real, flank.imag])
    middle = corner.real - corner.imag * along[0] / along[1]

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


def touch(pair, force):
    """Give of two steel flanks about their contact, m^2/N, under a force by width; pitch point.

    After Weber and Banaschek, *Formaenderung und Profilruecknahme* (1953).
    """
    one, other = (wheel.pitch * np.sin(wheel.pressure_angle) for wheel in pair.wheels)
    half = np.sqrt(8.0 * force * (1.0 - NU**2) / (np.pi * E) / (1.0 / one + 1.0 / other))
    middle = 0.5 * pair.wheels[0].thickness / np.cos(pair.pressure_angle)
    deep = 2.0 * np.log(2.0 * middle / half) - NU / (1.0 - NU)
    return 2.0 * (1.0 - NU**2) / (np.pi * E) * deep


def test_teeth_of_finite_elements_are_as_stiff_as_the_scene_says():
    pair = GearPair()
    coarse, fine = (1.0 / sum(compliance(wheel, n) for wheel in pair.wheels) for n in (3, 6))
    assert fine == pytest.approx(coarse, rel=0.01)
    assert pytest.approx(fine, rel=0.01) == ELEMENTS
    # ISO 6336-1, c'_th = 1/q of teeth that touch, for discs of standard teeth; some 300 N/mm.
    q = 1e-9 * (0.04723 + 0.15551 / pair.teeth[0] + 0.25791 / pair.teeth[1])
    assert 1.0 / fine + touch(pair, 3e5) == pytest.approx(q, rel=0.06)
