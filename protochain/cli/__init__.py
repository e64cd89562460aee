"""Parse, call, print. Heavy modules are imported when a command runs, so that --help is quick."""

import atexit
import errno
import gc
import io
import os
import signal
import sys
import warnings
from contextlib import redirect_stderr, redirect_stdout
from functools import cached_property
from importlib import import_module, metadata
from threading import Timer, main_thread
from typing import Annotated, Any

import typer
from typer.core import TyperGroup, TyperOption
from typer.exceptions import TyperException
from typer.main import get_command

from protochain.cli.help import Command
from protochain.cli.options import BAD_INPUT, INTERRUPTED, RENAMED, as_option, fail
from protochain.cli.printable import Printable
from protochain.core.errors import Argument, ProtochainError, WriteError
from protochain.core.interrupts import interrupt_on_signals

__all__ = ["main"]


_COMMANDS = {
    "minimise": "minimise", "relax": "relax", "compare": "compare", "batch": "batch", "simulate": "simulate",
    "modes": "modes", "validate": "validate", "score": "score", "energy": "energy", "rmsd": "rmsd",
    "info": "inspect", "build": "inspect", "mutate": "mutate", "scan": "scan",
    "search": "search", "ensemble": "ensemble", "schema": "schema",
}  # fmt: skip
"""Module of each command. A command has the name of its function."""
_NO_RESULT = "interrupted before there was a result"
_LATER = 0.05  # s.
_ALIASES = {"minimize": "minimise"}


class _Commands(TyperGroup):
    """Commands. Each is imported and built on request, as a run needs only one."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        del self.commands  # Typer's, which is empty.

    @cached_property
    def commands(self) -> dict[str, Any]:  # type: ignore[override]  # an attribute there
        return {name: _command(name) for name in (*_COMMANDS, *_ALIASES)}

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        return _command(cmd_name) if cmd_name in {*_COMMANDS, *_ALIASES} else None

    def invoke(self, ctx: Any) -> Any:
        """Run a command. Report interrupts, for which Typer would only return a status."""
        try:
            return super().invoke(ctx)
        except (KeyboardInterrupt, SystemError) as error:
            # Compiled code converts an unexpected interrupt to a SystemError.
            if not any(isinstance(cause, KeyboardInterrupt) for cause in (error, error.__cause__)):
                raise
            raise typer.Exit(fail(_NO_RESULT, INTERRUPTED)) from None


def _command(name: str) -> Any:
    function = _ALIASES.get(name, name)
    alone = typer.Typer(rich_markup_mode=None, add_completion=False, pretty_exceptions_enable=False)
    module = import_module(f"protochain.cli.{_COMMANDS[function]}")
    alone.command(name, cls=Command, hidden=name in _ALIASES)(getattr(module, function))
    return get_command(alone)


app = typer.Typer(cls=_Commands, rich_markup_mode=None, add_completion=False, pretty_exceptions_enable=False)


@app.callback(invoke_without_command=True)
def about(
    version: Annotated[
        bool, typer.Option("--version", help="Show the version and exit.", is_eager=True)
    ] = False,
) -> None:
    """Relax protein models, minimise their energy, and compare methods."""
    if version:
        print(f"protochain {metadata.version('protochain')}")
        raise typer.Exit


def message_of(error: ProtochainError) -> str:
    """Message of an error, with arguments as options if a command has them."""
    commands = map(_command, _COMMANDS)
    options = {param.name for cmd in commands for param in cmd.params if isinstance(param, TyperOption)}
    names = {*options, *(name for name, option in RENAMED.items() if option in options)}
    return error.render(
        lambda part: str(part) if isinstance(part, Argument) and part.name not in names else as_option(part)
    )


def _not_raised(lost: "sys.UnraisableHookArgs") -> None:
    """Repeat an interrupt that could not be raised, as in a finaliser, a bit later. Report other errors."""
    if lost.exc_type is KeyboardInterrupt:
        Timer(_LATER, signal.pthread_kill, (main_thread().ident, signal.SIGINT)).start()
    else:
        sys.__unraisablehook__(lost)


def main() -> None:
    """Run the command line. For bad input or usage, print one line on standard error and return status 2."""
    interrupt_on_signals()
    # Commands do not open windows, and do not use the threads of numexpr, which pandas imports.
    os.environ |= {"MPLBACKEND": "agg", "NUMEXPR_NUM_THREADS": "1"}
    sys.unraisablehook = _not_raised
    # By default Python collects garbage after each 700 new objects, also while 1700 modules are loaded. This
    # is a tenth of the time of a short run.
    gc.set_threshold(1_000_000, 20, 100)
    # No collection at the end, when all memory is released. This saves an eighth of a short run.
    atexit.register(gc.freeze)
    warnings.formatwarning = lambda message, *_: f"protochain: {message}\n"
    if len(sys.argv) == 1:
        sys.argv.append("--help")
    if None in (sys.stdin, sys.stdout, sys.stderr):
        # The next opened file would replace the closed stream, and receive the printed text.
        sys.stderr = sys.stderr or io.StringIO()
        sys.exit(fail("standard input, output or error is closed. Redirect it, as to /dev/null", BAD_INPUT))
    with redirect_stdout(Printable(sys.stdout)), redirect_stderr(Printable(sys.stderr)):
        sys.exit(_status())


def _status() -> int:
    """Run the command of the arguments, and return the exit status."""
    try:
        status = app(standalone_mode=False)
        sys.stdout.flush()
    except WriteError as error:
        return fail(message_of(error))
    except ProtochainError as error:
        return fail(message_of(error), BAD_INPUT)
    except TyperException as error:
        context = getattr(error, "ctx", None)
        command = f"protochain {context.info_name}" if context and context.parent else "protochain"
        return fail(f"{error.format_message().rstrip('.')}. See {command} --help.", BAD_INPUT)
    except (BrokenPipeError, SystemExit) as error:
        # If the reader has closed the pipe, Typer and rich would return 1.
        if BrokenPipeError not in map(type, (error, error.__context__)):
            raise
        _close_output()
        return 128 + signal.SIGPIPE  # As of programs that the signal ends.
    except OSError as error:
        if error.errno in _FULL and not error.filename:
            _close_output()
            return fail(f"standard output: not written ({error.strerror}), but all files are complete")
        if error.errno in _NO_WAY and error.filename:
            return fail(f"{error.filename}: cannot be reached ({error.strerror}). Check the name", BAD_INPUT)
        where = f"{error.filename}: " if error.filename else ""
        return fail(f"{where}{error.strerror or error}")
    except KeyboardInterrupt:
        return fail(_NO_RESULT, INTERRUPTED)
    return status if isinstance(status, int) else 0


_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)  # Errors of a full disk.
_NO_WAY = (errno.EACCES, errno.ENAMETOOLONG)
"""Errors of paths that cannot be reached, also by a test for existence."""


def _close_output() -> None:
    """Discard the buffer. At exit, Python would try to write it again and print a traceback."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
