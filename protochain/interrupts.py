"""Signals noted while something that must not be broken off goes on."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def held_interrupts() -> Iterator[list[int]]:
    """Collect SIGINT and SIGTERM in a list, where they would raise KeyboardInterrupt."""
    caught: list[int] = []
    held = []
    if threading.current_thread() is threading.main_thread():
        held = [
            number
            for number in (signal.SIGINT, signal.SIGTERM)
            if signal.getsignal(number) is signal.default_int_handler
        ]
    for number in held:
        signal.signal(number, lambda which, _: caught.append(which))
    try:
        yield caught
    finally:
        for number in held:
            signal.signal(number, signal.default_int_handler)
