"""Signals that end a run: deferred while a result is at stake, passed on at other times."""

import os
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Thread, current_thread, main_thread
from types import FrameType
from typing import TypeVar

ENDING = ("SIGTERM", "SIGHUP", "SIGXCPU")
"""Signals that the command line treats as an interrupt: an end, a lost connection, a limit of CPU time."""
_SIGNALS = [signal.SIGINT, *(getattr(signal, name) for name in ENDING if hasattr(signal, name))]
_POLL = 0.1  # s between looks at a call that runs in another thread.

Result = TypeVar("Result")


def interrupt_on_signals() -> None:
    """Raise KeyboardInterrupt at these signals, except at those that the caller ignores, as nohup does."""
    for number in _SIGNALS:
        if signal.getsignal(number) is signal.SIG_DFL:
            signal.signal(number, signal.default_int_handler)


class _Noted(list[int]):
    """Signal handler that records the numbers of the signals it receives."""

    def __call__(self, number: int, frame: FrameType | None) -> None:
        self.append(number)
        for stream in (1, 2) if number == getattr(signal, "SIGHUP", None) else ():
            try:
                os.write(stream, b"")
            except OSError:  # The terminal is gone, and printing to it would end the run.
                os.dup2(os.open(os.devnull, os.O_WRONLY), stream)
        if number == getattr(signal, "SIGXCPU", None):
            signal.signal(number, signal.SIG_IGN)  # The system repeats it every second.


@contextmanager
def held_interrupts() -> Iterator[list[int]]:
    """Collect these signals in a list instead of KeyboardInterrupt. Nested calls share the outer list."""
    handlers = {number: signal.getsignal(number) for number in _SIGNALS}
    outer = next((handler for handler in handlers.values() if isinstance(handler, _Noted)), None)
    if outer is not None:
        yield outer
        return
    noted = _Noted()
    numbers_held = [number for number in _SIGNALS if handlers[number] is signal.default_int_handler]
    if current_thread() is not main_thread():
        numbers_held = []
    for number in numbers_held:
        signal.signal(number, noted)
    try:
        yield noted
    finally:
        for number in numbers_held:
            if signal.getsignal(number) is noted:
                signal.signal(number, signal.default_int_handler)


@contextmanager
def open_to_interrupts() -> Iterator[None]:
    """Raise KeyboardInterrupt at once within :func:`held_interrupts`, if no result would be lost."""
    holding = {
        number: handler for number in _SIGNALS if isinstance(handler := signal.getsignal(number), _Noted)
    }
    if any(holding.values()):
        raise KeyboardInterrupt
    # Signals and their handlers are the main thread's.
    if current_thread() is not main_thread():
        holding = {}
    try:
        for number in holding:
            signal.signal(number, signal.default_int_handler)
        yield
    finally:
        for number, handler in holding.items():
            signal.signal(number, handler)


def run_interruptible(call: Callable[[], Result], is_deferred: bool = False) -> Result:
    """Make a long call that lets other threads run, and let KeyboardInterrupt be raised meanwhile."""
    if current_thread() is not main_thread():
        return call()
    handlers = [signal.getsignal(number) for number in _SIGNALS] if is_deferred else []
    noted = next((handler for handler in handlers if isinstance(handler, _Noted)), _Noted())
    results: list[Result] = []
    errors: list[BaseException] = []

    def work() -> None:
        try:
            results.append(call())
        except BaseException as error:
            errors.append(error)

    thread = Thread(target=work, daemon=True)
    thread.start()
    while thread.is_alive():
        thread.join(_POLL)
        if noted and thread.is_alive():
            raise KeyboardInterrupt
    if errors:
        raise errors[0]
    return results[0]
