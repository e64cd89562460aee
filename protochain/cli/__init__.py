"""Parse, call, print. Heavy imports wait until a command runs, so that --help answers at once."""

import atexit
import errno
import gc
import math
import os
import re
import signal
import sys
from importlib import metadata
from inspect import signature
from typing import Annotated

import typer
from typer.exceptions import TyperException

from protochain.cli.batch import batch
from protochain.cli.bench import bench, scene
from protochain.cli.compare import compare
from protochain.cli.inspect import build, info
from protochain.cli.minimise import minimise
from protochain.cli.options import BAD_INPUT, fail, with_options
from protochain.cli.relax import relax
from protochain.cli.rmsd import rmsd
from protochain.cli.simulate import simulate
from protochain.cli.terminal import in_commands
from protochain.cli.validate import validate
from protochain.errors import ProtochainError, WriteError

__all__ = ["main"]

_INTERRUPTED = 130

app = typer.Typer(
    help="Minimise the energy of protein chains, and compare how.",
    rich_markup_mode=None,
    add_completion=False,
    pretty_exceptions_enable=False,
)

_COMMANDS = (minimise, relax, compare, batch, simulate, validate, rmsd, bench, scene, info, build)


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


for command in _COMMANDS:
    app.command()(command)
app.command("minimize", hidden=True)(minimise)


_RENAMED = {"n_steps": "steps", "n_starts": "starts", "hop_temperature": "hop"}
"""Options with other names than the arguments of the library."""

_SPREAD = re.compile(r"\bspread (\S+): give an angle above 0, in rad\b")
_RESTRAINT = re.compile(r"(^|: )restraint(?= )")
"""Names that are also words, where they are arguments: the one in rad, where the option is in degrees."""


def as_options(message: str) -> str:
    """Message of the library, which names its arguments, in the words of the command line."""
    options = {name for each in _COMMANDS for name in signature(each).parameters if "_" in name}
    names = "|".join(sorted({*options, *_RENAMED}, key=len, reverse=True))
    message = _RESTRAINT.sub(r"\1--restrain", with_options(message))
    message = _SPREAD.sub(
        lambda m: f"--spread {math.degrees(float(m[1])):g}: give an angle above 0, in degrees", message
    )
    # Not in paths and other names.
    found = re.compile(rf"(?<![\w/.'-])(?:(\w+)=True|({names}))(?![\w/'-]|\.\w)")
    named = found.sub(lambda m: f"--{_RENAMED.get(m[2], m[1] or m[2]).replace('_', '-')}", message)
    return in_commands(named)


def main() -> None:
    """Run the command line: one line on standard error and status 2 for bad input or usage."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    # By default Python looks for garbage after each 700 new objects, also while 1700 modules are loaded: a
    # tenth of the time of a short run.
    gc.set_threshold(100_000, 20, 100)
    # Nor does it look for any at the end, where all memory is given back anyway: an eighth of a short run.
    atexit.register(gc.freeze)
    if len(sys.argv) == 1:
        sys.argv.append("--help")
    try:
        status = app(standalone_mode=False)
        # What Typer makes of a KeyboardInterrupt, without a word.
        if status == _INTERRUPTED:
            raise KeyboardInterrupt
        sys.stdout.flush()
    except WriteError as error:
        status = fail(as_options(str(error)))
    except ProtochainError as error:
        status = fail(as_options(str(error)), BAD_INPUT)
    except TyperException as error:
        context = getattr(error, "ctx", None)
        command = f"protochain {context.info_name}" if context and context.parent else "protochain"
        status = fail(f"{error.format_message().rstrip('.')}. See {command} --help.", BAD_INPUT)
    except BrokenPipeError:
        _close_output()
        status = 128 + signal.SIGPIPE  # As of programs that the signal ends.
    except OSError as error:
        if error.errno in _FULL and not error.filename:
            _close_output()
            status = fail(f"standard output: not written ({error.strerror}); all files are complete")
        else:
            where = f"{error.filename}: " if error.filename else ""
            status = fail(f"{where}{error.strerror or error}")
    except KeyboardInterrupt:
        status = fail("interrupted before there was a result")
    sys.exit(status if isinstance(status, int) else 0)


_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)
"""What a disk says that takes no more."""


def _close_output() -> None:
    """Let what is left in the buffer vanish: at its end Python would try once more, and say so at length."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
