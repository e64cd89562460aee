"""Scenes: their parts, the command, and that commands for proteins load none of them."""

import numpy as np
import pandas as pd
import pytest

from protochain.errors import MechanicsError
from protochain.scenes import Check, Extreme, LeftOut, Scene
from protochain.scenes.scene import check, exponent, extreme, left_out, timed, work_table


def some(checks=(), extremes=(), left=()):
    work = work_table([("a", "h", 0.1, 1e-3), ("a", "h/2", 0.2, 1e-4)])
    return Scene("some", "a scene", checks, work, extremes, left, {"trace": pd.DataFrame({"t": [0.0, 1.0]})})


def test_a_check_says_how_far_off_it_is_and_nan_is_wrong():
    assert check("k", 2.02, 2.0, 0.011, "by hand").error == pytest.approx(0.01)
    assert check("k", 2.02, 2.0, 0.011, "by hand", "absolute").error == pytest.approx(0.02)
    assert check("k", -2.0, 2.0, 1.9, "a sign").error == 2.0
    verdicts = {value: check("k", value, 1.0, 0.1, "").right for value in (0.89, 0.91, 1.09, 1.11, np.inf)}
    assert verdicts == {0.89: False, 0.91: True, 1.09: True, 1.11: False, np.inf: False}
    assert not check("k", np.nan, 1.0, np.inf, "").right
    assert check("none", 0.0, 0.0, 0.0, "").right and not check("some", 1e-300, 0.0, 1.0, "").right


def test_an_extreme_is_right_refused_in_the_words_expected_or_wrong():
    def refuses(text):
        def call():
            raise MechanicsError(text)

        return call

    def of(value):
        return lambda: check("k", value, 1.0, 0.1, "one")

    assert extreme("e", of(1.05)) == Extreme("e", "right", "relative error 0.05, bound 0.1: one")
    assert extreme("e", of(1.2)).outcome == "wrong"
    assert extreme("e", lambda: of(np.float64(1.0) / np.zeros(1)[0])()).outcome == "wrong"
    assert extreme("e", refuses("the step is too long"), "too long") == Extreme(
        "e", "refused", "the step is too long"
    )
    assert extreme("e", refuses("the step is too long")).outcome == "wrong"
    assert extreme("e", refuses("the step is too long"), "no inertia").outcome == "wrong"
    assert extreme("e", refuses("too long\nreally"), "too long").outcome == "wrong"
    assert extreme("e", of(1.0), "too long").outcome == "wrong"
    broken = extreme("e", lambda: {}["k"], "too long")
    assert broken.outcome == "wrong" and broken.detail == "KeyError: 'k'"


def test_what_is_left_out_must_leave_the_answer():
    def slow():
        for _ in range(50):
            np.linalg.eigvalsh(np.eye(30))
        return np.array([1.0, 2.0])

    found = left_out("the rest", slow, lambda: np.array([1.0, 2.0 + 1e-6]), 1e-6, repeats=2)
    assert found.right and found.difference == pytest.approx(5e-7, rel=1e-6) and found.ratio > 1.0
    assert not left_out("the rest", slow, lambda: np.array([1.0, 2.1]), 1e-6, 1).right
    assert not left_out("the rest", slow, lambda: np.array([1.0, np.nan]), np.inf, 1).right
    assert not left_out("the rest", slow, lambda: 1.0, 1e-6, 1).right
    assert left_out("the rest", lambda: 0.0, lambda: 0.0, 0.0, 1).difference == 0.0


def test_the_least_time_and_the_exponent_of_a_line():
    calls = []
    result, seconds = timed(lambda: calls.append(1) or len(calls), repeats=4)
    assert result == 4 and 0.0 <= seconds < np.inf
    h = np.array([0.1, 0.05, 0.02, 0.01])
    assert exponent(h, 3.0 * h**4) == pytest.approx(4.0)
    assert exponent([*h, 0.005, 0.002], [*(3.0 * h**-1.5), 0.0, np.nan]) == pytest.approx(-1.5)
    assert np.isnan(exponent([1.0, 1.0], [1.0, 2.0])) and np.isnan(exponent([1.0], [1.0]))


def test_a_scene_names_what_is_wrong_and_has_a_table_for_each_file():
    good, bad = check("good", 1.0, 1.0, 0.1, "one"), check("bad", 2.0, 1.0, 0.1, "one")
    of = some(
        (good, bad),
        (Extreme("odd", "refused", "no"), Extreme("worse", "wrong", "nan")),
        (LeftOut("all", 2.0, 0.0, 0.0), LeftOut("too much", 9.0, 1.0, 0.5)),
    )
    assert of.wrong == ("bad", "worse", "too much")
    frames = of.frames()
    assert list(frames) == ["checks", "work", "extremes", "left_out", "trace"]
    assert frames["checks"]["verdict"].tolist() == ["right", "wrong"]
    assert frames["left_out"]["verdict"].tolist() == ["right", "wrong"]
    assert frames["extremes"]["outcome"].tolist() == ["refused", "wrong"]
    assert some().wrong == () and list(some().frames()["checks"].columns) == [
        *Check.__annotations__,
        "verdict",
    ]
