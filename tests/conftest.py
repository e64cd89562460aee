"""What is set for all tests: threads that do not spin, handlers of signals, a browser, the command line."""

import ctypes
import gc
import os
import shutil
import signal
import subprocess
import sys
from collections import Counter
from types import SimpleNamespace
from typing import NamedTuple

# Threads of several test processes that spin while they wait take the cores from one another.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

import pytest
from fixtures.jobs import jobs_here, jobs_in_processes
from fixtures.waiting import HANG

THRESHOLD = gc.get_threshold()

LONG = {
    "test_blocks.py", "test_files.py", "test_gear.py", "test_interface.py", "test_hetero_molecules.py",
    "test_notebooks.py", "test_report.py", "test_schema.py", "test_tree.py",
}  # fmt: skip
"""Files that take half a minute, many of them with few tests."""


def pytest_configure(config):
    """Of pytest-xdist: files in the order below, and not of most tests first."""
    config.option.loadscopereorder = False


@pytest.hookimpl(tryfirst=True)
def pytest_sessionstart(session):
    """Compile kernels before workers start: one that compiles those of an energy stays 200 MB larger."""
    from protochain.core.compile_helpers import _HELPER
    from protochain.core.processors import own_python, processors

    if not getattr(session.config.option, "numprocesses", None) or hasattr(session.config, "workerinput"):
        return
    command = own_python("from protochain.core.compile_helpers import help_out; help_out()")
    helpers = [
        subprocess.Popen(command, env=os.environ | {_HELPER: str(k)}) for k in range(1, processors() + 1)
    ]
    for helper in helpers:
        helper.wait()


def pytest_collection_finish(session):
    """What all files have imported is no garbage, and need not be looked at after each."""
    gc.collect()
    gc.freeze()


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config, items):
    """Side by side, long files come first and those of few tests last: none works on alone."""
    if hasattr(config, "workerinput"):
        size = Counter(item.path for item in items)
        items.sort(key=lambda item: (item.path.name not in LONG, -size[item.path]))


@pytest.fixture(autouse=True)
def collection():
    """Collect garbage as Python does: a command almost ends that in its process, and a worker would grow."""
    yield
    gc.set_threshold(*THRESHOLD)


@pytest.fixture(scope="module", autouse=True)
def collected():
    """Collect the cyclic garbage of a file: its figures and chains are few objects with large arrays."""
    yield
    # The whole dictionary of components, as biotite reads it for some tests, takes 1.5 GB.
    if (dictionary := sys.modules.get("biotite.structure.info.ccd")) is not None:
        dictionary.get_ccd.cache_clear()
    gc.collect()
    # The C library keeps freed memory, some 100 MB after a file that compiles: it goes back to the system.
    if (trim := getattr(ctypes.CDLL(None), "malloc_trim", None)) is not None:
        trim(0)


@pytest.fixture(scope="module", autouse=True)
def jobs():
    """Jobs of batches run in this process, but for tests with ``worker_processes``."""
    with jobs_here():
        yield


@pytest.fixture
def worker_processes():
    """Jobs of batches have processes of their own, as users have them."""
    with jobs_in_processes():
        yield


@pytest.fixture
def interruptible():
    """Interrupts as the command line has them."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    assert signal.signal(signal.SIGINT, before) is signal.default_int_handler


@pytest.fixture
def signals(monkeypatch):
    """Handlers as Python sets them up, whatever this process was started with."""
    numbers = (signal.SIGINT, signal.SIGTERM)
    before = [signal.signal(number, signal.default_int_handler) for number in numbers]
    yield
    assert [signal.getsignal(number) for number in numbers] == [signal.default_int_handler] * 2
    for number, handler in zip(numbers, before, strict=True):
        signal.signal(number, handler)


@pytest.fixture
def browser(started_browser):
    """Chromium; pages that a test opens are closed behind it, or they would go on drawing."""

    def new_page(**options):
        page = started_browser.new_page(**options)
        page.set_default_timeout(1000 * HANG)
        return page

    yield SimpleNamespace(new_page=new_page)
    for context in started_browser.contexts:
        context.close()


@pytest.fixture(scope="module")
def started_browser():
    """Chromium, started once for a file of tests."""
    chromium = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if chromium is None:
        pytest.skip("no chromium on this machine")
    from playwright.sync_api import Error, sync_playwright

    # For machines without a display, a graphics card, or a user of their own.
    flags = [
        "--no-sandbox", "--disable-dev-shm-usage", "--use-gl=angle", "--use-angle=swiftshader",
        "--enable-unsafe-swiftshader",
    ]  # fmt: skip
    with sync_playwright() as driver:
        try:
            started = driver.chromium.launch(executable_path=chromium, args=flags)
        except Error as error:
            pytest.skip(f"chromium does not start here: {str(error).splitlines()[0]}")
        yield started


class Done(NamedTuple):
    """How a command ended, as of a process."""

    returncode: int
    stdout: str
    stderr: str


@pytest.fixture
def protochain(tmp_path, monkeypatch, capsys):
    """Run a command in an empty folder, in this process: one of its own takes over a second to start."""
    from protochain.cli import main

    monkeypatch.chdir(tmp_path)
    before = signal.getsignal(signal.SIGTERM)

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["protochain", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            main()
        return Done(ended.value.code or 0, *capsys.readouterr())

    yield run
    signal.signal(signal.SIGTERM, before)
