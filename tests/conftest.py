"""What is set for all tests: threads that do not spin, and handlers of signals."""

import os
import signal

# Threads of several test processes that spin while they wait take the cores from one another.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

import pytest


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
