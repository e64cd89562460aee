"""Piles of cubes against textbooks: slopes, weights, impacts, turntables; and against themselves."""

import numpy as np
import pytest
from fixtures.refusals import expect_refusal
from scipy.spatial.transform import Rotation

from bench.soil.parts import Heap, Law, Motion, Plates, Sleep
from bench.soil.pile import Pile
from protochain.core.errors import Fault, MechanicsError
from protochain.mechanics.motion.system import StepTooLargeError

EDGE, MASS, STIFFNESS, GRAVITY = 0.02, 0.016, 1e5, 9.81
GROUND = {"normal": np.array([[0.0, 0.0, 1.0]]), "offset": np.zeros(1)}
SETTLED = 1e-9
"""Relative, of what oscillates with 80 radians and a damping ratio of 0.2, some 400 radians later."""


SOIL = Law(STIFFNESS, 0.5)


def pile(n: int = 1, law: Law = SOIL, gravity=(0, 0, -GRAVITY), **more) -> Pile:
    return Pile(np.full(n, EDGE), np.full(n, MASS), law, np.array(gravity), **more)


def tilted(angle: float) -> np.ndarray:
    return GRAVITY * np.array([np.sin(angle), 0.0, -np.cos(angle)])


def floor(half=(0.2, 0.2, 0.01)) -> Plates:
    """A plate whose top is the plane z = 0, on body 0."""
    return Plates(np.zeros(1, int), np.array([[0.0, 0.0, -half[2]]]), np.eye(3)[None], np.array([half]))


def frames(origin, rotation=None, twist=None) -> Motion:
    s = len(origin)
    turned = np.broadcast_to(np.eye(3), (s, 3, 3)) if rotation is None else rotation
    moved = np.zeros((s, 6)) if twist is None else twist
    return Motion(np.asarray(origin)[:, None], turned[:, None].copy(), moved[:, None].copy())


def resting(steps: int) -> Motion:
    return frames(np.zeros((steps + 1, 3)))


@pytest.mark.parametrize("on", ["plane", "plate"])
@pytest.mark.parametrize("degrees", [20.0, 30.0, 60.0])
def test_on_a_slope_it_rests_or_slides_as_friction_lets_it(on, degrees):
    angle = np.deg2rad(degrees)
    more = GROUND if on == "plane" else {"plates": floor()}
    scene = pile(gravity=tilted(angle), **more)
    h, steps = scene.longest_step, 2000
    motion = resting(steps) if on == "plate" else None
    first = scene.start([[-0.1, 0.0, 0.5 * EDGE]], motion=motion)
    early, _ = scene.advance(first, steps, h, motion)
    late, _ = scene.advance(early, steps, h, motion)
    wanted = GRAVITY * (np.sin(angle) - 0.5 * np.cos(angle))
    if wanted < 0.0:
        # The tangential spring carries it, and so does the turn that its couple asks of the ground.
        assert np.abs(late.velocity).max() < SETTLED
        assert np.abs(late.position - early.position).max() < SETTLED * EDGE
    else:
        found = (late.velocity - early.velocity)[0] / (steps * h)
        assert found == pytest.approx([wanted, 0.0, 0.0], abs=1e-6 * GRAVITY)


def test_two_cubes_keep_momentum_and_spin_in_an_impact():
    scene = pile(2, gravity=(0, 0, 0))
    rotation = Rotation.from_euler("xyz", [[0.3, 0.5, 0.7], [1.0, -0.4, 0.2]]).as_matrix()
    start = scene.start(
        [[0, 0, 0], [0.04, 0.005, -0.003]],
        rotation,
        [[1.0, 0.0, 0.0], [-1.0, 0.2, 0.0]],
        [[0, 5, 0], [0, 0, 9]],
    )
    heap, _ = scene.advance(start, 600, scene.longest_step)

    def spin(h: Heap) -> np.ndarray:
        return np.sum(MASS * np.cross(h.position, h.velocity) + MASS * EDGE**2 / 6.0 * h.spin, axis=0)

    assert np.linalg.norm(heap.velocity - start.velocity) > 0.5 and heap.dissipated > 0.0
    assert np.sum(heap.velocity, axis=0) == pytest.approx(np.sum(start.velocity, axis=0), abs=1e-12)
    assert spin(heap) == pytest.approx(spin(start), abs=1e-12 * MASS)
    assert scene.total(heap) == pytest.approx(scene.total(start), rel=0.02)


def test_a_lift_does_work_that_is_found_again():
    scene, steps, rise = pile(plates=floor()), 8000, 0.05
    t = np.linspace(0.0, 1.0, steps + 1)
    duration = steps * scene.longest_step
    z, speed = rise * (3 * t**2 - 2 * t**3), rise * 6 * t * (1 - t) / duration
    twist = np.zeros((steps + 1, 6))
    twist[:, 5] = speed
    motion = frames(np.column_stack([0 * z, 0 * z, z]), twist=twist)
    settled, _ = scene.advance(
        scene.start([[0.0, 0.0, 0.5 * EDGE - MASS * GRAVITY / STIFFNESS]], motion=resting(0)), steps,
        scene.longest_step, resting(steps),
    )  # fmt: skip
    heap, reaction = scene.advance(settled, steps, scene.longest_step, motion)
    assert heap.work - settled.work == pytest.approx(MASS * GRAVITY * rise, rel=1e-4)
    assert heap.work == pytest.approx(-np.sum(reaction[:, 0, 5] * speed[1:]) * scene.longest_step, rel=1e-9)
    assert scene.total(heap) == pytest.approx(scene.total(settled), abs=1e-4 * MASS * GRAVITY * rise)


def test_it_goes_on_as_if_it_had_not_stopped():
    scene = pile(2, plates=floor())
    start = scene.start([[0, 0, 0.02], [0.004, 0.003, 0.045]], motion=resting(0))
    whole, _ = scene.advance(start, 3000, scene.longest_step, resting(3000))
    half, _ = scene.advance(start, 1234, scene.longest_step, resting(1234))
    again, _ = scene.advance(half, 1766, scene.longest_step, resting(1766))
    for name in ("position", "quaternion", "velocity", "spin", "acceleration"):
        assert np.array_equal(getattr(whole, name), getattr(again, name)), name
    assert not np.array_equal(whole.position, half.position)


def test_cubes_fall_asleep_lie_still_and_wake():
    sleep = Sleep.under(GRAVITY, EDGE)
    scene = pile(3, sleep=sleep, **GROUND)
    stack = [[0.0, 0.0, (k + 0.5) * EDGE] for k in range(3)]
    asleep, _ = scene.advance(scene.start(stack), 6000, scene.longest_step)
    assert asleep.asleep.all()
    later, _ = scene.advance(asleep, 2000, scene.longest_step)
    assert np.array_equal(later.position, asleep.position)
    awake, _ = pile(3, **GROUND).advance(pile(3, **GROUND).start(stack), 8000, scene.longest_step)
    assert awake.position == pytest.approx(later.position, abs=1e-6)
    # A fourth one falls upon them: a pile of its own, with the three as they lie.
    more = pile(4, sleep=sleep, **GROUND)
    settled, _ = more.advance(more.start([*stack, [0.3, 0.0, 0.5 * EDGE]]), 6000, more.longest_step)
    assert settled.asleep.all()
    hit = more.start([*settled.position[:3], [0.002, 0.0, 0.1]], velocity=[[0, 0, 0]] * 3 + [[0, 0, -1.0]])
    after, _ = more.advance(hit, 1500, more.longest_step)
    assert not after.asleep[:3].any()


def test_what_cannot_be_is_refused_in_one_line():
    for wrong in ({"stiffness": 0.0}, {"friction": -0.1}, {"damping": np.nan}):
        with pytest.raises(MechanicsError, match=next(iter(wrong))):
            Law(**{"stiffness": 1e5, "friction": 0.5} | wrong)
    with pytest.raises(MechanicsError, match="cube 1: its mass 0"):
        Pile([EDGE, EDGE], [MASS, 0.0], Law(1e5, 0.5), np.zeros(3))
    with pytest.raises(MechanicsError, match="plane 0: its normal"):
        pile(normal=np.array([[0, 0, 2.0]]), offset=np.zeros(1))
    with expect_refusal(fault=Fault.OVERLAP, kind=MechanicsError, match="cube 1"):
        pile(2).start([[0, 0, 0], [0.003, 0, 0]])
    with pytest.raises(MechanicsError, match="give their motion"):
        pile(plates=floor()).start([[0, 0, 1]])
    scene = pile()
    with expect_refusal(fault=Fault.STEP, kind=StepTooLargeError, match="step 1"):
        scene.advance(scene.start([[0, 0, 1]]), 1, 1.0)
    with expect_refusal(fault=Fault.STEP, kind=StepTooLargeError, match="cube 0"):
        scene.advance(scene.start([[0, 0, 1]], velocity=[[1e6, 0, 0]]), 1, scene.longest_step)
