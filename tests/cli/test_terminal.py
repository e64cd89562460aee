"""What a run says: before it begins, of its stage, and how long it will take; what bars show."""

import itertools
import re
import shlex
import subprocess
from types import SimpleNamespace

import pytest
from fixtures.command_line import COMMAND, protochain
from fixtures.samples import STRUCTURES, chain, energy
from fixtures.texts import numbers
from fixtures.waiting import HANG

from protochain.batches.batch_structures import BatchProgress
from protochain.cli import terminal


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


def seconds_of(text):
    """A time with its unit, as a number of seconds with the last digit's half as the error."""
    value, unit = re.search(r"([\d.]+) (s|min|h)\b", text).groups()
    each = {"s": 1.0, "min": 60.0, "h": 3600.0}[unit]
    return pytest.approx(float(value) * each, abs=0.5 * each * (0.1 if "." in value else 1.0))


class Bar:
    """Stands for rich's Progress; remembers what it is told."""

    made = ()

    def __init__(self, *columns, console, disable):
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


def test_the_bar_of_a_run_shows_stage_evaluations_energy_torque_and_rate(bar, clock):
    seen = []
    with terminal.run_progress("lbfgs", 500, None, seen.append) as watch:
        made = bar()
        assert made.disable and made.console.stderr

        def shown(seconds, report, *arguments):
            clock.now = seconds
            report(*arguments)
            *_, last = made.updates
            assert last["description"].startswith("lbfgs")
            return last

        def evaluated(n, torque=1234.5):
            watch(row(n, torque), n)

        first = shown(0.0, evaluated, 20.0)
        assert first["completed"] == 20 and numbers(first["now"])[:2] == [20.0, -1234.5]
        assert numbers(first["now"])[2] == pytest.approx(1234.5, rel=0.01) and first["left"] == ""
        # One a second, and no trend of the torque.
        staged = shown(4.0, watch.at_stage, "parting", 24)
        assert "parting" in staged["description"] and numbers(staged["now"]) == [24.0]
        assert numbers(staged["left"]) == [4.0, 1.0] and staged["total"] is None
        without = shown(40.0, evaluated, 60.0, float("nan"))
        assert numbers(without["now"]) == [60.0, -1234.5] and numbers(without["left"]) == [40.0, 1.0]
        # The energy stays until the next stage begins.
        assert shown(50.0, watch.at_stage, "parting", 70)["now"] == without["now"]
        following = shown(60.0, watch.at_stage, "next", 80)
        assert "next" in following["description"] and numbers(following["now"]) == [80.0]
        # The next of many starts is timed by itself.
        assert shown(300.0, evaluated, 10.0)["left"] == ""
        assert numbers(shown(301.0, evaluated, 60.0)["left"]) == [1.0, 50.0]
    assert made.added[-1] == "closed" and seen == [20.0, 60.0, 10.0, 60.0]


def test_remaining_time_follows_from_the_decrease_of_the_torque(bar, clock):
    """Torques halve every 10 evaluations, of which two are done in a second."""
    with terminal.run_progress("lbfgs", 500, 1.0) as watch:
        made = bar()
        for n in range(0, 101, 2):
            clock.now = 0.5 * n + 1.0
            watch(row(n, 2.0 ** (12 - n / 10)), None)
        # 2^12 falls to 1 in 120 evaluations, of which 20 remain.
        assert seconds_of(made.updates[-1]["left"].split("about")[1]) == 10.0
        assert made.updates[-1]["total"] == 120
        # The decrease becomes 20 times slower. An estimate is at most twice the one before.
        for n in range(102, 400, 2):
            clock.now = 0.5 * n + 1.0
            watch(row(n, 2.0 ** (2 - (n - 100) / 200)), None)
        shown = [
            seconds_of(update["left"].split("about")[1]).expected
            for update in made.updates
            if "about" in update["left"]
        ]
        assert max(shown) > 100.0
        assert all(later <= 2.0 * earlier + 1.5 for earlier, later in itertools.pairwise(shown))


@pytest.mark.parametrize(
    "residuals",
    [[], [(k, 5.0) for k in range(30)], [(k, 100.0 - k) for k in range(9)]],
    ids=("none", "constant", "few"),
)
def test_without_a_trend_no_time_is_estimated(residuals):
    assert terminal.remaining_evaluations(residuals, 1.0) is None


def test_the_bar_of_a_simulation_shows_time_temperature_speed_and_time_left(bar, clock):
    with terminal.simulation_progress("x", 1000, 0.005) as watch:
        now = {"time_ps": 1.04, "temperature_k": 299.6}
        watch(now | {"step": 200}, None)
        # 100 steps a second of 0.005 ps: 0.5 ps/s, 86400 s a day.
        clock.now = 2.0
        watch(now | {"step": 400}, None)
        made = bar()
    assert made.disable and made.console.stderr and made.added[-1] == "closed"
    first, second = made.updates
    assert [(each["completed"], each["total"]) for each in (first, second)] == [(200, 1000), (400, 1000)]
    assert numbers(first["now"]) == [1.0, 300.0] and first["left"] == ""
    assert numbers(second["now"]) == [1.0, 300.0, 43.2] and seconds_of(second["left"]) == 6.0


def test_the_bar_of_a_batch_shows_counts_and_the_dashboard_once(bar, capsys):
    with terminal.batch_progress() as watch:
        watch(BatchProgress(10, 0, 0, 3, 2.0, ""))
        for line in ("", "[b]a: 'odd' 12"):
            watch(BatchProgress(10, 4, 1, 3, 60.0, "http://x:8787", line))
        watch(BatchProgress(10, 4, 1, 3, 60.0, "http://other"))
        made = bar()
    assert made.disable and made.console.stderr and made.added[-1] == "closed"
    assert [(each["completed"], each["total"]) for each in made.updates] == [(3, 10), *[(7, 10)] * 3]
    # Done, of all, failed, a minute.
    assert [numbers(each["now"]) for each in made.updates] == [[3, 10, 0, 0], *[[7, 10, 1, 4]] * 3]
    dashboard, done = capsys.readouterr().err.splitlines()
    assert "http://x:8787" in dashboard and done.endswith("[b]a: 'odd' 12") and numbers(done)[:2] == [7, 10]


@pytest.mark.parametrize("seconds", [0.4, 99.4, 100.0, 5999.0, 6000.0, 1e5])
def test_times_are_in_seconds_minutes_or_hours(seconds):
    assert seconds == seconds_of(terminal._clock(seconds)) and len(terminal._clock(seconds)) <= 7


def test_without_a_terminal_a_line_comes_every_minute(clock, capsys):
    with terminal.run_progress("hybrid", 5000, None) as watch:
        for k in range(1, 200):
            clock.now = 2.0 * k
            watch.at_stage("torsions" if k < 100 else "all atoms", k)
            watch(row(k, 3.0 if k < 100 else float("nan")), None)
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 6
    evaluations, energy, torque, *_ = numbers(lines[0])
    assert "torsions" in lines[0] and (evaluations in (29, 30), energy, torque) == (True, -1234.5, 3.0)
    assert lines[0].endswith("0.5 evaluations/s")
    assert "all atoms" in lines[-1] and numbers(lines[-1])[0] in (179, 180) and "torque" not in lines[-1]


def test_an_interrupt_is_answered_at_once_and_says_what_will_be_written(clock, capsys):
    said = []
    for writes in (True, False):
        with terminal.run_progress("lbfgs", 1000, None, writes=writes) as watch:
            watch.at_stage("torsions", 3)
            watch.at_stage("interrupted", 4)
            (line,) = capsys.readouterr().err.splitlines()
            said.append(line)
    assert all("lbfgs" in line and "interrupted" in line for line in said)
    assert "written" in said[0] and "written" not in said[1]


def test_a_long_run_says_so_before_it_begins(monkeypatch, capsys):
    c, e = chain("1l2y.pdb"), energy("1l2y.pdb")
    terminal.foretell(c, e, 100, 5000)
    assert capsys.readouterr().err == ""
    monkeypatch.setattr(terminal, "_LONG", 0.0)
    for evaluations in (100, 5000):
        terminal.foretell(c, e, evaluations, 5000)
        (line,) = capsys.readouterr().err.splitlines()
        atoms, each, *counts, seconds = numbers(line)
        assert atoms == c.n_atoms and counts == ([100, 5000] if evaluations < 5000 else [5000])
        # Two digits of one energy, and whole seconds.
        assert seconds == pytest.approx(each * evaluations, rel=0.05, abs=0.5)


@pytest.mark.parametrize("closed", [">&-", "<&-"])
def test_a_closed_standard_stream_is_refused_before_a_file_takes_its_place(closed, tmp_path):
    command = shlex.join([*COMMAND, "minimise", str(STRUCTURES / "ala10.pdb"), "-o", "o.pdb"])
    done = subprocess.run(
        ["sh", "-c", f"{command} {closed}"], cwd=tmp_path, capture_output=True, text=True, timeout=HANG
    )
    assert done.returncode == 2 and done.stderr.count("\n") == 1 and "is closed" in done.stderr
    assert not [*tmp_path.iterdir()]


@pytest.mark.parametrize("name", ["NUMBA_NUM_THREADS", "NUMBA_DISABLE_JIT"])
def test_settings_of_numba_that_cannot_work_are_named(name, tmp_path, monkeypatch):
    value = "0" if name == "NUMBA_NUM_THREADS" else "1"
    monkeypatch.setenv(name, value)
    done = protochain("minimise", STRUCTURES / "ala10.pdb", "-o", "o.pdb", cwd=tmp_path)
    assert done.returncode == 2 and done.stderr.count("\n") == 1 and name in done.stderr
