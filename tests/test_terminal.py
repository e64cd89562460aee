"""What a run says: before it begins, of its stage, and how long it will take; what bars show."""

import importlib
import io
import re
from types import SimpleNamespace

import pytest
from conftest import chain, energy
from rich.console import Console
from test_descent import crowded

import protochain as pc
from protochain.batches.api import BatchProgress
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


class Bar:
    """Stands for rich's Progress; remembers what it is told."""

    made = ()

    def __init__(self, *columns, console, disable):
        self.columns = [type(column).__name__ for column in columns]
        self.formats = [getattr(column, "text_format", "") for column in columns]
        self.console, self.disable = console, disable
        self.added, self.updates, self.tasks = [], [], [SimpleNamespace(speed=None)]
        Bar.made = (*Bar.made, self)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.added.append("closed")

    def add_task(self, name, **more):
        self.added.append((name, more))
        return 7

    def update(self, task, **more):
        assert task == 7
        self.updates.append(more)


@pytest.fixture
def bar(monkeypatch):
    monkeypatch.setattr("rich.progress.Progress", Bar)
    monkeypatch.setattr(Bar, "made", ())
    return lambda: Bar.made[-1]


def row(evaluations, torque=3.0):
    return {"evaluations": evaluations, "energy_kj_mol": -1234.5, "max_torque_kj_mol_rad": torque}


def test_the_bar_of_a_run_shows_stage_evaluations_energy_torque_and_time_left(bar, clock, monkeypatch):
    seen, typical = [], 150
    monkeypatch.setattr(terminal, "typical_evaluations", lambda method, most: min(typical, most))
    with terminal.run_progress("lbfgs", 500, seen.append) as watch:
        made = bar()
        assert made.disable and made.console.stderr
        assert made.added == [("lbfgs", {"total": typical, "now": "", "left": ""})]

        def shown(seconds, told):
            clock.now = seconds
            told()
            *_, last = made.updates
            assert last.pop("total") == (500 if last["completed"] >= typical else typical)
            return tuple(last.values())

        def told(evaluations, torque=1234.5):
            return lambda: watch(row(evaluations, torque), evaluations)

        energy = "-1234.50 kJ/mol"
        assert shown(0.0, told(20.0)) == (
            "lbfgs", 20.0, f"20 evaluations, {energy}, torque 1.23e+03 kJ/mol/rad", "",
        )  # fmt: skip
        # One a second: of 150, 126 are left.
        at_stage = watch.at_stage
        assert shown(4.0, lambda: at_stage("parting", 24)) == (
            "lbfgs: parting", 24, "24 evaluations", "about 2 min left",
        )  # fmt: skip
        now = f"60 evaluations, {energy}"
        assert shown(40.0, told(60.0, float("nan"))) == ("lbfgs: parting", 60.0, now, "about 90 s left")
        # The energy stays until the next stage begins.
        assert shown(50.0, lambda: at_stage("parting", 70)) == ("lbfgs: parting", 70, now, "about 80 s left")
        assert shown(60.0, lambda: at_stage("next", 80)) == (
            "lbfgs: next", 80, "80 evaluations", "about 70 s left",
        )  # fmt: skip
        # Two seconds each from the first on, and none is typical any more.
        *_, left = shown(260.0, told(150.0))
        assert left == "at most 12 min left"
        # The next of many starts is timed by itself.
        assert shown(300.0, told(10.0))[3] == "" and shown(301.0, told(60.0))[3] == "about 2 s left"
    assert made.columns == ["TextColumn", "BarColumn", "TextColumn", "TextColumn"]
    assert made.formats == ["{task.description}", "", "{task.fields[now]}", "{task.fields[left]}"]
    assert made.added[-1] == "closed" and seen == [20.0, 60.0, 150.0, 10.0, 60.0]


def test_the_bar_of_a_simulation_shows_time_temperature_speed_and_time_left(bar, clock):
    with terminal.simulation_progress("x", 1000, 0.005) as watch:
        now = {"time_ps": 1.04, "temperature_k": 299.6}
        watch(now | {"step": 200}, None)
        # 100 steps a second of 0.005 ps: 0.5 ps/s, 86400 s a day.
        clock.now = 2.0
        watch(now | {"step": 400}, None)
        made = bar()
    assert made.columns == ["TextColumn", "BarColumn", "TextColumn", "TextColumn"]
    assert made.formats == ["{task.description}", "", "{task.fields[now]}", "{task.fields[left]}"]
    assert made.added[0] == ("x", {"total": 1000, "now": "", "left": ""})
    assert made.disable and made.console.stderr
    both = {"description": "x", "total": 1000}
    assert made.updates == [
        both | {"completed": 200, "now": "1.0 ps, 300 K", "left": ""},
        both | {"completed": 400, "now": "1.0 ps, 300 K, 43.2 ns/day", "left": "about 6 s left"},
    ]
    assert made.added[-1] == "closed"


def test_the_bar_of_a_batch_shows_counts_and_the_dashboard_once(bar, capsys):
    with terminal.batch_progress() as watch:
        watch(BatchProgress(10, 0, 0, 3, 2.0, ""))
        for line in ("", "[b]a: 'odd' 12"):
            watch(BatchProgress(10, 4, 1, 3, 60.0, "http://x:8787", line))
        watch(BatchProgress(10, 4, 1, 3, 60.0, "http://other"))
        made = bar()
    assert made.columns == ["BarColumn", "TextColumn", "TimeRemainingColumn"]
    assert made.formats == ["", "{task.fields[now]}", ""] and made.disable and made.console.stderr
    assert made.added == [("", {"total": None, "now": "starting workers"}), "closed"]
    assert made.updates == [
        {"total": 10, "completed": 3, "now": "3 of 10, 0 failed, 0/min"},
        *[{"total": 10, "completed": 7, "now": "7 of 10, 1 failed, 4/min"}] * 3,
    ]
    assert capsys.readouterr().err == "dashboard: http://x:8787\n[7 of 10] [b]a: 'odd' 12\n"


def test_lines_beside_a_bar_are_printed_as_they_are_in_colour_too(bar, clock, capsys, monkeypatch):
    """rich would paint numbers and addresses, and take square brackets for styles."""
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.setenv("COLUMNS", "30")
    with terminal.batch_progress() as watch:
        watch(BatchProgress(10, 4, 1, 3, 60.0, "http://x:8787", "[b]a: 'odd' 12 and more"))
    with terminal.run_progress("lbfgs", 9) as watch:
        watch.at_warning("'odd' 12 [b]")
    assert capsys.readouterr().err.splitlines() == [
        "dashboard: http://x:8787", "[7 of 10] [b]a: 'odd' 12 and more",
        "lbfgs: 'odd' 12 [b]",
    ]  # fmt: skip


def test_a_terminal_gets_a_bar_and_no_lines(bar, clock, monkeypatch, capsys):
    monkeypatch.setenv("FORCE_COLOR", "1")
    with terminal.run_progress("lbfgs", 9) as watch:
        assert bar().disable is False
        for clock.now in (0.0, 100.0):
            watch(row(1.0 + clock.now), None)
    with terminal.simulation_progress("x", 1, 1.0), terminal.batch_progress():
        assert [made.disable for made in Bar.made] == [False] * 3
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    ("seconds", "said"),
    [(0.4, "0 s"), (99.4, "99 s"), (100.0, "2 min"), (5999.0, "100 min"), (6000.0, "1.7 h")],
)
def test_times_are_in_seconds_minutes_or_hours(seconds, said):
    assert terminal._clock(seconds) == said


def test_without_a_terminal_a_line_comes_every_minute(clock, capsys, monkeypatch):
    monkeypatch.setattr(terminal, "typical_evaluations", lambda method, most: 500)
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
        watch.at_stage("interrupted", 4)
    assert capsys.readouterr().err == "lbfgs: interrupted; the best so far will be written\n"
    with terminal.run_progress("lbfgs", 1000, writes=False) as watch:
        watch.at_stage("interrupted", 4)
    assert capsys.readouterr().err == "lbfgs: interrupted\n"


def test_on_a_terminal_the_bar_names_the_stage_and_the_time_left(clock, monkeypatch):
    drawn = io.StringIO()
    monkeypatch.setattr(terminal, "printer", lambda **_: Console(file=drawn, force_terminal=True, width=120))
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
    for stage in ("parting overlaps", "held by springs", "all atoms", "judging the end"):
        assert f"hybrid: {stage}" in plain, stage
    assert re.search(r"hybrid: parting overlaps .* \d+ evaluations +about \d+ (s|min) left", plain)
    assert re.search(r"hybrid: held by springs .* kJ/mol +about \d+ (s|min) left", plain)


def test_what_is_wrong_with_a_start_is_printed(capsys):
    assert not terminal.print_outlook("a.pdb", chain("1l2y.pdb").structure, "hybrid")
    assert capsys.readouterr().err == ""
    assert terminal.print_outlook("a.pdb", crowded().structure, "hybrid")
    first, last = capsys.readouterr().err.splitlines()
    assert re.match(r"a\.pdb: \d+ pairs of atoms overlap; violations in \d+ residues: ", first)
    assert last.startswith("a.pdb: hybrid: parts overlaps") and last.endswith("; relax keeps the fold")


def test_a_run_that_strays_says_so_at_once(clock, capsys):
    with terminal.run_progress("hybrid", 1000) as watch:
        watch.at_warning("2.1 angstrom from a start; relax keeps the fold")
        assert capsys.readouterr().err == "hybrid: 2.1 angstrom from a start; relax keeps the fold\n"


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
    assert "s an energy, at most 5000 evaluations: about" in capsys.readouterr().err


def test_one_slow_energy_makes_no_run_long(monkeypatch, capsys):
    # On a busy machine a single call may wait long for the other core.
    clock = SimpleNamespace(now=0.0, waits=[0.0, 9.0, 0.01, 9.0])

    def slow(x):
        clock.now += clock.waits.pop(0)

    monkeypatch.setattr(terminal, "monotonic", lambda: clock.now)
    terminal.foretell("1l2y.pdb", chain("1l2y.pdb"), slow, 100, 5000)
    assert capsys.readouterr().err == "" and clock.waits == [9.0]
    clock.waits = [0.0, 2.0, 1.0, 3.0, 1.5, 9.0, 9.0]
    terminal.foretell("1l2y.pdb", chain("1l2y.pdb"), slow, 100, 5000)
    assert "1 s an energy" in capsys.readouterr().err and clock.waits == [9.0]


def test_what_is_typical_is_within_what_is_allowed():
    for method in METHODS:
        typical = terminal.typical_evaluations(method, 5000)
        assert typical == (recipe_of(method).typical or 5000) and terminal.typical_evaluations(method, 7) == 7
    assert terminal.typical_evaluations("hybrid", 5000) == 100


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
