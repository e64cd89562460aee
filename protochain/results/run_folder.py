"""Files of a run: refusal of an earlier run, growing tables, and errors that report the saved files."""

import csv
import io
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from protochain.core.errors import Argument, ProtochainError, WriteError
from protochain.core.storage import writing

REPLACE = Argument("force", True), " replaces it"


def refuse_earlier(place: Path, run: str, *remedy: str | Argument) -> ProtochainError:
    """Return the error for a place with an earlier run, which ``resume`` continues."""
    return ProtochainError(
        f"{place}: contains {run}; ", Argument("resume", True), " continues it", *(remedy or (", ", *REPLACE))
    )


def refuse_existing(files: Iterable[Path | None]) -> None:
    """Raise if a further output exists, which ``force`` replaces."""
    for file in files:
        if file and file.exists():
            raise ProtochainError(f"{file}: exists. Give another output, or ", *REPLACE)


def checkpoint_of(table: Path) -> Path:
    """Return the path of the checkpoint of a growing table."""
    return table.with_name(f"{table.stem}.checkpoint.npz")


def remove_files(files: Iterable[Path]) -> None:
    """Remove the files that exist."""
    for file in files:
        file.unlink(missing_ok=True)


@contextmanager
def saving(path: Path, contents: str) -> Iterator[None]:
    """Report the saved data if the disk is full, and that the run can be resumed."""
    try:
        with writing(path):
            yield
    except WriteError as error:
        raise error.with_saved(contents, "continue with ", Argument("resume", True)) from error


def csv_text(
    columns: Sequence[str], rows: Iterable[Mapping[str, object]], header: bool = False, end: str = "\n"
) -> str:
    """Text of rows, by default without a header."""
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, extrasaction="ignore", lineterminator=end)
    if header:
        writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


class GrowingTable:
    """CSV of a run, to which rows are appended after the bytes in its checkpoint."""

    def __init__(self, path: Path, columns: Sequence[str], n_bytes: int = 0, end: str = "\n") -> None:
        self.columns, self.end = columns, end
        self._file = path.open("r+b" if n_bytes else "wb")
        self._file.seek(n_bytes)
        self._file.truncate()
        if not n_bytes:
            self._write(csv_text(columns, (), True, end))

    def append(self, row: Mapping[str, object]) -> None:
        """Write a row."""
        self._write(csv_text(self.columns, [row], end=self.end))

    def _write(self, text: str) -> None:
        # Names of files may not be UTF-8.
        self._file.write(text.encode(errors="backslashreplace"))
        self._file.flush()

    def sync(self) -> int:
        """Write all rows to the disk, and return the bytes of the table."""
        os.fsync(self._file.fileno())
        return self._file.tell()

    def close(self) -> None:
        """Close the file."""
        self._file.close()
