"""The guide's mechanisms, as they are in its page, against other programs; none takes more than 25 lines."""

import sys

import numpy as np
import pytest
from fixtures.samples import ROOT

sys.path.insert(0, str(ROOT / "analysis" / "benchmarks"))

guide = pytest.importorskip("guide", reason="MuJoCo comes with the test extra")

BOUNDS = {
    "double pendulum": 1e-4, "four-bar": 1e-7, "ball with spin": 5e-3, "platform": 1e-6, "slider-crank": 1e-6,
    "Geneva drive": 1e-8, "quarter car": 1e-5, "gyroscope": 1e-6, "PD arm": 1e-8,
}  # fmt: skip
"""Relative. The pendulum's motor has kinks, the ball's friction gives way, MuJoCo's loops do a little."""


def test_what_the_guide_builds_moves_as_other_programs_say():
    seen = {}
    for name, _, found, exact, _ in guide.measured(quick=True):
        seen[name] = float(np.max(np.abs(found - exact)) / np.max(np.abs(exact)))
    assert seen.keys() == BOUNDS.keys()
    assert all(seen[name] < bound for name, bound in BOUNDS.items()), seen
    assert all(len([line for line in code.splitlines() if line]) <= 25 for code in guide.blocks().values())
