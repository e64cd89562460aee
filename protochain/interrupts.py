"""Signals noted while something that must not be broken off goes on."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from threading import current_thread, main_thread
from types import FrameType

_SIGNALS = (signal.SIGINT, signal.SIGTERM)


class _Noted(list[int]):
    """A signal handler that appends the signal's number to itself."""

    def __call__(self, number: int, frame: FrameType | None) -> None:
        self.append(number)


@contextmanager
def held_interrupts() -> Iterator[list[int]]:
    """Collect SIGINT and SIGTERM in a list, where they would raise KeyboardInterrupt.

    Within another hold the list is that hold's own: what has been noted there stays noted.
    """
    handlers = {number: signal.getsignal(number) for number in _SIGNALS}
    outer = next((handler for handler in handlers.values() if isinstance(handler, _Noted)), None)
    if outer is not None:
        yield outer
        return
    noted = _Noted()
    held = [number for number in _SIGNALS if handlers[number] is signal.default_int_handler]
    if current_thread() is not main_thread():
        held = []
    for number in held:
        signal.signal(number, noted)
    try:
        yield noted
    finally:
        for number in held:
            signal.signal(number, signal.default_int_handler)
