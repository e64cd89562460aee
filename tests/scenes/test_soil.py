"""Soil that pushes a mechanism back: momentum, work of both, weights on a tray, and runs that go on."""

import numpy as np
import pytest

from bench.soil.parts import Law, Motion, Plates
from bench.soil.pile import Pile
from bench.soil.soil import Soil
from protochain.mechanisms import Mechanism

EDGE, MASS = 0.02, 0.016
ROUNDING = 1e-14
"""Of momenta of 0.25 N s: some tens of eps."""


def still(n):
    return Motion(np.zeros((1, n, 3)), np.eye(3)[None, None].repeat(n, axis=1), np.zeros((1, n, 6)))


def ram():
    """A plate of half a kilogram that flies into four cubes, in free space."""
    plate = Plates(np.array([0]), np.zeros((1, 3)), np.eye(3)[None], np.array([[0.01, 0.03, 0.03]]))
    law = Law(1e5, 0.5, by="volume")
    pile = Pile(np.full(4, EDGE), np.full(4, MASS), law, np.zeros(3), plates=plate)
    places = [[0.0202, 0, 0], [0.0403, 0.004, 0], [0.0605, 0, 0], [0.0202, 0.021, 0.003]]
    m = Mechanism()
    m.body("ram", 0.5, inertia=1e-3, velocity=(0.5, 0, 0))
    m.add(Soil("soil", ["ram"], pile, pile.start(places, motion=still(1))))
    return m.build()


def struck(step, until=0.05):
    model = ram()
    run = model.simulate(until, step)
    (soil,) = model.memories
    return run, soil


def test_momentum_passes_from_a_ram_to_cubes_and_the_works_differ_less_in_shorter_steps():
    apart = []
    for step in (1e-3, 1e-4):
        run, soil = struck(step)
        heap, last = soil.heap, soil.looks[-1]
        assert last.work > 0.015 and np.all(last.pushes == 0.0)
        whole = run.momenta[-1, 0] + soil.pile.mass @ heap.velocity
        assert whole == pytest.approx([0.25, 0, 0], abs=ROUNDING)
        assert last.momentum == pytest.approx(soil.pile.mass @ heap.velocity, abs=ROUNDING)
        own = np.cross(heap.position, heap.velocity) + EDGE**2 / 6 * heap.spin
        spin = run.momenta[-1, 1] + MASS * own.sum(axis=0)
        # Arms of some centimetres, which move by the speed times two steps before an impulse comes.
        assert spin == pytest.approx(np.zeros(3), abs=0.5 * 0.02 * step)
        apart.append(abs(run.work[-1, 0] + last.work) / last.work)
    assert apart[0] < 0.1 and apart[1] < 0.1 * apart[0]


def test_a_tray_carries_what_lies_on_it_and_its_hinge_is_told():
    """The tray's axes are not those of the tree, whose z axis is the hinge's."""
    plate = Plates(np.array([1]), np.array([[0.2, 0, -0.01]]), np.eye(3)[None], np.array([[0.2, 0.05, 0.01]]))
    pile = Pile(np.full(1, EDGE), np.full(1, MASS), Law(1e4, 0.5), np.array([0, 0, -9.81]), plates=plate)
    m = Mechanism(gravity=(0, 0, -9.81))
    m.body("tray", 1.0, com=(0.2, 0, 0), inertia=0.01)
    m.hinge("pin", "world", "tray", at=(0, 0, 0.5), axis=(0, 1, 0))
    m.drive("pin", lambda t: (0.0, 0.0, 0.0))
    motion = still(2)
    motion.origin[0, 1] = [0, 0, 0.5]
    heap = pile.start([[0.3, 0, 0.51]], motion=motion)
    m.add(Soil("soil", ["world", "tray"], pile, heap))
    run = m.build().simulate(0.3, 1e-3, every=100)
    # Weights push down on the side of x, which is the way in which the hinge turns.
    assert run.motion["pin drive"].iloc[-1] == pytest.approx(-9.81 * (0.2 + MASS * 0.3), rel=1e-6)
    assert run.reactions("pin")["force z"].iloc[-1] == pytest.approx(9.81 * (1.0 + MASS), rel=1e-6)
    assert run.motion["pin drive"].iloc[0] == pytest.approx(-9.81 * 0.2, rel=1e-12)
