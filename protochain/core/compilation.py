"""The compiler of all kernels, with its settings, which numba has for the whole process, and its cache.

Numba's own cache sees changes of a kernel's own file only, stops a program that can write nowhere, and may
mix up files if two processes compile one kernel at once. Here a kernel is compiled anew if any of its sources
has changed. One process compiles it while others wait, and caches the code in a folder with free space.

Numba also makes machine code and a wrapper for Python of every kernel. Here an inner kernel, which other
kernels call, has neither until Python calls it.
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
        from llvmlite import binding
        from numba import config
        from numba import njit as _njit
        from numba.core.caching import FunctionCache
        from numba.core.codegen import JITCodeLibrary, get_host_cpu_features
        from numba.core.compiler import Compiler, CompileResult
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


_COMPILING: list[bool] = []
"""Whether the kernels that are being compiled, each for the one before it, are inner ones. The lock of the
compiler protects the list."""


def njit(
    function: Callable[..., Any] | None = None, *, cache: bool = False, inner: bool = False, **options: Any
) -> Any:
    """Compile a function at its first call, as ``numba.njit`` does. Cache the code if ``cache``.

    A function that mostly kernels call is ``inner``. If Python calls it, too, it is compiled twice.
    """
    if function is None:
        return partial(njit, cache=cache, inner=inner, **options)
    # Nothing takes the address of a kernel: the wrapper for that would cost a twentieth of the time.
    by_options: Any = _njit
    kernel = by_options(no_cfunc_wrapper=True, pipeline_class=_Pipeline, **options)(function)
    store, by_numba, add = Store(function), kernel.compile, kernel.add_overload
    if cache:
        kernel._cache = store
    else:
        store.disable()
    kernel.compile = lambda signature: _compile(kernel, store, by_numba, inner, signature)
    kernel.add_overload = lambda compiled: _add(kernel, add, compiled)
    return kernel


@part("kernels")
def _compile(kernel: Any, store: "Store", by_numba: Callable[[Any], Any], inner: bool, signature: Any) -> Any:
    """Compile a kernel, or load it, once it is sure that no other process is compiling it."""
    with global_compiler_lock:
        outermost = not _COMPILING
        compiled = kernel.overloads.get(tuple(signature))
        if compiled is not None and not (outermost and compiled.library.is_inner):
            return compiled.entry_point
        kernel.overloads.pop(tuple(signature), None)
        _COMPILING.append(inner and not outermost)
        try:
            if store.has(signature, kernel.targetctx):
                return by_numba(signature)
            # The lock of the compiler first: a thread that waits for it must not hold what the compiling one
            # needs.
            with store.alone():
                if outermost and store.is_enabled and not store.has(signature, kernel.targetctx):
                    _announce(store.has_folder)
                    if store.has_folder:
                        compile_helpers.call_helpers(
                            f"{kernel.py_func.__module__} {kernel.py_func.__qualname__}",
                            Path(store.cache_path),
                        )
                with _without_collection():
                    return by_numba(signature)
        finally:
            _COMPILING.pop()


def _add(kernel: Any, by_numba: Callable[[Any], None], compiled: Any) -> None:
    """Add compiled code to a kernel, without its lines and types, which are large."""
    compiled.fndesc.typemap = compiled.fndesc.calltypes = None
    compiled = compiled._replace(type_annotation="", metadata=None)
    if not compiled.library.is_inner:
        # Environments of inner kernels, too.
        environments = tuple(compiled._find_referenced_environments())
        for environment in environments:
            compiled.codegen.set_env(environment.env_name, environment)
        by_numba(compiled._replace(referenced_envs=compiled.referenced_envs or environments))
        return
    if compiled.entry_point is None:
        compiled = compiled._replace(entry_point=object())
        kernel.targetctx.insert_user_function(compiled.entry_point, compiled.fndesc, [compiled.library])
    kernel.overloads[tuple(compiled.signature.args)] = compiled


class _Pipeline(Compiler):
    """Numba's compiler, with libraries of our class."""

    def compile_extra(self, func: Any) -> Any:
        self.state.library = _Library(self.state.targetctx.codegen(), func.__qualname__)
        is_inner = self.state.library.is_inner = _COMPILING[-1]
        if is_inner:
            self.state.flags.no_compile = self.state.flags.no_cpython_wrapper = True
        return super().compile_extra(func)


class _Library(JITCodeLibrary):
    """Code of a kernel and of those that it calls, machine code only if Python calls the kernel."""

    is_inner = False
    _bitcode = b""

    def __init__(self, codegen: Any, name: str) -> None:
        super().__init__(codegen, name)
        self.enable_object_caching()

    def _optimize_functions(self, ll_module: Any) -> None:
        """Optimise functions. Numba makes passes anew for each, and for those that are only declared."""
        ll_module.data_layout = self._codegen._data_layout
        passes, builder = self._codegen._function_pass_manager()
        for function in ll_module.functions:
            if not function.is_declaration:
                passes.run(function, builder)

    def _finalize_final_module(self) -> None:
        if self.is_inner:
            self._finalize_dynamic_globals()
            self._finalized = True
        else:
            super()._finalize_final_module()

    def _get_module_for_linking(self) -> Any:
        if self._bitcode and self._shared_module is None:
            self._shared_module = binding.parse_bitcode(self._bitcode)
        return super()._get_module_for_linking()

    def serialize_using_object_code(self) -> tuple[str, bytes, bytes]:
        """Return the name, the machine code, and the code to link."""
        bitcode = self._get_module_for_linking().as_bitcode()
        if self.is_inner:
            return self.name, b"", bitcode
        self._shared_module = None  # Rarely needed again.
        return self.name, self._get_compiled_object(), bitcode

    @classmethod
    def load(cls, codegen: Any, wrapper: str, name: str, machine_code: bytes, bitcode: bytes) -> "_Library":
        """Inverse of :meth:`serialize_using_object_code`. Code to link is read only when needed."""
        library = cls(codegen, name)
        library.is_inner, library._bitcode = not machine_code, bitcode
        if machine_code:
            library._set_compiled_object(machine_code)
            library._finalize_final_module()
            codegen._engine._defined_symbols.add(wrapper)
        library._finalized = True
        return library


class Store:
    """Cache of the compiled code of one kernel, which numba calls. Made on first use."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self._function = function
        self.is_enabled = True

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
        return self._key(signature, context) is not None

    def _key(self, signature: Any, context: Any) -> Any:
        """Key of compiled code in the cache, None without it."""
        if not (self.is_enabled and self.has_folder):
            return None
        try:
            index = self._files._cache_file._load_index()
        except Exception:  # A damaged file may raise anything; it is written anew.
            return None
        # Code for Python can be linked into other code, code of inner kernels cannot be called.
        for is_inner in (True, False) if _COMPILING and _COMPILING[-1] else (False,):
            key = *self._files._index_key(signature, context.codegen()), is_inner
            if key in index and (Path(self.cache_path) / index[key]).exists():
                return key
        return None

    def load_overload(self, signature: Any, context: Any) -> Any:
        """Compiled code, or None."""
        # Numba would also tell its compiler of all functions that it knows, for a tenth of a second; where it
        # compiles, it does so anyway. Loaded code needs no more than its memory manager.
        rtsys.initialize(context)
        key = self._key(signature, context)
        try:
            return key and self._load(key, context)
        except Exception as error:  # As above.
            _LOG.warning("%s: compiled code cannot be loaded (%s); compiling again", self.cache_path, error)
        return None

    def _load(self, key: Any, context: Any) -> Any:
        saved = self._files._cache_file.load(key)
        library, description, environment, types, _, lifted, annotation, initial, environments = saved
        for initialise in initial:
            initialise()
        code = _Library.load(context.codegen(), description.llvm_cpython_wrapper_name, *library)
        entry_point = object() if code.is_inner else context.get_executable(code, description, environment)
        for other in () if code.is_inner else environments:
            code.codegen.set_env(other.env_name, other)
        result: Any = CompileResult
        return result(
            typing_context=context.typing_context, target_context=context, entry_point=entry_point,
            typing_error=None, type_annotation=annotation, signature=types, objectmode=False, lifted=lifted,
            fndesc=description, library=code, call_helper=None, environment=environment, metadata=None,
            reload_init=initial, referenced_envs=environments,
        )  # fmt: skip

    def save_overload(self, signature: Any, compiled: Any) -> None:
        """Store compiled code. A full disk only loses it."""
        if not (self.is_enabled and self.has_folder and self._files._impl.check_cachable(compiled)):
            return
        key = *self._files._index_key(signature, compiled.codegen), compiled.library.is_inner
        saved = compiled._replace(type_annotation="")._reduce()
        try:
            self._files._cache_file.save(key, saved)
        except OSError as error:
            _LOG.info("%s: compiled code was not cached (%s)", self.cache_path, error.strerror)
        except Exception:
            # The index is damaged.
            with suppress(OSError):
                self._files.flush()
                self._files._cache_file.save(key, saved)

    @contextmanager
    def alone(self) -> Iterator[None]:
        """Hold this kernel, so that no other process compiles it too."""
        from filelock import Timeout

        with ExitStack() as stack:
            if self.is_enabled and self.has_folder:
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
        self.is_enabled = True

    def disable(self) -> None:
        """Compile without it."""
        self.is_enabled = False

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
