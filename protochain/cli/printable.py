"""Printed text. Names of files may contain terminal control codes, which are escaped."""

import os
import re
import sys
from typing import TYPE_CHECKING, Any, TextIO

if TYPE_CHECKING:
    from collections.abc import Iterable

    from rich.console import Console
    from rich.text import Text

_UNUSUAL = re.compile(r"[^\n\t -~]")


def printable(text: str) -> str:
    """Text with invisible characters, such as control characters, escaped as by ``repr``."""
    return _UNUSUAL.sub(lambda match: match[0] if match[0].isprintable() else ascii(match[0])[1:-1], text)


class Printable:
    """Stream that writes printable text to another stream."""

    def __init__(self, raw: TextIO) -> None:
        self.raw = raw

    def write(self, text: str) -> int:
        """Write text, like a stream."""
        self.raw.write(printable(text))
        return len(text)

    def writelines(self, lines: "Iterable[str]") -> None:
        """Write lines, like a stream."""
        for line in lines:
            self.write(line)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.raw, name)


def printer(stderr: bool = False) -> "Console":
    """Console of rich that writes its own control codes and escapes all others."""
    from rich.console import Console

    class Printing(Console):
        def render_str(self, text: str, **options: Any) -> "Text":
            # Before its width is measured.
            return super().render_str(printable(text), **options)

        def render(self, renderable: Any, options: Any = None) -> "Iterable[Any]":
            for segment in super().render(renderable, options):
                yield segment if segment.control else segment._replace(text=printable(segment.text))

    stream = sys.stderr if stderr else sys.stdout
    is_seen = stream.isatty() or "COLUMNS" in os.environ
    # In a pipe, each row is one line.
    return Printing(file=getattr(stream, "raw", stream), stderr=stderr, width=None if is_seen else 10_000)
