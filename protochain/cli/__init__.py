"""Parse, call, print. Heavy imports wait until a command runs, so that --help answers at once."""

import signal
import sys

import typer
from typer.exceptions import TyperException

from protochain.cli.batch import batch
from protochain.cli.bench import bench
from protochain.cli.compare import compare
from protochain.cli.inspect import build, info
from protochain.cli.minimise import minimise
from protochain.cli.options import BAD_INPUT, fail
from protochain.cli.rmsd import rmsd
from protochain.cli.simulate import simulate
from protochain.errors import ProtochainError

__all__ = ["main"]

_INTERRUPTED = 130

app = typer.Typer(
    help="Minimise the energy of protein chains, and compare how.",
    rich_markup_mode=None,
    add_completion=False,
    pretty_exceptions_enable=False,
)

for command in (minimise, compare, batch, simulate, rmsd, bench, info, build):
    app.command()(command)
app.command("minimize", hidden=True)(minimise)


def main() -> None:
    """Run the command line: one line on standard error and status 2 for bad input or usage."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    if len(sys.argv) == 1:
        sys.argv.append("--help")
    try:
        status = app(standalone_mode=False)
        # What Typer makes of a KeyboardInterrupt, without a word.
        if status == _INTERRUPTED:
            raise KeyboardInterrupt
    except ProtochainError as error:
        status = fail(str(error), BAD_INPUT)
    except TyperException as error:
        status = fail(f"{error.format_message()} See protochain --help.", BAD_INPUT)
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        status = fail(f"{where}{error.strerror or error}")
    except KeyboardInterrupt:
        status = fail("interrupted before there was a result")
    sys.exit(status if isinstance(status, int) else 0)
