"""The compiler of all kernels, with its settings, which numba has for the whole process, and its cache.

Numba's own cache sees changes of a kernel's own file only, stops a program that can write nowhere, and may
mix up files if two processes compile one kernel at once. Here a kernel is compiled anew if any of its sources
has changed. One process compiles it while others wait, and caches the code in a folder with free space.
"""

import gc
import hashlib
import logging
import os
import stat
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import cache, cached_property, partial
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np

from protochain.core import compile_helpers
from protochain.core.errors import ProtochainError
from protochain.core.timings import part


@contextmanager
def _without_yaml() -> Iterator[None]:
    """Let imports fail to import yaml, without which numba does not open its file of settings."""
    loaded = sys.modules.get("yaml")
    sys.modules["yaml"] = None  # type: ignore[assignment]  # which Python takes for a module that is missing
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "A Numba config file is found")
            yield
    finally:
        del sys.modules["yaml"]
        if loaded is not None:
            sys.modules["yaml"] = loaded


try:
    with _without_yaml():
        from numba import config
        from numba import njit as _njit
        from numba.core.caching import FunctionCache
        from numba.core.codegen import get_host_cpu_features
        from numba.core.compiler_lock import global_compiler_lock
        from numba.core.runtime.nrt import rtsys
except ValueError as error:
    raise ProtochainError(
        f"numba cannot start ({error}); unset NUMBA_NUM_THREADS, or give a number"
    ) from None

__all__ = ["njit"]

_LOG = logging.getLogger(__name__)
_SETTINGS: Any = config
# Numba also takes settings from a file of this name in the current folder, with them the folder of compiled
# code, which is unpickled and run: that of somebody's structures is not to be trusted. The environment is.
# Another package may have imported numba before, with this file.
_SETTINGS._config_fname = os.devnull
_SETTINGS.reload_config()
# LLVM's superword-level vectoriser, off by default in numba, makes sweeps 1.4 times faster. Code rounds
# differently with and without it: set later than the first kernel is compiled, as by a module that not every
# program imports first, it would make results depend on the order of imports and calls.
_SETTINGS.SLP_VECTORIZE = 1
if _SETTINGS.DISABLE_JIT:
    raise ProtochainError("NUMBA_DISABLE_JIT is set, but kernels must be compiled; unset it")
# Vectors of eight doubles are 1.3 to 1.5 times faster than the four that LLVM prefers. NUMBA_CPU_... decide.
if _SETTINGS.CPU_NAME is None and _SETTINGS.CPU_FEATURES is None and "+avx512f" in get_host_cpu_features():
    _SETTINGS.CPU_FEATURES = get_host_cpu_features() + ",-prefer-256-bit"

PATIENCE = 120.0
"""s. Longest wait for a kernel that another process compiles, before this process compiles it too."""


def njit(function: Callable[..., Any] | None = None, *, cache: bool = False, **options: Any) -> Any:
    """Compile a function at its first call, as ``numba.njit`` does. Cache the code if ``cache``."""
    if function is None:
        return partial(njit, cache=cache, **options)
    # Nothing takes the address of a kernel: the wrapper for that would cost a twentieth of the time.
    by_options: Any = _njit
    kernel = by_options(no_cfunc_wrapper=True, **options)(function)
    if cache:
        kernel._cache = Store(function)
        by_numba = kernel.compile
        kernel.compile = lambda signature: _compile(kernel, by_numba, signature)
    return kernel


@part("kernels")
def _compile(kernel: Any, by_numba: Callable[[Any], Any], signature: Any) -> Any:
    """Compile a kernel, or load it, once it is sure that no other process is compiling it."""
    store = kernel._cache
    if tuple(signature) in kernel.overloads or store.has(signature, kernel.targetctx):
        return by_numba(signature)
    # Its own lock first: a thread that waits for it must not hold what the compiling one needs.
    with global_compiler_lock, store.alone():
        if not store.has(signature, kernel.targetctx):
            _announce(store.has_folder)
            if store.has_folder:
                compile_helpers.call_helpers(
                    f"{kernel.py_func.__module__} {kernel.py_func.__qualname__}", Path(store.cache_path)
                )
        with _without_collection():
            return by_numba(signature)


class Store:
    """Cache of the compiled code of one kernel, which numba calls. Made on first use."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self._function = function
        self._enabled = True

    @cached_property
    def _files(self) -> Any:
        """Numba's cache of files, None without a folder for them."""
        for folder in _folders(Path(self._function.__code__.co_filename).parent):
            before, _SETTINGS.CACHE_DIR = _SETTINGS.CACHE_DIR, folder
            try:
                files = FunctionCache(self._function)
            except (RuntimeError, OSError):
                continue
            finally:
                _SETTINGS.CACHE_DIR = before
            files._cache_file._source_stamp = _stamp(self._function)
            return files
        return None

    @property
    def has_folder(self) -> bool:
        """Whether there is a folder for compiled code."""
        return self._files is not None

    @property
    def cache_path(self) -> str:
        """Folder of the files."""
        return str(self._files.cache_path) if self.has_folder else ""

    def has(self, signature: Any, context: Any) -> bool:
        """Whether compiled code is in the cache. Numba's context has the processor."""
        if not (self._enabled and self.has_folder):
            return False
        key = self._files._index_key(signature, context.codegen())
        try:
            name = self._files._cache_file._load_index().get(key)
        except Exception:  # A damaged file may raise anything; it is written anew.
            return False
        return name is not None and (Path(self.cache_path) / name).exists()

    def load_overload(self, signature: Any, context: Any) -> Any:
        """Compiled code, or None."""
        # Numba would also tell its compiler of all functions that it knows, for a tenth of a second; where it
        # compiles, it does so anyway. Loaded code needs no more than its memory manager.
        rtsys.initialize(context)
        if self._enabled and self.has_folder:
            with suppress(Exception):  # As above.
                return self._files._load_overload(signature, context)
        return None

    def save_overload(self, signature: Any, compiled: Any) -> None:
        """Store compiled code. A full disk only loses it."""
        if self._enabled and self.has_folder:
            try:
                self._files.save_overload(signature, compiled)
            except OSError as error:
                _LOG.info("%s: compiled code was not cached (%s)", self.cache_path, error.strerror)
            except Exception:
                # The index is damaged.
                with suppress(OSError):
                    self._files.flush()
                    self._files.save_overload(signature, compiled)

    @contextmanager
    def alone(self) -> Iterator[None]:
        """Hold this kernel, so that no other process compiles it too."""
        from filelock import Timeout

        with ExitStack() as stack:
            if self.has_folder:
                # Not all file systems have locks: then the code is compiled twice, and no file half written.
                with suppress(Timeout, OSError, RuntimeError):
                    stack.enter_context(self._lock.acquire(PATIENCE, poll_interval=0.02))
            yield

    def try_alone(self) -> bool:
        """Hold this kernel, unless another process does."""
        from filelock import Timeout

        try:
            self._lock.acquire(0)
        except (Timeout, OSError, RuntimeError):
            return False
        return True

    def release(self) -> None:
        """End what :meth:`try_alone` began."""
        self._lock.release()

    @cached_property
    def _lock(self) -> Any:
        from filelock import FileLock

        return FileLock(Path(self.cache_path) / f"{self._files._impl.filename_base}.lock")

    def enable(self) -> None:
        """Use the cache."""
        self._enabled = True

    def disable(self) -> None:
        """Compile without it."""
        self._enabled = False

    def flush(self) -> None:
        """Remove the compiled code."""
        if self.has_folder:
            self._files.flush()


def _folders(source: Path) -> Iterator[str]:
    """Folders for compiled code in numba's order: NUMBA_CACHE_DIR, __pycache__ (""), the user's cache."""
    # Without a home numba would make a folder named ~ where the program runs.
    home = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~")  # noqa: PTH111  # pathlib raises then
    cache_folder = source / "__pycache__"
    writable = os.access(cache_folder if cache_folder.exists() else source, os.W_OK)
    if _SETTINGS.CACHE_DIR or writable or Path(home).is_absolute():
        yield _SETTINGS.CACHE_DIR
    temporary = _temporary()
    if temporary:
        yield temporary


@cache
def _temporary() -> str:
    """Folder for temporary files of this user alone, because the program runs code from it."""
    try:
        folder = Path(tempfile.gettempdir()) / f"protochain-{getattr(os, 'getuid', lambda: 'kernels')()}"
        folder.mkdir(mode=0o700, exist_ok=True)
        status = folder.lstat()
        private = not hasattr(os, "getuid") or (status.st_uid == os.getuid() and not status.st_mode & 0o077)
        return str(folder) if stat.S_ISDIR(status.st_mode) and private else ""
    except OSError:
        return ""


def _stamp(function: Callable[..., Any]) -> str:
    """Digest of the sources of a kernel: its file, the files of kernels that it calls, and constants."""
    digest = hashlib.sha256(repr(_SETTINGS.SLP_VECTORIZE).encode())
    files: set[str] = set()
    constants: set[str] = set()
    _collect(function, files, constants, set())
    for file in sorted(files):
        digest.update(_digest_of(file))
    for constant in sorted(constants):
        digest.update(constant.encode())
    return digest.hexdigest()


@cache
def _digest_of(file: str) -> bytes:
    try:
        return hashlib.sha256(Path(file).read_bytes()).digest()
    except OSError:
        return file.encode()


def _collect(function: Any, files: set[str], constants: set[str], seen: set[Any]) -> None:
    """Add the sources of a function, and the functions that it calls."""
    if function in seen:
        return
    seen.add(function)
    files.add(function.__code__.co_filename)
    names = _names(function.__code__)
    values = [(name, function.__globals__[name]) for name in names if name in function.__globals__]
    for _, module in list(values):
        if isinstance(module, ModuleType) and module.__name__.startswith("protochain"):
            values += [(name, getattr(module, name)) for name in names if hasattr(module, name)]
    for name, value in values:
        # Kernels, intrinsics, and functions that numba compiles in place.
        callee = getattr(value, "py_func", None) or getattr(value, "_defn", None) or value
        if isinstance(callee, FunctionType) and callee.__module__.split(".")[0] not in ("numba", "numpy"):
            _collect(callee, files, constants, seen)
        elif isinstance(value, np.ndarray):
            constants.add(f"{name} {value.dtype} {value.shape} {value.tobytes().hex()}")
        elif isinstance(value, int | float | str | tuple):
            constants.add(f"{name} {value!r}")


def _names(code: CodeType) -> set[str]:
    """Global names and attributes that code reads, also in nested functions."""
    return set(code.co_names).union(*(_names(c) for c in code.co_consts if isinstance(c, CodeType)))


@contextmanager
def _without_collection() -> Iterator[None]:
    """Compile without garbage collection, which needs a tenth of the time and frees little."""
    was = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was:
            gc.enable()


@cache
def _announce(is_cached: bool) -> None:
    """Report the reason why the first run waits."""
    if compile_helpers.is_helper():
        return
    if is_cached:
        _LOG.warning("compiling kernels for this machine; later runs reuse them")
    else:
        _LOG.warning(
            "compiling kernels in every run: no cache folder is writable; set NUMBA_CACHE_DIR to one that is"
        )
