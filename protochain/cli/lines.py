"""Lines of the terminal. ``--quiet`` and ``--verbose`` select the kinds of lines to print."""

import inspect
import sys
from collections.abc import Callable, Iterable, Sequence
from enum import Enum, IntEnum
from functools import wraps
from typing import Annotated, Any

import typer

from protochain.core.errors import ProtochainError


class Detail(IntEnum):
    """Amount of printed text."""

    QUIET = 0
    SHORT = 1
    VERBOSE = 2


class Kind(Enum):
    """Kinds of lines, with the least detail that prints them, and whether they go to standard error."""

    READ = Detail.SHORT, True
    WARNING = Detail.SHORT, True
    PROGRESS = Detail.SHORT, True
    CHANGE = Detail.VERBOSE, True
    RESULT = Detail.SHORT, False
    MORE = Detail.VERBOSE, False  # Details of a result.
    VERDICT = Detail.QUIET, False
    WRITTEN = Detail.SHORT, False


_WARNINGS = 5  # Most warnings and remarks that need action. ``--verbose`` prints all.
_RESIDUES = 5  # Residues of a kind in the short list of remaining errors.
_RESIDUES_VERBOSE = 6
_LARGEST_ENERGY = 1e6  # kJ/mol. Only structures with overlapping atoms have more.
OVERLAPPING = "> 1e6 (overlapping atoms)"

_detail = Detail.VERBOSE  # Commands without the options print all.


def with_detail(command: Callable[..., None]) -> Callable[..., None]:
    """Add ``--verbose`` and ``--quiet`` to a command."""
    quiet = typer.Option("--quiet", help="Print the verdict and errors only.")
    verbose = typer.Option("--verbose", help="Print all changes, warnings and details.")
    detail_options = [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=False, annotation=Annotated[bool, of])
        for name, of in (("verbose", verbose), ("quiet", quiet))
    ]

    @wraps(command)
    def run(*arguments: Any, verbose: bool = False, quiet: bool = False, **options: Any) -> None:
        global _detail
        if verbose and quiet:
            raise ProtochainError("--verbose and --quiet exclude each other")
        before = _detail
        _detail = Detail.VERBOSE if verbose else Detail.QUIET if quiet else Detail.SHORT
        try:
            command(*arguments, **options)
        finally:
            _detail = before

    signature = inspect.signature(command)
    run.__signature__ = signature.replace(parameters=[*signature.parameters.values(), *detail_options])  # type: ignore[attr-defined]  # known at run time only
    return run


def prints(kind: Kind) -> bool:
    """Whether lines of a kind are printed."""
    return _detail >= kind.value[0]


def is_verbose() -> bool:
    """Whether all lines are printed."""
    return _detail is Detail.VERBOSE


def tell(kind: Kind, *lines: str) -> None:
    """Print lines of a kind."""
    if prints(kind):
        for line in lines:
            print(line, file=sys.stderr if kind.value[1] else sys.stdout)


def warn(lines: Iterable[str]) -> None:
    """Print warnings that need action, at most five without ``--verbose``."""
    all_lines = [*lines]
    shown = all_lines if is_verbose() else all_lines[:_WARNINGS]
    tell(Kind.WARNING, *shown)
    if len(shown) < len(all_lines):
        tell(Kind.WARNING, f"and {len(all_lines) - len(shown)} more (--verbose)")


def residues_shown() -> int:
    """Return the number of named residues for each kind of error."""
    return _RESIDUES_VERBOSE if is_verbose() else _RESIDUES


def energy_text(text: str, value: Any) -> str:
    """Return the text of an energy, kJ/mol. Large energies are reported as overlapping atoms."""
    return OVERLAPPING if isinstance(value, float) and value > _LARGEST_ENERGY else text


def table_of_two(rows: Sequence[tuple[str, str, str]]) -> None:
    """Print names with their values before and after."""
    names, *values = (max(map(len, column), default=0) for column in zip(*rows, strict=True))
    before, after = (max(12, wide) for wide in values)
    for label, first, last in [("", "before", "after"), *rows]:
        tell(Kind.RESULT, f"{label:{names}} {first:>{before}} {last:>{after}}")
