"""Scenes: their parts, the command, and that commands for proteins load none of them."""

import json
import sys
from importlib import import_module
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

import bench.scenes
from bench.__main__ import main
from bench.cases import CHECKS, Found, Outcome, Point, Scene, check, judged, left_out, table, tried, vanishes
from bench.cost import in_turn, timed
from bench.discovery import modules
from bench.fits import exponent, extrapolated, order
from bench.scenes import SCENES, run
from protochain.core.errors import Argument, Fault, MechanicsError


def ended(name, outcome):
    return Found(name=name, outcome=Outcome(outcome))


def less(name, ratio, error, bound):
    return Found(error, bound, name=name, seconds=1.0, whole=ratio)


def some(checks=(), extremes=(), left=()):
    work = [Point("a", "h", 0.1, 1e-3), Point("a", "h/2", 0.2, 1e-4)]
    return Scene("some", "a scene", checks, work, extremes, left, {"trace": pd.DataFrame({"t": [0.0, 1.0]})})


def test_a_check_says_how_far_off_it_is_and_nan_is_wrong():
    assert check("k", 2.02, 2.0, 0.011, "by hand").error == pytest.approx(0.01)
    assert check("k", 2.02, 2.0, 0.011, "by hand", "absolute").error == pytest.approx(0.02)
    assert check("k", -2.0, 2.0, 1.9, "a sign").error == 2.0
    verdicts = {value: check("k", value, 1.0, 0.1, "").right for value in (0.89, 0.91, 1.09, 1.11, np.inf)}
    assert verdicts == {0.89: False, 0.91: True, 1.09: True, 1.11: False, np.inf: False}
    assert not check("k", np.nan, 1.0, np.inf, "").right
    assert check("none", 0.0, 0.0, 0.0, "").right and not check("some", 1e-300, 0.0, 1.0, "").right


def test_an_extreme_is_right_refused_as_expected_or_wrong():
    def refuses(text):
        def call():
            raise MechanicsError(Argument("step"), text, fault=Fault.STEP)

        return call

    def of(value):
        return lambda: check("k", value, 1.0, 0.1, "one")

    right = judged("e", of(1.05))
    assert (right.name, right.verdict, right.right) == ("e", "right", True) and right.seconds >= 0.0
    assert right.detail == "relative error 0.05, bound 0.1: one"
    assert judged("e", of(1.2)).verdict == "wrong"
    assert judged("e", lambda: of(np.float64(1.0) / np.zeros(1)[0])()).verdict == "wrong"
    for expected in (Fault.STEP, Argument("step")):
        refused = judged("e", refuses(" 2 s"), expected)
        assert refused.verdict == "refused" and refused.right and refused.detail == "step 2 s"
    for expected in (None, Fault.NO_INERTIA, Argument("steps")):
        assert judged("e", refuses(" 2 s"), expected).verdict == "wrong"
    assert judged("e", refuses(" 2 s\nreally"), Fault.STEP).verdict == "wrong"
    answered = judged("e", of(1.0), Fault.STEP)
    assert answered.verdict == "wrong" and answered.error == 0.0
    broken = judged("e", lambda: {}["k"], Fault.STEP)
    assert broken.verdict == "wrong" and broken.detail == "KeyError: 'k'"


def test_what_is_left_out_must_leave_the_answer():
    def slow():
        for _ in range(50):
            np.linalg.eigvalsh(np.eye(30))
        return np.array([1.0, 2.0])

    found = left_out("the rest", slow, lambda: np.array([1.0, 2.0 + 1e-6]), 1e-6, repeats=2)
    assert found.right and found.error == pytest.approx(5e-7, rel=1e-6)
    assert not left_out("the rest", slow, lambda: np.array([1.0, 2.1]), 1e-6, 1).right
    assert not left_out("the rest", slow, lambda: np.array([1.0, np.nan]), np.inf, 1).right
    assert not left_out("the rest", slow, lambda: 1.0, 1e-6, 1).right
    assert left_out("the rest", lambda: 0.0, lambda: 0.0, 0.0, 1).error == 0.0


def test_the_least_time_and_the_exponent_of_a_line():
    calls = []
    result, seconds = timed(lambda: calls.append(1) or len(calls), repeats=4)
    assert result == 4 and 0.0 <= seconds < np.inf
    made = []
    # Two in a row of each, of which the first counts only where it is slow, or the first of all.
    ticks = iter(np.arange(100.0))
    both = in_turn([lambda: made.append("a"), lambda: made.append("b")], turns=3, row=2, clock=lambda: 0.0)
    assert "".join(made) == "abaabbaabb" and [len(each.seconds) for each in both] == [3, 3]
    slow = in_turn([lambda: made.append("c")], turns=2, row=5, clock=lambda: next(ticks))
    assert made.count("c") == 2 and slow[0].seconds == (1.0, 1.0) and slow[0].least == slow[0].median == 1.0
    with threadpool_limits(2, "blas"):
        (blas,) = in_turn([threadpool_info])
    assert {each["num_threads"] for each in blas.result if each["user_api"] == "blas"} == {1}
    h = np.array([0.1, 0.05, 0.02, 0.01])
    assert extrapolated(1.0 + h, 1.0 + 0.25 * h) == pytest.approx(np.ones(4), rel=1e-15)
    assert order(*(1.0 + 0.3 / n**2 for n in (4, 8, 16))) == pytest.approx(2.0)
    assert order(*(np.array([1.0, 2.0]) + 0.3 / n**2 for n in (4, 8, 16))) == pytest.approx(2.0)
    assert exponent(h, 3.0 * h**4) == pytest.approx(4.0)
    assert exponent([*h, 0.005, 0.002], [*(3.0 * h**-1.5), 0.0, np.nan]) == pytest.approx(-1.5)
    assert np.isnan(exponent([1.0, 1.0], [1.0, 2.0])) and np.isnan(exponent([1.0], [1.0]))


def test_a_scene_names_what_is_wrong_and_has_a_table_for_each_file():
    good, bad = check("good", 1.0, 1.0, 0.1, "one"), check("bad", 2.0, 1.0, 0.1, "one")
    of = some(
        (good, bad),
        (ended("odd", "refused"), ended("worse", "wrong")),
        (less("all", 2.0, 0.0, 0.0), less("too much", 9.0, 1.0, 0.5)),
    )
    assert of.wrong == ("bad", "worse", "too much")
    frames = of.frames()
    assert list(frames) == ["checks", "work", "extremes", "left_out", "trace"]
    assert frames["checks"]["verdict"].tolist() == ["right", "wrong"]
    assert frames["left_out"]["verdict"].tolist() == ["right", "wrong"]
    assert frames["extremes"]["outcome"].tolist() == ["refused", "wrong"]
    assert some().wrong == () and tuple(some().frames()["checks"].columns) == CHECKS


def test_a_point_of_work_has_its_error_and_what_is_refused_an_infinite_one():
    def refuses():
        raise MechanicsError("too long")

    point = tried("a", "h", lambda: 2.0, lambda found: found - 1.5)
    assert (point.method, point.setting, point.error) == ("a", "h", 0.5) and 0.0 <= point.seconds < np.inf
    refused = tried("a", "h", refuses, float)
    assert np.isnan(refused.seconds) and refused.error == np.inf
    (row,) = table([vanishes("k", -1e-3, 1e-2, "one")], CHECKS).to_numpy().tolist()
    assert row == ["k", -1e-3, 0.0, 1e-3, 1e-2, "one", "absolute", "right"]


@pytest.fixture
def scenes(monkeypatch):
    """Make the command run scenes of one's own: by name, a function of quick."""

    def put(**made):
        monkeypatch.setattr(bench.scenes, "SCENES", {name: f"one of {name}" for name in made})
        for name, function in made.items():
            module = SimpleNamespace(run=function)
            monkeypatch.setitem(sys.modules, f"bench.scenes.{name}", module)

    return put


def test_every_scene_is_found_with_its_line(tmp_path):
    for name, line in SCENES.items():
        assert 20 < len(line) < 90 and "\n" not in line
        assert callable(import_module(f"bench.scenes.{name}").run)
    (tmp_path / "one.py").write_text('"""The first."""\n1 / 0\n')
    (tmp_path / "one_part.py").write_text('"""Of the first."""\n')
    (tmp_path / "two").mkdir()
    (tmp_path / "two" / "__init__.py").write_text('"""The second: more.\n\nAnd more.\n"""\n')
    assert modules([str(tmp_path)]) == {"one": "The first", "two": "The second: more"}


def test_the_command_writes_what_a_scene_finds(scenes, tmp_path, capsys, monkeypatch):
    asked = []
    left = (less("half of it", 2.0, 0.0, 0.0),)
    found = some((check("k", 1.0, 1.0, 0.1, "one"),), (ended("odd", "refused"),), left)
    scenes(some=lambda quick: asked.append(quick) or found)
    monkeypatch.chdir(tmp_path)
    assert main(["some"]) == 0 and main(["some", "--quick", "-o", "there"]) == 0
    assert asked == [False, True]
    files = {"checks", "work", "extremes", "left_out", "trace"}
    for folder in (tmp_path / "bench", tmp_path / "there"):
        assert {path.stem for path in folder.glob("*.csv")} == files
        assert pd.read_csv(folder / "checks.csv")["verdict"].tolist() == ["right"]
        assert pd.read_csv(folder / "work.csv")["error"].tolist() == [1e-3, 1e-4]
        assert (folder / "work.png").stat().st_size > 5000
        page = (folder / "report.html").read_text()
        assert page.count('src="data:image/') == 1 and "half of it" in page and '<td class="refused">' in page
        record = json.loads((folder / "made.json").read_text())
        assert set(record) == {"machine", "threads", "versions", "commit"} and "numba" in record["versions"]
    out = capsys.readouterr().out
    assert "some: a scene\n" in out and "half of it" in out and "1 extremes" in out


SLOW = pytest.mark.slow


@pytest.mark.parametrize(
    ("name", "checks", "refused", "tables"),
    [
        ("manipulator", 8, 2, ("cells", "rigid_ends", "motion", "dampers")), ("canonical", 8, 1, ("costs",)),
        pytest.param("bucket", 9, 1, ("soil",), marks=SLOW),
        pytest.param("backhoe", 14, 1, ("designs",), marks=SLOW),
    ],
)  # fmt: skip
def test_a_scene_is_right(name, checks, refused, tables):
    """Nothing is wrong, nothing has gone; records say so of serial, loops, beam and impact."""
    found = run(name, quick=True)
    assert found.wrong == () and len(found.checks) >= checks and set(tables) <= set(found.tables)
    assert sum(each.verdict == "refused" for each in found.extremes) >= refused
    assert np.isfinite(found.work["error"]).sum() >= 2
    if name == "bucket":
        soil = found.tables["soil"]
        assert soil["work"].iloc[-1] > 0.0 and np.all(np.diff(soil["dissipated"]) >= 0.0)
    if name == "backhoe":
        assert found.tables["designs"]["least_angle_deg"].item() > 0.0
