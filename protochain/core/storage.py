"""Atomic writing of files, and folders of one process at a time."""

import errno
import hashlib
import json
import math
import os
import re
import shutil
import tempfile
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from threading import get_ident
from typing import Any
from uuid import uuid4

from protochain.core.errors import ProtochainError, WriteError, WriteWarning


def json_text(values: Any, indent: int | None = 2) -> str:
    """Text of values as JSON, which has no infinity: null if a number is not finite."""
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
    try:
        if path.is_dir():
            raise ProtochainError(f"{path}: is a folder; give the name of a file")
        regular(path)
        folder = next(parent for parent in path.absolute().parents if parent.exists())
        if not folder.is_dir():
            raise ProtochainError(f"{path}: {folder.name} is not a folder; give another name")
        longest = max(len(os.fsencode(name)) for name in path.absolute().relative_to(folder).parts)
        if longest > getattr(os, "pathconf", lambda *_: _LONGEST)(folder, "PC_NAME_MAX"):
            raise OSError(errno.ENAMETOOLONG, os.strerror(errno.ENAMETOOLONG))
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise ProtochainError(f"{path}: cannot be written ({error.strerror}); give another name") from None


_LONGEST = 255  # Bytes of the name of a file, on systems that do not report a limit.


def as_utf8(text: str) -> str:
    """Return a text as files have it: bytes of names that are not UTF-8 as ``repr`` has them."""
    return text.encode(errors="backslashreplace").decode()


def regular(path: Path) -> Path:
    """Return a path as it is, unless it is not a regular file: to read a pipe or a device may never end."""
    if path.exists() and not path.is_file():
        raise ProtochainError(f"{path}: is not a regular file; give a regular file")
    return path


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Name the file in errors of writing to it: the system's own errors name none, or a temporary one."""
    try:
        yield
    except OSError as error:
        raise WriteError(path, error) from error


def write_atomically(path: Path, write: Callable[[Path], object]) -> None:
    """Call ``write`` with a temporary path next to ``path``, then rename it: no file is ever half written."""
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        # Libraries take the format and the packing of a file from the end of its name.
        suffix = path.suffix if len(os.fsencode(path.suffix)) < _LONG_SUFFIX else ""
        # The system itself refuses to replace a folder.
        temporary = (path if path.is_dir() else regular(path)).with_name(f"{temporary_stem()}.part{suffix}")
        try:
            temporary.touch(exist_ok=False)
            write(temporary)
            temporary.replace(path)
        finally:
            temporary.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write text atomically as UTF-8. Names that are not UTF-8 have the other bytes as ``repr`` has them."""
    write_atomically(path, lambda to: to.write_text(text, encoding="utf-8", errors="backslashreplace"))


_LONG_SUFFIX = 100  # Bytes of a suffix that the name of a temporary file does not repeat.
_TEMPORARY = re.compile(r"\.protochain-[0-9a-f]{32}\w*\.part(\..+)?")
"""Names of temporary files and folders, which no other program and no user writes."""


def temporary_stem() -> str:
    """Return the first part of a new name of a temporary file or folder, before ``.part``."""
    return f".protochain-{uuid4().hex}"


@contextmanager
def claim_folder(folder: Path, kind: str, resume: bool = False) -> Iterator[None]:
    """Reserve a folder for one process. Make it, remove it if empty, and remove temporary files to resume."""
    folders = [parent for parent in (folder, *folder.absolute().parents) if not parent.exists()]
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    try:
        with _lock(folder / ".lock", f"{folder}: another {kind} is writing to this folder; choose another"):
            for path in folder.rglob(".protochain-*") if resume else ():
                if _TEMPORARY.fullmatch(path.name) and path.is_dir():
                    shutil.rmtree(path, ignore_errors=True)
                elif _TEMPORARY.fullmatch(path.name):
                    path.unlink(missing_ok=True)
            yield
    finally:
        with suppress(OSError):  # Results are there.
            for parent in folders:
                parent.rmdir()


@contextmanager
def claimed_files(*paths: Path) -> Iterator[None]:
    """Reserve output files that grow row by row for one process, by a lock file next to each of them."""
    with ExitStack() as locks:
        for path in sorted({path.absolute() for path in paths}):
            with writing(path):
                path.parent.mkdir(parents=True, exist_ok=True)
            digest = hashlib.sha256(os.fsencode(path.name)).hexdigest()[:32]
            refusal = f"{path}: another run is writing this file; give another name"
            locks.enter_context(_lock(path.with_name(f".protochain-{digest}.lock"), refusal))
        yield


_LOCKS: set[tuple[Path, int]] = set()  # Lock files that this process has locked, and the thread that did.


@contextmanager
def _lock(path: Path, refusal: str) -> Iterator[None]:
    """Lock a file and remove it at the end. Calls inside this context by the same thread have the lock."""
    owner = path.resolve(), get_ident()
    if owner in _LOCKS:
        yield
        return
    with writing(path):
        file = _open_locked(path, refusal)
    _LOCKS.add(owner)
    try:
        yield
    finally:
        _LOCKS.discard(owner)
        # Windows does not remove an open file.
        with suppress(PermissionError):
            path.unlink(missing_ok=True)
        os.close(file)


def _open_locked(path: Path, refusal: str) -> int:
    """Open and lock a file. Warn if the file system has no locks."""
    while True:
        file = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            # Windows has no such module.
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except (BlockingIOError, PermissionError):
            os.close(file)
            raise ProtochainError(refusal) from None
        except (ImportError, OSError) as error:
            problem = f"{path.parent}: this file system has no locks ({error})"
            warnings.warn(f"{problem}; do not start another run that writes here", WriteWarning, stacklevel=2)
            return file
        # The process that had the lock before may have removed this file.
        with suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(file), path.stat()):
                return file
        os.close(file)
