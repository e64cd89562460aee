"""Atomic writing of files, and checkpoints of arrays and plain values that cannot execute code."""

import json
import math
import os
import re
import tempfile
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from protochain.core.arrays import Floats
from protochain.core.errors import Argument, ProtochainError, WriteError


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
    """Refuse a path to which no file can be written."""
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


def write_arrays(
    path: Path, arrays: Mapping[str, np.ndarray], values: Any, settings: Mapping[str, Any]
) -> None:
    """Write a checkpoint (.npz): arrays, values that JSON can represent, and the settings of the run."""
    text = json.dumps({"settings": dict(settings), "values": values})

    def write(to: Path) -> None:
        with to.open("wb") as file:
            np.savez(file, allow_pickle=False, text=np.array(text), **arrays)

    write_atomically(path, write)


def read_arrays(
    path: Path, settings: Mapping[str, Any], kind: str, *remedy: str | Argument
) -> tuple[dict[str, np.ndarray], Any]:
    """Read a checkpoint that :func:`write_arrays` wrote for a run with the same settings."""
    try:
        with regular(path).open("rb") as stream, np.load(stream, allow_pickle=False) as file:
            check_sizes(file)
            arrays = dict(file)
        text = json.loads(str(arrays.pop("text")))
        written, values = {**text["settings"]}, text["values"]
    except FileNotFoundError:
        raise ProtochainError(f"{path}: not found; give the checkpoint of an earlier run") from None
    except PermissionError as error:
        raise ProtochainError(f"{path}: cannot be read ({error.strerror}); change its permissions") from None
    except _DAMAGED:
        raise ProtochainError(f"{path}: is no checkpoint of a {kind}; ", *remedy) from None
    if not {*list(settings)[:1]} <= set(written):
        raise ProtochainError(f"{path}: is no checkpoint of a {kind}; ", *remedy)
    for name, value in settings.items():
        if written.get(name) != value:
            raise ProtochainError(
                f"{path}: is of a run with ",
                Argument(name),
                f" {written.get(name)!r}, not {value!r}; repeat its settings",
            )
    return arrays, values


def fitting(arrays: Mapping[str, Any], name: str, shape: tuple[int, ...]) -> Floats:
    """Array of a checkpoint that a run can use."""
    found = arrays.get(name)
    if not isinstance(found, np.ndarray) or found.dtype != np.float64 or found.shape != shape:
        raise ValueError(f"{name} is not {shape} numbers")
    if not np.isfinite(found).all():
        raise ValueError(f"{name} is not finite")
    return found


@contextmanager
def undamaged(path: Path, *remedy: str | Argument) -> Iterator[None]:
    """Say of which checkpoint it is that something does not fit."""
    try:
        yield
    except (KeyError, IndexError, TypeError, AttributeError, ValueError) as error:
        what = f"{type(error).__name__}: {error}"
        raise ProtochainError(f"{path}: damaged checkpoint ({what}); ", *remedy) from None


_DAMAGED = (
    OSError, EOFError, AttributeError, ValueError, KeyError, TypeError, BadZipFile, RuntimeError, zlib.error,
    MemoryError,
)  # fmt: skip
"""What reading a damaged archive raises: by zipfile, by numpy, by json."""


def check_sizes(file: Any, packed: bool = False) -> None:
    """Refuse arrays that claim to be larger than what the archive holds of them: memory and time go first."""
    for member in file.zip.infolist():
        with file.zip.open(member) as stream:
            version = np.lib.format.read_magic(stream)
            head = (
                np.lib.format.read_array_header_1_0
                if version == (1, 0)
                else np.lib.format.read_array_header_2_0
            )
            shape, _, dtype = head(stream)
            claimed = math.prod(shape) * dtype.itemsize
            most = _DEFLATED * member.compress_size if packed else member.compress_size
            if claimed != member.file_size - stream.tell() or member.file_size > most:
                raise ValueError(f"{member.filename}: {claimed} bytes")


_DEFLATED = 1100
"""Bytes that one of a deflated file may become, at most."""
