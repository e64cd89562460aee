"""What a long run says: before it begins, of its stage, and how long it will take."""

import importlib
import io
import re

import pytest
from conftest import chain, energy
from rich.console import Console
from test_descent import crowded

import protochain as pc
from protochain.batches.jobs import BatchSettings, Row, failure, find_jobs
from protochain.cli import terminal
from protochain.minimisers import METHODS, recipe_of


class Clock:
    """Seconds that pass only when told."""

    now = 0.0

    def __call__(self):
        return self.now


@pytest.fixture
def clock(monkeypatch):
    clock = Clock()
    monkeypatch.setattr(terminal, "monotonic", clock)
    return clock


def row(evaluations, torque=3.0):
    return {"evaluations": evaluations, "energy_kj_mol": -1234.5, "max_torque_kj_mol_rad": torque}


def test_without_a_terminal_a_line_comes_every_minute(clock, capsys):
    with terminal.run_progress("hybrid", 5000) as watch:
        for k in range(1, 200):
            clock.now = 2.0 * k
            watch.at_stage("torsions" if k < 100 else "all atoms", k)
            watch(row(k, 3.0 if k < 100 else float("nan")), None)
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 6
    assert re.match(r"hybrid: torsions: (29|30) evaluations, -1234.50 kJ/mol, torque 3 kJ", lines[0])
    # 470 evaluations of the 500 that such runs take are left, at two seconds each.
    assert lines[0].endswith("about 16 min left")
    assert re.match("hybrid: all atoms: (179|180) evaluations", lines[-1]) and "torque" not in lines[-1]


def test_beyond_what_is_typical_the_time_left_is_that_to_the_last_evaluation(clock, capsys):
    with terminal.run_progress("lbfgs", 1000) as watch:
        for k in (1, 501):
            clock.now = float(k)
            watch(row(k), None)
    assert capsys.readouterr().err.strip().endswith("at most 8 min left")


def test_an_interrupt_is_answered_in_words_at_once(clock, capsys):
    with terminal.run_progress("lbfgs", 1000) as watch:
        watch.at_stage("torsions", 3)
        watch.at_stage("interrupted, judging the end", 4)
    assert capsys.readouterr().err == "lbfgs: interrupted, judging the end; the best so far will be written\n"


def test_on_a_terminal_the_bar_names_the_stage_and_the_time_left(clock, monkeypatch):
    drawn = io.StringIO()
    monkeypatch.setattr(
        "rich.console.Console", lambda **_: Console(file=drawn, force_terminal=True, width=120)
    )
    c, stages = crowded(), []
    with terminal.run_progress("hybrid", 5000) as watch:

        def follow(name, evaluations):
            clock.now += 1.0
            watch.at_stage(name, evaluations)
            if not stages or stages[-1] != name:
                stages.append(name)
            watch.bar.refresh()

        class Both:
            at_stage = staticmethod(follow)

            def __call__(self, row, x):
                watch(row, x)
                watch.bar.refresh()

        pc.minimise(c, energy("1l2y.pdb"), "hybrid", tolerance=200.0, watch=Both())
    plain = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", drawn.getvalue())
    for stage in ("parting overlaps", "torsions", "all atoms", "judging the end"):
        assert f"hybrid: {stage}" in plain, stage
    assert re.search(r"hybrid: parting overlaps .* \d+ evaluations +about \d+ (s|min) left", plain)
    assert re.search(r"hybrid: torsions .* kJ/mol, torque .* about \d+ (s|min) left", plain)


def test_a_long_run_says_so_before_it_begins(monkeypatch, capsys):
    c, e = chain("1l2y.pdb"), energy("1l2y.pdb")
    terminal.foretell("1l2y.pdb", c, e, 100, 5000)
    assert capsys.readouterr().err == ""
    monkeypatch.setattr(terminal, "_LONG", 0.0)
    terminal.foretell("1l2y.pdb", c, e, 100, 5000)
    said = capsys.readouterr().err
    assert re.fullmatch(
        r"1l2y\.pdb: 304 atoms, [\d.e-]+ s an energy, typically 100 of at most 5000 evaluations: "
        r"about \d+ s\n",
        said,
    )
    terminal.foretell("1l2y.pdb", c, e, 5000, 5000)
    assert "at most 5000 evaluations" in capsys.readouterr().err


def test_what_is_typical_is_within_what_is_allowed():
    for method in METHODS:
        typical = terminal.typical_evaluations(method, 5000)
        assert typical == (recipe_of(method).typical or 5000) and terminal.typical_evaluations(method, 7) == 7
    assert terminal.typical_evaluations("hybrid", 5000) == 500


def test_a_batch_says_a_line_for_each_structure(tmp_path, capsys):
    api = importlib.import_module("protochain.batches.api")
    path = tmp_path / "a.pdb"
    path.write_text("nothing")
    (job,) = find_jobs([path], BatchSettings(("lbfgs", "kcm")))
    failed = [failure(job, method, "refused", "a.pdb: holds no atoms") for method in ("lbfgs", "kcm")]
    assert api._line(failed) == "a: refused: a.pdb: holds no atoms"
    done = {
        "structure": "a", "method": "lbfgs", "status": "converged", "output": "a.lbfgs.pdb", "seconds": 1.26,
        "energy_end_reference_kj_mol": -12.345, "ca_rmsd_angstrom": 0.456, "message": "converged: ...",
    }  # fmt: skip
    kept = "a: lbfgs converged, -12.35 kJ/mol, RMSD 0.46 angstrom, 1.3 s"
    line = api._line([Row(done, []), failed[1]])
    assert line in (
        f"{kept}; refused: a.pdb: holds no atoms",
        f"{kept.replace('.35', '.34')}; refused: a.pdb: holds no atoms",
    )
    with terminal.batch_progress() as watch:
        watch(api.BatchProgress(9, 1, 0, 2, 1.0, "", line))
    assert capsys.readouterr().err == f"[3 of 9] {line}\n"
