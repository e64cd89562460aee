"""Atomic writing of files, and folders of one process at a time."""

import json
import math
import os
import re
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from protochain.core.errors import ProtochainError, WriteError


def json_text(values: Any, indent: int | None = 2) -> str:
    """Text of values as JSON, which has no infinity: null where a number is not finite."""
    return json.dumps(_finite(values), indent=indent, default=str, allow_nan=False)


def _finite(values: Any) -> Any:
    if isinstance(values, Mapping):
        return {key: _finite(value) for key, value in values.items()}
    if isinstance(values, list | tuple):
        return [_finite(value) for value in values]
    return None if isinstance(values, float) and not math.isfinite(values) else values


def check_writable(path: Path) -> None:
    """Refuse a path to which no file can be written, or none that is read again."""
    if any("\ud800" <= letter <= "\udfff" for letter in str(path)):
        raise ProtochainError(f"{ascii(str(path))[1:-1]}: its name is not UTF-8; give another name")
    if path.is_dir():
        raise ProtochainError(f"{path}: is a folder; give the name of a file")
    folder = next(parent for parent in path.absolute().parents if parent.exists())
    if not folder.is_dir():
        raise ProtochainError(f"{path}: {folder.name} is not a folder; give another name")
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise ProtochainError(f"{path}: cannot be written ({error.strerror}); give another name") from None


def regular(path: Path) -> Path:
    """Return a path as it is, unless what is there is no file: to read a pipe or a device may never end."""
    if path.exists() and not path.is_file():
        raise ProtochainError(f"{path}: is not a regular file; give the name of one")
    return path


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Name the file in errors of writing to it: the system's own errors name none, or a temporary one."""
    try:
        yield
    except OSError as error:
        raise WriteError(path, error.strerror or str(error)) from error


def write_atomically(path: Path, write: Callable[[Path], object]) -> None:
    """Call ``write`` with a temporary path beside ``path``, then rename it: no file is ever half written."""
    with writing(path):
        _write_atomically(path, write)


def write_text(path: Path, text: str) -> None:
    """Write text atomically, as UTF-8; of names that are none, other bytes as ``repr`` has them."""
    write_atomically(path, lambda to: to.write_text(text, encoding="utf-8", errors="backslashreplace"))


def _write_atomically(path: Path, write: Callable[[Path], object]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(prefix=f".{path.stem}.", suffix=path.suffix, dir=path.parent)
    os.close(handle)
    temporary = Path(name)
    try:
        write(temporary)
        # mkstemp makes private files; results get the usual permissions of a new file.
        mask = os.umask(0)
        os.umask(mask)
        temporary.chmod(0o666 & ~mask)
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


_TEMPORARY = re.compile(r"\..+\.([a-z0-9_]{8})\.\w+")
"""What :func:`_write_atomically` calls a file until it is whole."""


@contextmanager
def claimed(folder: Path, kind: str, resume: bool = False) -> Iterator[None]:
    """Hold a folder for one process, made and removed if empty; to resume, removes temporary files."""
    from filelock import FileLock, Timeout

    made = [each for each in (folder, *folder.absolute().parents) if not each.exists()]
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    lock = FileLock(folder / ".lock")
    try:
        lock.acquire(timeout=0)
    except Timeout:
        raise ProtochainError(f"{folder}: another {kind} is writing to this folder; give another") from None
    for path in folder.rglob(".*.????????.*") if resume else ():
        found = _TEMPORARY.fullmatch(path.name)
        # Of letters alone, as of .x.settings.json, only what is as private as mkstemp makes it.
        if found and path.is_file() and (not found[1].isalpha() or path.stat().st_mode & 0o077 == 0):
            path.unlink(missing_ok=True)
    try:
        yield
    finally:
        (folder / ".lock").unlink(missing_ok=True)
        lock.release()
        with suppress(OSError):  # Results are there.
            for each in made:
                each.rmdir()
