"""OpenMM's minimiser and dynamics as methods: order of parts, budgets, endings, seeds."""

from contextlib import nullcontext

import numpy as np
import openmm
import pytest
from fixtures.samples import chain, energy
from fixtures.tolerances import CONSTRAINED_FORCE

import protochain as pc
from protochain.minimisers import RECIPES, openmm_reference
from protochain.minimisers.loop import Stop
from protochain.minimisers.openmm_reference import (
    _Reporter,
    _StopMinimisation,
    langevin_dynamics,
    local_energy_minimizer,
    minimise_by_openmm,
)
from protochain.minimisers.spaces import spaces


def height(x):
    """Energy of positions in the stories below: their first coordinate."""
    return float(x[0, 0])


class Story:
    """Parts that end as told, and what they were given."""

    def __init__(self, monkeypatch, *told, force=0.0):
        self.told, self.calls, self.records = list(told), [], []
        self.chain = chain("ala10.pdb")
        self.forces = np.full_like(self.chain.structure.positions, force)
        monkeypatch.setattr(openmm_reference, "local_energy_minimizer", self.minimised)
        monkeypatch.setattr(openmm_reference, "langevin_dynamics", self.heated)

    @property
    def start(self):
        return height(self.chain.structure.positions)

    def __call__(self, x):
        return height(x), self.forces

    reference = __call__

    def part(self, name, platform, x, tolerance, max_evaluations, record, **more):
        self.calls.append((name, platform, height(x), tolerance, max_evaluations, *more.values()))
        stop, end, iterations, evaluations = self.told.pop(0)
        x = x.copy()
        x[0, 0] = end
        record(x, end, evaluations, self.forces)
        return stop, x, iterations, evaluations

    def minimised(self, energy, platform, x, tolerance, max_evaluations, record):
        return self.part("minimiser", platform, x, tolerance, max_evaluations, record)

    def heated(self, energy, platform, x, max_evaluations, record, seed):
        return self.part("dynamics", platform, x, None, max_evaluations, record, seed=seed)

    def run(self, name, max_evaluations=100):
        done = minimise_by_openmm(
            RECIPES[name], self.chain, self, 2.0, max_evaluations, 5, lambda *row: self.records.append(row)
        )
        assert done.space is spaces(self.chain)[1] and not self.told
        return done.stop, height(done.x), done.n_iterations, done.n_evaluations


def test_the_minimiser_runs_once_where_single_precision_suffices(monkeypatch):
    story = Story(monkeypatch, (Stop.TOLERANCE, -9.0, 7, 20), force=2.0)
    assert story.run("openmm") == (Stop.TOLERANCE, -9.0, 7, 21)
    assert story.calls == [("minimiser", "CPU", story.start, 2.0, 99)]
    # Evaluations count on from those before.
    assert [(row[1], row[2]) for row in story.records] == [(story.start, 1), (-9.0, 21)]


@pytest.mark.parametrize("stop", [Stop.TOLERANCE, Stop.NO_DESCENT, Stop.NON_FINITE])
def test_the_minimiser_goes_on_in_double_precision_where_forces_are_left(stop, monkeypatch):
    story = Story(monkeypatch, (stop, -8.0, 7, 20), (Stop.NO_DESCENT, -9.0, 3, 30), force=2.01)
    assert story.run("openmm") == (Stop.NO_DESCENT, -9.0, 10, 51)
    assert story.calls == [
        ("minimiser", "CPU", story.start, 2.0, 99),
        ("minimiser", "Reference", -8.0, 2.0, 79),
    ]
    assert [(row[1], row[2]) for row in story.records] == [(story.start, 1), (-8.0, 21), (-9.0, 51)]


@pytest.mark.parametrize("stop", [Stop.BUDGET, Stop.INTERRUPTED])
def test_a_run_that_was_stopped_stays_so(stop, monkeypatch):
    story = Story(monkeypatch, (stop, -8.0, 7, 20), force=9.0)
    assert story.run("openmm") == (stop, -8.0, 7, 21)


@pytest.mark.parametrize("method", ["openmm", "openmm-md"])
def test_a_start_without_an_energy_is_said_to_be_one(method):
    c = chain("ala10.pdb")
    system, force = openmm.System(), openmm.CustomExternalForce("sqrt(-1-x^2)")
    for k in range(c.n_atoms):
        system.addParticle(12.0)
        force.addParticle(k, [])
    system.addForce(force)
    r = pc.minimise(c, pc.energy(c, system=system), method, max_evaluations=50)
    assert r.status == "non-finite" and r.n_evaluations == 1 and not r.is_usable


def test_a_spent_budget_ends_the_run(monkeypatch):
    story = Story(monkeypatch, (Stop.TOLERANCE, -8.0, 7, 20), force=9.0)
    assert story.run("openmm", 21) == (Stop.BUDGET, -8.0, 7, 21)
    story = Story(monkeypatch)
    assert story.run("openmm", 1) == (Stop.BUDGET, story.start, 0, 1)
    story = Story(monkeypatch)
    assert story.run("openmm-md", 1) == (Stop.BUDGET, story.start, 0, 1) and len(story.records) == 1


def test_dynamics_run_between_two_minimisations(monkeypatch):
    settled, hot, end = (Stop.NO_DESCENT, -5.0, 2, 10), (Stop.NO_DESCENT, 40.0, 30, 30), -9.0
    story = Story(monkeypatch, settled, hot, (Stop.TOLERANCE, end, 4, 20))
    assert story.run("openmm-md") == (Stop.TOLERANCE, -9.0, 36, 61)
    assert story.calls == [
        ("minimiser", "CPU", story.start, 100.0, 99), ("dynamics", "CPU", -5.0, None, 89, 5),
        ("minimiser", "CPU", 40.0, 2.0, 59),
    ]  # fmt: skip
    assert [row[2] for row in story.records] == [1, 11, 41, 61]
    # Where the end lies higher than what was settled, that is the result.
    assert Story(monkeypatch, settled, hot, (Stop.TOLERANCE, -4.0, 4, 20)).run("openmm-md")[1] == -5.0
    # A budget spent in the dynamics leaves what was settled.
    assert Story(monkeypatch, settled, hot).run("openmm-md", 41) == (Stop.BUDGET, -5.0, 32, 41)
    assert Story(monkeypatch, settled).run("openmm-md", 11) == (Stop.BUDGET, -5.0, 2, 11)


def test_an_interrupt_leaves_what_was_settled(monkeypatch):
    settled, hot = (Stop.NO_DESCENT, -5.0, 2, 10), (Stop.INTERRUPTED, -6.0, 30, 30)
    assert Story(monkeypatch, settled, hot).run("openmm-md") == (Stop.INTERRUPTED, -5.0, 32, 41)
    early = (Stop.INTERRUPTED, -4.0, 2, 10)
    assert Story(monkeypatch, early).run("openmm-md") == (Stop.INTERRUPTED, -4.0, 2, 11)


def test_a_reporter_counts_iterations_and_keeps_the_lowest():
    rows = []
    reporter = _Reporter(lambda *row: rows.append(row), 9, [])
    for k, value in enumerate((-1.0, -3.0, -3.0, -2.0)):
        count, force = reporter.count(None)
        assert count == 0.0 and force.tolist() == [[0.0, 0.0, 0.0]]
        assert reporter.report(k, [float(k)] * 6, [float(k)] * 6, {"system energy": value}) is False
    assert (reporter.n_iterations, reporter.n_evaluations, reporter.stop) == (4, 4, Stop.NO_DESCENT)
    assert reporter.best == -3.0 and reporter.best_x.tolist() == [[1.0] * 3] * 2
    assert [(x[0, 0], value, n) for x, value, n, _ in rows] == [
        (0, -1, 1),
        (1, -3, 2),
        (2, -3, 3),
        (3, -2, 4),
    ]
    assert [forces.tolist() for *_, forces in rows] == [[[-float(k)] * 3] * 2 for k in range(4)]


def test_a_reporter_breaks_off_at_the_budget_and_at_interrupts():
    reporter = _Reporter(lambda *row: None, 2, [])
    reporter.count(None), reporter.count(None)
    with pytest.raises(_StopMinimisation):
        reporter.count(None)
    assert (reporter.stop, reporter.n_evaluations) == (Stop.BUDGET, 2)
    assert reporter.report(0, [0.0] * 3, [0.0] * 3, {"system energy": 1.0}) is True
    interrupts = []
    reporter = _Reporter(lambda *row: None, 2, interrupts)
    reporter.count(None)
    interrupts.append(2)
    with pytest.raises(_StopMinimisation):
        reporter.count(None)
    assert (reporter.stop, reporter.n_evaluations) == (Stop.INTERRUPTED, 1)

    def interrupted(*row):
        raise KeyboardInterrupt

    reporter = _Reporter(interrupted, 2, [])
    assert reporter.report(0, [0.0] * 3, [0.0] * 3, {"system energy": 1.0}) is True
    assert reporter.stop is Stop.INTERRUPTED and reporter.best == 1.0


def recorded(part, x=None, **given):
    e, rows = energy("ala10.pdb"), []
    x = chain("ala10.pdb").structure.positions if x is None else x
    ended = part(e, "Reference", x, record=lambda *row: rows.append(row), **given)
    return *ended, rows


def test_openmms_minimiser_is_recorded_and_ends_at_its_budget():
    e = energy("ala10.pdb")
    stop, x, iterations, evaluations, rows = recorded(
        local_energy_minimizer, tolerance=1.0, max_evaluations=12
    )
    assert stop is Stop.BUDGET and evaluations == 12 and len(rows) == iterations > 2
    assert [row[2] for row in rows] == sorted(row[2] for row in rows) and rows[-1][2] <= 12
    value, forces = e.reference(rows[-1][0])
    assert rows[-1][1] == pytest.approx(value, abs=1e-6) and np.abs(rows[-1][3] - forces).max() < 1e-6
    assert np.array_equal(x, min(rows, key=lambda row: row[1])[0])
    stop, x, iterations, evaluations, rows = recorded(
        local_energy_minimizer, tolerance=50.0, max_evaluations=500
    )
    assert stop is Stop.NO_DESCENT and evaluations < 500 and iterations == len(rows)
    assert np.sqrt(np.mean(e.reference(x)[1] ** 2)) <= 50.0
    stop, x, iterations, _, _ = recorded(local_energy_minimizer, tolerance=1.0, max_evaluations=1)
    assert (stop, iterations) == (Stop.BUDGET, 0)
    assert np.array_equal(x, chain("ala10.pdb").structure.positions)


@pytest.mark.parametrize(("before", "stop"), [(Stop.NO_DESCENT, Stop.NON_FINITE), (Stop.BUDGET, Stop.BUDGET)])
def test_an_error_of_openmms_is_a_number_that_is_none_unless_it_was_broken_off(before, stop, monkeypatch):
    x, given = chain("ala10.pdb").structure.positions, []

    def minimize(context, tolerance, most, reporter):
        given.append((context.getPlatform().getName(), tolerance, most))
        reporter.stop = before
        raise openmm.OpenMMException("NaN")

    monkeypatch.setattr(openmm.LocalEnergyMinimizer, "minimize", minimize)
    ended = recorded(local_energy_minimizer, tolerance=1.5, max_evaluations=20)
    assert ended[0] is stop and ended[1] is x and ended[2:] == (0, 0, [])
    # Iterations are limited by evaluations only.
    assert given == [("Reference", 1.5, 0)]


def test_openmms_dynamics_are_recorded_every_twenty_steps_up_to_the_budget():
    stop, x, iterations, evaluations, rows = recorded(langevin_dynamics, max_evaluations=50, seed=1)
    assert (stop, iterations, evaluations) == (Stop.NO_DESCENT, 50, 50)
    assert [row[2] for row in rows] == [20, 40, 50] and np.array_equal(rows[-1][0], x)
    value, forces = energy("ala10.pdb").reference(rows[0][0])
    assert rows[0][1] == pytest.approx(value, abs=1e-6)
    # Constrained bonds exert none there, though they are not quite at their lengths.
    assert np.abs(rows[0][3] - forces).max() < CONSTRAINED_FORCE * np.abs(forces).max()


def test_openmms_dynamics_depend_on_their_seed_and_repeat():
    """In velocities, and in the noise of the integrator, for which a seed of 0 would be one of the clock."""
    ends = [recorded(langevin_dynamics, max_evaluations=3, seed=seed)[1] for seed in (0, 0, 1)]
    assert np.array_equal(ends[0], ends[1]) and not np.array_equal(ends[0], ends[2])


def test_openmms_dynamics_end_at_interrupts_and_where_there_is_no_number(monkeypatch):
    s = chain("ala10.pdb").structure
    with monkeypatch.context() as patch:
        patch.setattr(openmm_reference, "held_interrupts", lambda: nullcontext([2]))
        stop, x, iterations, evaluations, rows = recorded(langevin_dynamics, max_evaluations=50, seed=1)
    assert (stop, iterations, evaluations, rows) == (Stop.INTERRUPTED, 0, 0, []) and x is s.positions

    def interrupted(*row):
        raise KeyboardInterrupt

    ended = langevin_dynamics(energy("ala10.pdb"), "Reference", s.positions, 50, interrupted, 1)
    assert (ended[0], *ended[2:]) == (Stop.INTERRUPTED, 20, 20) and not np.array_equal(ended[1], s.positions)
    x = s.positions.copy()
    x[3, 0] = np.nan
    stop, end, _, _, rows = recorded(langevin_dynamics, x, max_evaluations=50, seed=1)
    assert stop is Stop.NON_FINITE and end is x and rows == []
