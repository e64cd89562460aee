"""The command of studies and scenes: which are run, with what, and what is wrong."""

import sys
from pathlib import Path
from types import SimpleNamespace

import pandas as pd
import pytest

from bench import cases, scenes, studies
from bench.__main__ import main


@pytest.fixture
def ran(monkeypatch):
    """Calls of two studies and of a scene, which is wrong."""
    calls = []

    def module(kind, name, found):
        own = SimpleNamespace(run=lambda *given, quick=False: calls.append((name, *given, quick)) or found)
        monkeypatch.setitem(sys.modules, f"bench.{kind}.{name}", own)

    for name in ("one", "two"):
        module("studies", name, [pd.DataFrame({"a": [1], "b": ["x"]})])
    bad = cases.Found(name="odd")
    module("scenes", "three", cases.Scene("three", "a scene", (), (), (bad,)))
    monkeypatch.setattr(studies, "STUDIES", {"one": "first", "two": "second"})
    monkeypatch.setattr(scenes, "SCENES", {"three": "third"})
    return calls


def test_without_a_name_it_lists(ran, capsys):
    assert main([]) == 0 and not ran
    assert capsys.readouterr().out == "one    first\ntwo    second\nthree  third\n"


def test_a_scene_that_is_wrong_is_said(ran, tmp_path, capsys):
    assert main(["three", "-o", str(tmp_path), "--quick"]) == 1
    assert ran == [("three", True, False)]
    printed = capsys.readouterr()
    assert "odd" in printed.out and "odd" in printed.err
    assert (tmp_path / "checks.csv").exists()


def test_a_study_gets_files_and_the_options_it_has(ran, tmp_path, capsys):
    assert main(["two", "a.pdb", "-o", str(tmp_path)]) == 0
    assert "a b\n 1 x" in capsys.readouterr().out
    assert ran == [("two", tmp_path, [Path("a.pdb")], False)]
    assert main(["two", "--jobs", "2"]) == 2 and "jobs" in capsys.readouterr().err


REFUSED = "odd", "three a.pdb", "three --jobs 2", "two -o file", "one d/a -o d"


@pytest.mark.parametrize("words", REFUSED)
def test_what_cannot_be_run_is_refused_in_a_line(ran, tmp_path, capsys, monkeypatch, words):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("")
    assert main(words.split()) == 2 and not ran
    assert len(capsys.readouterr().err.splitlines()) == 1
