"""Deferral of SIGINT and SIGTERM while a run must not be interrupted."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from threading import current_thread, main_thread
from types import FrameType

_SIGNALS = (signal.SIGINT, signal.SIGTERM)


class _Noted(list[int]):
    """Signal handler that records the numbers of the signals it receives."""

    def __call__(self, number: int, frame: FrameType | None) -> None:
        self.append(number)


@contextmanager
def held_interrupts() -> Iterator[list[int]]:
    """Collect SIGINT and SIGTERM in a list instead of raising KeyboardInterrupt.

    A nested call yields the list of the outer one, with the signals already received.
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
