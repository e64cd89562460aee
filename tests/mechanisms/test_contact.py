"""Contact: laws against their closed forms, forces against energies, motions known beforehand."""

import numpy as np
import pytest
from fixtures.tolerances import ROUND_OFF
from scipy.optimize import approx_fprime, minimize

from protochain.core.errors import MechanicsError
from protochain.mechanics import multibody
from protochain.mechanics.motion import DormandPrince, RungeKutta4, StepTooLargeError
from protochain.mechanisms import Mechanism
from protochain.mechanisms.contact import Friction, Law, flores, lankarani_nikravesh, real_restitution
from protochain.mechanisms.contact_forces import Anchors
from protochain.mechanisms.shapes import Ball, Plane, Surface, Touches, _normals_between
from protochain.mechanisms.triangles import nearest

G = 9.81
IMPACT = 1e-5
"""Of a velocity after an impact, whose force begins with a kink, at a tolerance of 1e-10."""


def dropped(law, velocity=-1.0, mass=1.0, height=0.0, gravity=0.0, radius=0.1):
    """A ball just above the floor."""
    m = Mechanism((0.0, 0.0, -gravity))
    m.body(
        "ball",
        mass,
        inertia=0.4 * mass * radius**2,
        position=(0, 0, radius + height),
        velocity=(0, 0, velocity),
    )
    m.contact("floor", [Ball("ball", radius)], Plane(), law)
    return m.build()


@pytest.mark.parametrize(
    ("stiffness", "exponent", "mass", "speed"), [(1e6, 1.5, 1.0, 1.0), (2e3, 1.0, 0.3, 4.0)]
)
@pytest.mark.parametrize(
    ("make", "value"),
    [(lankarani_nikravesh, 0.7252), (flores, 0.4704)],
    ids=["Lankarani-Nikravesh", "Flores"],
)
def test_the_real_restitution_is_that_of_the_equation_whatever_stiffness_and_exponent(
    make, value, stiffness, exponent, mass, speed
):
    law = make(stiffness, 0.5, speed, exponent)
    model = dropped(law, -speed, mass)
    # Longer than the contact of any of them.
    longest = 6.0 * (mass / stiffness) ** (1 / (exponent + 1)) * speed ** ((1 - exponent) / (exponent + 1))
    run = model.simulate(longest, longest / 40, DormandPrince(1e-10))
    assert run.qd[-1, 5] / speed == pytest.approx(real_restitution(law.damping * speed), abs=IMPACT)
    assert real_restitution(law.damping * speed) == pytest.approx(value, abs=5e-5)


def test_real_restitution_at_its_ends_and_between():
    losses = np.array([0.0, 1e-9, 0.99e-5, 1.01e-5, 1e-3, 1.0, 30.0, 35.0, 1e6])
    found = np.array([real_restitution(c) for c in losses])
    assert found[0] == 1.0
    assert np.all(np.diff(found) < 0.0)
    assert found[-1] * 1e6 == pytest.approx(1.0, abs=1e-12)
    assert found[2] - found[3] == pytest.approx(2.0 / 3.0 * 2e-7, rel=1e-3)
    for c, r in zip(losses[4:6], found[4:6], strict=True):
        assert c - np.log(1.0 + c) == pytest.approx(-c * r - np.log(1.0 - c * r), rel=1e-9)
    with pytest.raises(MechanicsError, match="the loss -1 "):
        real_restitution(-1.0)


def test_the_floor_carries_the_weight_and_the_energy_is_that_of_the_law():
    """At rest at the depth where K d^n = m g."""
    for exponent in (1.0, 1.5, 2.0):
        depth = (2.0 * G / 5e4) ** (1.0 / exponent)
        model = dropped(Law(5e4, exponent), 0.0, 2.0, -depth, G)
        at = model.start()
        assert np.abs(at.torque).max() < 1e-9
        assert at.potential == pytest.approx(
            2.0 * G * (0.1 - depth) + 5e4 * depth ** (exponent + 1.0) / (exponent + 1.0), rel=1e-12
        )


def test_contacts_never_pull():
    law = Law(1e5, 1.5, 0.5)
    for velocity, factor in ((1.0, 0.5), (1.99, 0.005), (3.0, 0.0), (-2.0, 2.0)):
        at = dropped(law, velocity, height=-0.01).start()
        assert at.torque[5] == pytest.approx(1e5 * 0.01**1.5 * factor, abs=1e-9)


def block(angle, friction, law):
    """A block on a slope: gravity is turned, x points down the slope."""
    m = Mechanism((G * np.sin(angle), 0.0, -G * np.cos(angle)))
    depth = 2.0 * G * np.cos(angle) / 4.0 / law.stiffness
    m.body("block", 2.0, inertia=(0.01, 0.01, 0.01), position=(0, 0, 0.05 - depth))
    corners = [Ball("block", 0.0, (x, y, -0.05)) for x in (-0.1, 0.1) for y in (-0.1, 0.1)]
    m.contact("slope", corners, Plane(), law, friction)
    return m.build()


@pytest.mark.parametrize(("degrees", "mu"), [(20.0, 0.5), (35.0, 0.5), (35.0, 0.0), (35.0, 10.0)])
def test_a_block_on_a_slope_stays_or_slides_as_friction_says(degrees, mu):
    angle = np.radians(degrees)
    run = block(angle, Friction(mu, 1e5, 400.0), Law(1e5, 1.0, 10.0)).simulate(0.6, 4e-4, every=20)
    late = run.time > 0.35
    gained = np.polyfit(run.time[late], run.qd[late, 3], 1)[0]
    assert gained == pytest.approx(max(0.0, G * (np.sin(angle) - mu * np.cos(angle))), abs=1e-5 * G)
    if mu == 0.5 > np.tan(angle):
        # Held by the springs at four corners, and tilted, since they hold it below.
        pull = 2.0 * G * np.sin(angle)
        moved = pull / 4e5 + 0.05 * pull * 0.05 / (4e5 * 0.1**2)
        assert run.q[-1, 4] == pytest.approx(moved, rel=0.1)
    assert run.audit().energy < 1e-3
    assert run.dissipation[-1] > 1e-5 or mu == 0.0


def rolling(other, law=None, friction=None, radius=0.1, start=(0.0, 0.0)):
    angle = np.radians(20.0)
    m = Mechanism((G * np.sin(angle), 0.0, -G * np.cos(angle)))
    depth = 1.5 * G * np.cos(angle) / 1e5
    m.body("ball", 1.5, inertia=0.4 * 1.5 * radius**2, position=(*start, radius - depth))
    law, friction = law or Law(1e5, 1.0, 5.0), friction or Friction(0.5, 2e4, 50.0)
    m.contact("slope", [Ball("ball", radius)], other, law, friction)
    return m.build()


def net(rng, n=9, size=0.35):
    """A flat surface of triangles of all shapes and both orders of corners."""
    place = np.linspace(-0.3, n * size - 0.3, n + 1)
    x, y = np.meshgrid(place, place - 1.0, indexing="ij")
    move = rng.uniform(-0.3, 0.3, (2, n + 1, n + 1)) * size
    vertices = np.column_stack([(x + move[0]).ravel(), (y + move[1]).ravel(), np.zeros(x.size)])
    faces = []
    for i in range(n):
        for j in range(n):
            a, b, c, d = (p * (n + 1) + q for p, q in ((i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)))
            faces += [(a, b, c), (a, d, c)] if (i + j) % 2 else [(a, b, d), (d, c, b)]
    return vertices, np.array(faces)


def test_a_ball_rolls_over_triangles_as_over_the_plane_that_they_make():
    """Neither edges nor corners push it, and its friction goes from one triangle to the next."""
    vertices, faces = net(np.random.default_rng(2))
    flat = rolling(Plane(), start=(0.013, 0.021)).simulate(0.45, 1e-3, every=10)
    tiled = rolling(Surface("world", vertices, faces), start=(0.013, 0.021)).simulate(0.45, 1e-3, every=10)
    assert flat.q[-1, 4] > 0.2
    assert np.abs(tiled.q - flat.q).max() < 1e-10


def test_the_nearest_point_of_a_triangle_is_that_of_a_search():
    rng = np.random.default_rng(6)
    inside = 0
    for _ in range(60):
        corners, p = rng.normal(size=(1, 3, 3)), rng.normal(size=3)
        point, within = nearest(tuple(p), corners, 0)
        inside += within
        a, b, c = corners[0]

        def square(w, a=a, b=b, c=c, p=p):
            return float(np.sum((a + w[0] * (b - a) + w[1] * (c - a) - p) ** 2))

        best = min(
            minimize(
                square, start, method="SLSQP", bounds=[(0, 1)] * 2, options={"ftol": 1e-14},
                constraints={"type": "ineq", "fun": lambda w: 1.0 - w.sum()},
            ).fun
            for start in ([0.2, 0.2], [0.7, 0.1], [0.1, 0.7])
        )  # fmt: skip
        assert float(np.sum((np.array(point) - p) ** 2)) == pytest.approx(best, abs=1e-6)
    assert 5 < inside < 55


def test_a_ball_touches_an_edge_once_and_a_corner_of_a_room_three_times():
    roof = Surface("world", [(0, 0, 0), (1, 0, 0), (0, 1, -1), (1, 1, -1), (0, -1, -1), (1, -1, -1)],
                   [(0, 1, 3), (0, 3, 2), (0, 1, 5), (0, 5, 4)])  # fmt: skip
    m = Mechanism()
    m.body("ball", 1.0, inertia=0.01, position=(0.4, 0.02, 0.09))
    m.contact("roof", [Ball("ball", 0.1)], roof, Law(1e3, 1.0))
    at = m.build().start()
    apart = np.hypot(0.02, 0.09)
    assert np.allclose(at.torque[3:], 1e3 * (0.1 - apart) * np.array([0.0, 0.02, 0.09]) / apart, atol=1e-9)

    square = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], dtype=float)
    vertices = np.concatenate([square, square[:, [1, 2, 0]], square[:, [2, 0, 1]]])
    faces = [(a, a + 1 + k, a + 2 + k) for a in (0, 4, 8) for k in (0, 1)]
    m = Mechanism()
    m.body("ball", 1.0, inertia=0.01, position=(0.09, 0.08, 0.07))
    m.contact("room", [Ball("ball", 0.1)], Surface("world", vertices, faces), Law(1e3, 1.0))
    assert np.allclose(m.build().start().torque, [0, 0, 0, 10.0, 20.0, 30.0], atol=1e-9)


def test_a_rib_on_the_other_side_of_a_plate_is_not_felt():
    """Its foot is in the plate, where a ball from below has its nearest point of both."""
    plate = [(-1, -1, 0), (2, -1, 0), (0, 3, 0)]
    for faces in ([(0, 1, 2)], [(0, 1, 2), (3, 4, 5)], [(3, 4, 5), (0, 1, 2)]):
        m = Mechanism()
        m.body("ball", 1.0, inertia=0.01, position=(0.3, 0.0, -0.08))
        vertices = [*plate, (0, 0, 0), (1, 0, 0), (0.5, 0, 1)]
        m.contact("plate", [Ball("ball", 0.1)], Surface("world", vertices, faces), Law(1e3, 1.0))
        assert np.allclose(m.build().start().torque[3:], [0.0, 0.0, -20.0], atol=1e-9)


def cluttered(law, friction=None):
    """Balls on moving bodies, some of them hinged, against each other and another's plane and surface."""
    rng = np.random.default_rng(8)
    m = Mechanism()
    m.body("table", 5.0, (0.1, 0, -0.1), (0.3, 0.4, 0.5), velocity=(0, 0.1, 0), spin=(0.2, -0.1, 0.3))
    m.body("arm", 1.0, (0.2, 0, 0), (0.01, 0.02, 0.02))
    m.hinge("elbow", parent="table", child="arm", at=(0, 0, 0.25), axis=(0, 1, 0.3), q=0.3, qd=0.5)
    for k in range(4):
        m.body(
            f"ball {k}",
            0.5,
            inertia=0.002,
            position=(0.14 * k - 0.2, 0.02 * k, 0.09),
            velocity=rng.normal(size=3),
        )
    balls = [Ball(f"ball {k}", 0.1, 0.01 * rng.normal(size=3)) for k in range(4)]
    top = Plane("table", (0, 0, 0.01), (0.1, 0, 1))
    m.contact("top", [*balls[:2], Ball("arm", 0.3, (0.1, 0.3, 0.0))], top, law, friction)
    vertices, faces = net(rng, 4, 0.3)
    m.contact("net", balls[2:], Surface("table", vertices + np.array([0, 0.5, 0.005]), faces), law, friction)
    m.contact("each other", [*balls, Ball("arm", 0.21, (0.1, 0.0, 0.0))], None, law, friction)
    return m.build()


def test_elastic_forces_are_minus_the_gradient_of_their_energy():
    model = cluttered(Law(3e3, 1.5))
    at = model.start()
    touching = [part.touches(at.factors.frames) for part in model.conservative]
    assert [len(each.pair) for each in touching] == [3, 2, 6]

    def energy(move):
        return model.system.at(multibody.integrate(model.tree, at.q, move), at.qd).potential

    gradient = approx_fprime(np.zeros(model.tree.n_v), energy, 1e-7)
    assert np.abs(gradient + at.torque).max() < 1e-4 * np.abs(at.torque).max()


def test_a_run_that_goes_on_keeps_its_anchors_and_another_forgets_them():
    model = block(np.radians(20.0), Friction(0.5, 1e5, 400.0), Law(1e5, 1.0, 10.0))
    step = 2.0**-10
    whole = model.simulate(100 * step, step)
    half = model.simulate(50 * step, step)
    rest = model.simulate(100 * step, step, start=half.end)
    assert np.array_equal(rest.q[-1], whole.q[-1])
    assert np.array_equal(model.simulate(100 * step, step).q, whole.q)
    assert np.array_equal(model.start().torque, half.model.system.at(model.q, model.qd).torque)


def test_friction_pulls_at_anchors_that_are_dragged_as_its_law_says():
    """Each contact of moving bodies by itself, in the axes of the world, after a step that slides them."""
    model = cluttered(Law(3e3, 1.5, 0.3), Friction(0.4, 2e3, 3.0))
    system, at, slid = model.system, model.start(), []
    there = system.at(multibody.integrate(model.tree, at.q, 0.004 * at.qd), 1.5 * at.qd)
    frames, twists = there.factors.frames, multibody.velocities(model.tree, there.factors.frames, there.qd)

    def world(b, arm):
        return frames.rotation[b] @ arm + frames.origin[b]

    def velocity(b, place):
        return twists[b, 3:] + np.cross(twists[b, :3], place - frames.origin[b])

    for part in model.conservative:
        part.settle(at)
        anchors = {tuple(pair): arms for pair, arms in zip(part.anchors.pair, part.anchors.arms, strict=True)}
        touches, wrenches = part.touches(frames), np.zeros((model.tree.n_bodies, 6))
        found, applied = part.stretches(frames, touches), part.resist(0.0, there.q, there.qd, frames).wrenches
        part.settle(there)
        for k, (pair, (a, b), place, out, depth) in enumerate(zip(*touches, strict=True)):
            arms = anchors[tuple(pair)]
            stretch = world(a, arms[:3]) - world(b, arms[3:])
            stretch -= out * (out @ stretch)
            assert found[k] == pytest.approx(stretch, abs=1e-12)
            moving = velocity(a, place) - velocity(b, place)
            pressed = max(0.0, 3e3 * depth**1.5 * (1.0 - 0.3 * (out @ moving)))
            wanted = -2e3 * stretch - 3.0 * (moving - out * (out @ moving))
            shares = [min(1.0, 0.4 * pressed / np.linalg.norm(each)) for each in (wanted, 2e3 * stretch)]
            force = (pressed - 3e3 * depth**1.5) * out + shares[0] * wanted
            for body, its in ((a, force), (b, -force)):
                wrenches[body] += np.append(np.cross(place - frames.origin[body], its), its)
            ends = part.anchors.arms[k]
            assert world(a, ends[:3]) == pytest.approx(place, abs=1e-12)
            assert world(b, ends[3:]) == pytest.approx(place - shares[1] * stretch, abs=1e-12)
            slid.append(shares[1] < 1.0)
        assert np.abs(applied - wrenches).max() < 1e-10 * np.abs(wrenches).max()
    assert 2 < sum(slid) < len(slid) - 2


@pytest.mark.parametrize(
    ("anchored", "touches", "expected"),
    [
        ([(0, 5)], [(0, 5)], [0]),
        ([(0, 5)], [(0, 1)], [0]),
        ([(0, 5)], [(0, 1), (0, 2)], [None, None]),
        ([(0, 5)], [(0, 5), (0, 6)], [0, None]),
        ([(0, 5), (0, 6)], [(0, 1)], [None]),
        ([(0, 5), (1, 7)], [(1, 2), (2, 2)], [1, None]),
    ],
)
def test_an_anchor_goes_along_to_one_other_triangle_and_never_to_two(anchored, touches, expected):
    model = rolling(Plane())
    *_, pressing = model.conservative
    n, m = len(touches), len(anchored)
    pressing.anchors = Anchors(np.array(anchored), np.column_stack([np.arange(1.0, m + 1), np.zeros((m, 5))]))
    up = np.tile([0.0, 0.0, 1.0], (n, 1))
    ends = np.tile([0, -1], (n, 1))
    found = Touches(np.array(touches), ends, np.zeros((n, 3)), up, np.ones(n))
    stretch = pressing.stretches(model.start().factors.frames, found)[:, 0]
    assert stretch.tolist() == [0.0 if k is None else k + 1.0 for k in expected]


def test_two_balls_touch_in_the_middle_of_their_overlap():
    centre, radius = np.array([[0.1, 0.2, 0.3], [0.4, -0.2, 0.5]]), np.array([0.4, 0.25])
    for i, j in ((0, 1), (1, 0)):
        pair, ends, place, out, depth = _normals_between(
            np.array([[i, j]]), centre, np.array([3, 7]), radius, 0
        )
        up = (centre[i] - centre[j]) / np.linalg.norm(centre[i] - centre[j])
        surfaces = centre[i] - radius[i] * up, centre[j] + radius[j] * up
        assert place[0] == pytest.approx(np.mean(surfaces, axis=0), abs=ROUND_OFF)
        assert depth[0] == pytest.approx((surfaces[1] - surfaces[0]) @ up, abs=ROUND_OFF)
        assert out[0] == pytest.approx(up, abs=ROUND_OFF)
        assert (pair.tolist(), ends.tolist()) == ([[i, j]], [[3 + 4 * i, 3 + 4 * j]])


def test_two_groups_touch_across_only():
    m = Mechanism()
    for k in range(4):
        m.body(f"ball {k}", 1.0, inertia=0.1, position=(0.3 * k, 0, 0))
    one, other = ([Ball(f"ball {k}", 0.2) for k in group] for group in ((0, 1), (2, 3)))
    m.contact("groups", one, other, Law(1.0))
    model = m.build()
    (part,) = model.conservative
    assert part.touches(model.start().factors.frames).pair.tolist() == [[1, 2]]


def test_what_is_too_deep_is_refused_by_name():
    m = Mechanism()
    for k, velocity in enumerate((50.0, 0.0)):
        m.body(f"ball {k}", 1.0, inertia=0.1, position=(0.21 * k, 0, 0), velocity=(velocity, 0, 0))
    m.contact("soft", [Ball("ball 0", 0.1), Ball("ball 1", 0.1)], None, Law(10.0))
    with pytest.raises(MechanicsError, match=r'contact "soft": ball 0 is .* deep.*raise the stiffness'):
        m.build().simulate(0.01, 1e-4)
    # A half-space has no other side.
    run = dropped(Law(100.0), -5.0).simulate(0.5, 1e-3)
    assert run.q[:, 6].min() < -0.2
    assert run.qd[-1, 5] > 0.0


def test_what_has_diverged_is_said_to_and_blames_no_hinge():
    tree = dropped(Law(1.0)).tree
    nowhere = np.full(tree.n_q, np.nan)
    for call in (
        lambda: multibody.forward_dynamics(tree, nowhere, np.zeros(tree.n_v), np.zeros(tree.n_v)),
        lambda: multibody.solve_mass(tree, multibody.pose(tree, nowhere), np.zeros(tree.n_v)),
    ):
        with pytest.raises(MechanicsError, match=r"body 0: its position is not finite.*diverged"):
            call()


SQUARE = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (2, 2, 0)]


@pytest.mark.parametrize(
    ("balls", "other", "words"),
    [
        ([Ball("bowl", 0.1)], Plane(), 'contact "c": there is no body "bowl"'),
        ([], Plane(), "at least one ball"),
        ([Ball("ball", 0.1)], Plane("ball"), "ball 0 belongs to the body"),
        ([Ball("ball", 0.1)], Plane(normal=(0, 0, 0)), "has no direction"),
        ([Ball("ball", 0.0)], Surface("world", SQUARE, [(0, 1, 2)]), "give it a radius"),
        ([Ball("ball", 0.1)], Surface("world", SQUARE, [(0, 1, 2), (0, 1, 4)]), "triangle 1 has a corner"),
        ([Ball("ball", 0.1)], Surface("world", SQUARE, [(3, 2, 0)]), "triangle 0 has no area"),
        ([Ball("ball", 0.1)], Surface("world", SQUARE, [(0.0, 1.0, 2.0)]), "faces integers"),
    ],
)  # fmt: skip
def test_what_cannot_touch_is_refused_by_the_name_of_the_contact(balls, other, words):
    m = Mechanism()
    m.body("ball", 1.0, inertia=0.1)
    m.contact("c", balls, other, Law(1.0))
    with pytest.raises(MechanicsError, match=words):
        m.build()


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Law(0.0), "stiffness 0"), (lambda: Law(1.0, 0.5), "exponent 0.5"),
        (lambda: Law(1.0, damping=-1.0), "damping -1"), (lambda: flores(1.0, 0.0, 1.0), "no end at 0"),
        (lambda: Friction(-0.1, 1.0), "coefficient of friction"),
        (lambda: lankarani_nikravesh(1.0, 1.1, 1.0), "0 to 1"),
        (lambda: lankarani_nikravesh(1.0, 0.5, 0.0), "speed 0 of approach"),
    ],
)  # fmt: skip
def test_laws_that_would_gain_energy_or_divide_by_zero_are_refused(make, words):
    with pytest.raises(MechanicsError, match=words):
        make()


def flying(velocity, other, at=(0.01, 0.02, 1.0)):
    m = Mechanism()
    m.body("ball", 1.0, inertia=1e-3, position=at, velocity=(0, 0, -velocity))
    if isinstance(other, list):
        m.body("b", 1.0, inertia=1e-3)
    m.contact("c", [Ball("ball", 0.05)], other, Law(1e8))
    return m.build()


@pytest.mark.parametrize("integrator", [DormandPrince(1e-8), RungeKutta4()])
def test_no_ball_passes_through_a_surface_whatever_the_step(integrator):
    """Steps of five radii, from twelve heights: it bounces, or the step is refused."""
    corners = [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)]
    wall, bounced, refused = Surface("world", corners, [(0, 1, 2), (0, 2, 3)]), 0, 0
    for height in np.linspace(1.0, 1.25, 12):
        try:
            end = flying(5.0, wall, (0.01, 0.02, height)).simulate(0.5, 0.05, integrator).end
        except (MechanicsError, StepTooLargeError):
            refused += 1
        else:
            assert end.q[6] > 0.0
            bounced += 1
    assert refused > 0 and bounced + refused == 12
    assert bounced > 0 or isinstance(integrator, RungeKutta4)


def test_no_ball_passes_through_another_within_a_step():
    with pytest.raises(MechanicsError, match=r'contact "c": ball 0 passes through .* use shorter steps'):
        flying(50.0, [Ball("b", 0.05)], (0, 0, 0.7)).simulate(0.1, 0.04, RungeKutta4())
