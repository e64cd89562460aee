"""Batches that are killed and go on, and clusters of processes on this machine."""

import json
import os
import signal
import subprocess
import sys
from contextlib import contextmanager

import numpy as np
import pandas as pd
import psutil
import pytest
from fixtures.samples import load
from fixtures.waiting import HANG, until

import protochain as pc

pytestmark = pytest.mark.slow

N_GOOD, N_BAD = 12, 3
OPTIONS = ("--methods", "lbfgs,kcm", "--max-evaluations", "150")
MEASURED = ("seconds", "seconds_preparation")
"""Columns that differ from run to run."""


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    """Perturbed copies of one structure, and files that cannot be used."""
    folder = tmp_path_factory.mktemp("inputs")
    s = load("1l2y.pdb")
    random = np.random.default_rng(0)
    for k in range(N_GOOD):
        x = s.positions + random.normal(scale=0.005, size=s.positions.shape)
        pc.save(s.with_positions(x), folder / f"copy{k:02}.pdb")
    for k in range(N_BAD):
        (folder / f"bad{k}.pdb").write_text("nothing of use\n")
    return folder


@pytest.fixture(scope="module")
def whole(inputs, tmp_path_factory):
    """The table of a run that nothing disturbed."""
    output = tmp_path_factory.mktemp("whole")
    assert start(inputs, output, "--workers", "2").wait(timeout=HANG) == 4
    return table(output)


def table(output):
    read = pd.read_csv(output / "summary.csv")
    assert not read.duplicated(["structure", "method"]).any()
    return read.drop(columns=list(MEASURED))


def start(inputs, output, *options):
    command = [sys.executable, "-c", "from protochain.cli import main; main()"]
    return subprocess.Popen(
        [*command, "batch", str(inputs), "-o", str(output), *OPTIONS, *options],
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True,
    )  # fmt: skip


def wait_for_rows(output, least, running):
    """Wait until some structures are done, and others are not."""
    summary = output / "summary.csv"
    until(lambda: summary.exists() and summary.read_text().count("\n") > 2 * least, running)


def gone(processes):
    """Whether all of these end by themselves."""
    _, alive = psutil.wait_procs(processes, timeout=HANG)
    return not alive


@pytest.mark.parametrize("least", [1, 6])
@pytest.mark.parametrize("whom", ["client", "all"])
def test_a_killed_batch_goes_on_to_the_same_table(inputs, whole, whom, least, tmp_path):
    running = start(inputs, tmp_path, "--workers", "2")
    wait_for_rows(tmp_path, least, running)
    family = psutil.Process(running.pid).children(recursive=True)
    for process in [psutil.Process(running.pid), *(family if whom == "all" else [])]:
        process.kill()
    running.wait()
    assert gone(family)
    before = pd.read_csv(tmp_path / "summary.csv")
    assert len(before) < len(whole)
    resumed = start(inputs, tmp_path, "--workers", "2", "--resume")
    assert resumed.wait(timeout=HANG) == 4
    pd.testing.assert_frame_equal(table(tmp_path), whole)
    # What was done is not done again: its times are those of the first run.
    after = pd.read_csv(tmp_path / "summary.csv").merge(before, on=["structure", "method"])
    assert len(after) == len(before) and (after["seconds_x"] == after["seconds_y"]).all()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_keeps_what_is_done(inputs, whole, number, tmp_path):
    running = start(inputs, tmp_path, "--workers", "2")
    wait_for_rows(tmp_path, N_BAD + 2, running)
    family = psutil.Process(running.pid).children(recursive=True)
    # As from a terminal: the whole group of processes gets it.
    os.killpg(running.pid, number)
    assert running.wait(timeout=HANG) == 130
    assert gone(family)
    kept = table(tmp_path)
    assert N_BAD + 2 <= kept["structure"].nunique() < N_GOOD + N_BAD and not kept["status"].eq("killed").any()
    assert (tmp_path / "report.html").exists() and (tmp_path / "summary.parquet").exists()
    assert start(inputs, tmp_path, "--workers", "2", "--resume").wait(timeout=HANG) == 4
    pd.testing.assert_frame_equal(table(tmp_path), whole)


@contextmanager
def cluster(folder):
    """Run a scheduler and two workers of the dask command line on loopback; give the address."""
    file = folder / "scheduler.json"
    dask = [sys.executable, "-m", "dask"]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    scheduler = [
        "scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", file,
    ]  # fmt: skip
    started = [subprocess.Popen([*dask, *scheduler], **quiet)]
    try:
        until(lambda: file.exists() and file.read_text().endswith("}"), started[0])
        address = json.loads(file.read_text())["address"]
        worker = ["worker", address, "--host", "127.0.0.1", "--nthreads", "1", "--no-dashboard", "--nanny"]
        started += [
            subprocess.Popen([*dask, *worker, "--local-directory", folder], **quiet) for _ in range(2)
        ]
        yield address
    finally:
        for process in started:
            for each in psutil.Process(process.pid).children(recursive=True):
                each.kill()
            process.kill()
            process.wait()


def test_a_killed_worker_changes_nothing(inputs, whole, tmp_path):
    with cluster(tmp_path) as address:
        running = start(inputs, tmp_path / "out", "--scheduler", address)
        wait_for_rows(tmp_path / "out", 2, running)
        (worker, *_) = [
            p for p in psutil.Process().children(recursive=True) if "spawn_main" in " ".join(p.cmdline())
        ]
        own = worker.children(recursive=True)
        assert own
        worker.kill()
        assert running.wait(timeout=HANG) == 4
        assert gone(own)
    pd.testing.assert_frame_equal(table(tmp_path / "out"), whole)
