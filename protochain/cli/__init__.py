"""Parse, call, print. Heavy imports wait until a command runs, so that --help answers at once."""

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
"""Name of each command, which is that of its function, and the module that has it."""
_NO_RESULT = "interrupted before there was a result"
_LATER = 0.05  # s.
_ALIASES = {"minimize": "minimise"}


class _Commands(TyperGroup):
    """Commands, each of which is imported and built when it is asked for: one run needs one."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        del self.commands  # Of Typer, which knows of none.

    @cached_property
    def commands(self) -> dict[str, Any]:  # type: ignore[override]  # an attribute there
        """All commands by name."""
        return {name: _command(name) for name in (*_COMMANDS, *_ALIASES)}

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """One command; None if there is none of that name."""
        return _command(cmd_name) if cmd_name in {*_COMMANDS, *_ALIASES} else None

    def invoke(self, ctx: Any) -> Any:
        """Run a command, of which Typer would return the status of an interrupt without a word."""
        try:
            return super().invoke(ctx)
        except (KeyboardInterrupt, SystemError) as error:
            # SystemError is what compiled code makes of one that it did not expect.
            if not any(isinstance(cause, KeyboardInterrupt) for cause in (error, error.__cause__)):
                raise
            raise typer.Exit(fail(_NO_RESULT, INTERRUPTED)) from None


def _command(name: str) -> Any:
    function = _ALIASES.get(name, name)
    alone = typer.Typer(rich_markup_mode=None, add_completion=False, pretty_exceptions_enable=False)
    module = import_module(f"protochain.cli.{_COMMANDS[function]}")
    alone.command(name, cls=Command, hidden=name in _ALIASES)(getattr(module, function))
    return get_command(alone)


app = typer.Typer(
    cls=_Commands,
    rich_markup_mode=None,
    add_completion=False,
    pretty_exceptions_enable=False,
)


@app.callback(invoke_without_command=True)
def about(
    version: Annotated[
        bool, typer.Option("--version", help="Show the version, and stop.", is_eager=True)
    ] = False,
) -> None:
    """Minimise the energy of protein chains, and compare how."""
    if version:
        print(f"protochain {metadata.version('protochain')}")
        raise typer.Exit


def message_of(error: ProtochainError) -> str:
    """Message of an error in the words of the command line, where some command has the option."""
    commands = map(_command, _COMMANDS)
    options = {param.name for cmd in commands for param in cmd.params if isinstance(param, TyperOption)}
    names = {*options, *(name for name, option in RENAMED.items() if option in options)}
    return error.told(
        lambda part: str(part) if isinstance(part, Argument) and part.name not in names else as_option(part)
    )


def _not_raised(lost: "sys.UnraisableHookArgs") -> None:
    """Interrupt again, a little later, where nothing could be raised, as in a finaliser; tell all else."""
    if lost.exc_type is KeyboardInterrupt:
        Timer(_LATER, signal.pthread_kill, (main_thread().ident, signal.SIGINT)).start()
    else:
        sys.__unraisablehook__(lost)


def main() -> None:
    """Run the command line: one line on standard error and status 2 for bad input or usage."""
    interrupt_on_signals()
    # No command opens a window, and no thread of numexpr, which pandas imports, computes anything.
    os.environ |= {"MPLBACKEND": "agg", "NUMEXPR_NUM_THREADS": "1"}
    sys.unraisablehook = _not_raised
    # By default Python looks for garbage after each 700 new objects, also while 1700 modules are loaded: a
    # tenth of the time of a short run.
    gc.set_threshold(1_000_000, 20, 100)
    # Nor does it look for any at the end, where all memory is given back anyway: an eighth of a short run.
    atexit.register(gc.freeze)
    warnings.formatwarning = lambda message, *_: f"protochain: {message}\n"
    if len(sys.argv) == 1:
        sys.argv.append("--help")
    if None in (sys.stdin, sys.stdout, sys.stderr):
        # The next file opened would take the place of the closed stream, and get what is printed.
        sys.stderr = sys.stderr or io.StringIO()
        sys.exit(fail("standard input, output or error is closed; give it a file, or /dev/null", BAD_INPUT))
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
        # Where nobody reads on, Typer and rich would end with 1.
        if BrokenPipeError not in map(type, (error, error.__context__)):
            raise
        _close_output()
        return 128 + signal.SIGPIPE  # As of programs that the signal ends.
    except OSError as error:
        if error.errno in _FULL and not error.filename:
            _close_output()
            return fail(f"standard output: not written ({error.strerror}); all files are complete")
        if error.errno in _NO_WAY and error.filename:
            return fail(f"{error.filename}: cannot be reached ({error.strerror}); check the name", BAD_INPUT)
        where = f"{error.filename}: " if error.filename else ""
        return fail(f"{where}{error.strerror or error}")
    except KeyboardInterrupt:
        return fail(_NO_RESULT, INTERRUPTED)
    return status if isinstance(status, int) else 0


_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)
"""What a disk says that takes no more."""
_NO_WAY = (errno.EACCES, errno.ENAMETOOLONG)
"""What the system says of a name that leads nowhere, whoever asks: even whether a file is there."""


def _close_output() -> None:
    """Let what is left in the buffer vanish: at its end Python would try once more, and say so at length."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
