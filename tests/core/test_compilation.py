"""Kernels: compiled once, anew when anything they are made of changed, kept wherever there is room."""

import importlib.util
import logging
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from filelock import FileLock
from fixtures.samples import ROOT, STRUCTURES
from fixtures.waiting import HANG
from kernels import text_of
from numba import types
from numba.core.caching import IndexDataCacheFile

from protochain.core import compilation, compile_helpers
from protochain.core.compilation import njit
from protochain.core.processors import own_python
from protochain.mechanics.multibody import algebra

CALLEE = """
from protochain.core.compilation import njit

@njit(cache=True, inner=True)
def part(x):
    return x + {step}
"""
CALLER = """
import sys
import numpy as np
from protochain.core.compilation import njit
from callee_{name} import part
FACTOR = {factor}
TABLE = np.full(3, {entry})

@njit(cache=True)
def whole(x):
    return FACTOR * part(x) + TABLE[0]

if __name__ == "__main__":
    print(whole(1.0), sum(whole.stats.cache_misses.values()))
"""


@pytest.fixture
def sources(tmp_path, monkeypatch):
    """Two files with a kernel each, the second of which calls the first; ``write`` changes them."""
    monkeypatch.syspath_prepend(str(tmp_path))

    def write(step=1.0, factor=2.0, entry=0.0, name="a"):
        (tmp_path / f"callee_{name}.py").write_text(CALLEE.format(step=step))
        (tmp_path / f"caller_{name}.py").write_text(CALLER.format(name=name, factor=factor, entry=entry))
        return tmp_path / f"caller_{name}.py"

    return write


def load(path):
    """Module of a file, made anew."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    sys.modules[path.stem] = module
    return module


def begin(path, cache):
    """Run a file in a new process."""
    alone = os.environ | {"NUMBA_CACHE_DIR": str(cache), "PYTHONDONTWRITEBYTECODE": "1"}
    alone["PYTHONPATH"] = os.pathsep.join([str(ROOT), str(path.parent)])
    return subprocess.Popen([sys.executable, str(path)], env=alone, stdout=subprocess.PIPE, text=True)


def output(process):
    told, _ = process.communicate(timeout=HANG)
    assert process.returncode == 0
    return told.split()


def test_a_kernel_is_compiled_anew_when_one_that_it_calls_has_changed(sources, tmp_path):
    assert output(begin(sources(), tmp_path / "cache")) == ["4.0", "1"]
    assert output(begin(sources(), tmp_path / "cache")) == ["4.0", "0"]
    assert output(begin(sources(step=3.0), tmp_path / "cache")) == ["8.0", "1"]


def test_what_is_kept_depends_on_all_that_a_kernel_is_made_of(sources):
    def stamp(**changed):
        compilation._digest_of.cache_clear()
        path = sources(**changed)
        load(path.with_name("callee_a.py"))
        return compilation._stamp(load(path).whole.py_func)

    found = [stamp(), stamp(step=3.0), stamp(factor=3.0), stamp(entry=1.0)]
    assert len(set(found)) == 4 and stamp() == found[0]


def test_constants_of_other_files_count(sources):
    module = load(sources())
    before = compilation._stamp(module.whole.py_func)
    module.TABLE = np.full(3, 7.0)
    other = compilation._stamp(module.whole.py_func)
    module.FACTOR = 5.0
    assert len({before, other, compilation._stamp(module.whole.py_func)}) == 3


def test_functions_and_constants_of_an_imported_module_count(tmp_path, monkeypatch):
    """A kernel may call ``algebra.dot``: then a change of the algebra compiles it anew."""
    path = tmp_path / "by_module.py"
    path.write_text(
        "from protochain.core.compilation import njit\n"
        "from protochain.mechanics.multibody import algebra\n\n"
        "@njit(cache=True)\ndef whole(a):\n    return algebra.dot(a, algebra.ZERO)\n"
    )
    kernel = load(path).whole.py_func
    files = set()
    compilation._collect(kernel, files, set(), set())
    assert files == {str(path), algebra.__file__}
    before = compilation._stamp(kernel)
    monkeypatch.setattr(algebra, "ZERO", (1.0, 0.0, 0.0))
    assert compilation._stamp(kernel) != before


def test_two_processes_compile_a_kernel_once(sources, tmp_path):
    path = sources()
    both = [begin(path, tmp_path / "cache") for _ in range(2)]
    told = sorted(output(each) for each in both)
    assert told == [["4.0", "0"], ["4.0", "1"]]


def test_an_inner_kernel_has_machine_code_only_once_python_calls_it(sources, tmp_path, monkeypatch):
    monkeypatch.setattr(compilation._SETTINGS, "CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setenv(compile_helpers._HELPER, "1")
    path = sources(name="inner")
    for misses in (1, 0):  # Compiled, then loaded.
        part = load(path.with_name("callee_inner.py")).part
        whole = load(path).whole
        assert whole(1.0) == 4.0 and sum(whole.stats.cache_misses.values()) == misses
        assert [code.library.is_inner for code in part.overloads.values()] == [True] * misses
        assert part(1.0) == 2.0 and sum(part.stats.cache_misses.values()) == 2 * misses
        assert [code.library.is_inner for code in part.overloads.values()] == [False]
        assert whole(2.0) == 6.0 and part(2.0) == 3.0
    # Another kernel links the code of the cache.
    path = path.with_name("caller_other.py")
    path.write_text(CALLER.format(name="inner", factor=5.0, entry=0.0))
    part = load(path.with_name("callee_inner.py")).part
    assert load(path).whole(1.0) == 10.0 and not sum(part.stats.cache_misses.values())


@pytest.mark.parametrize("ending", [".nbi", ".nbc"])
def test_damaged_files_are_written_anew(sources, tmp_path, monkeypatch, ending):
    monkeypatch.setattr(compilation._SETTINGS, "CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setenv(compile_helpers._HELPER, "1")
    path = sources(name="damaged")
    assert load(path).whole(1.0) == 4.0
    (kept,) = (tmp_path / "cache").rglob(f"caller_damaged.whole*{ending}")
    whole = kept.read_bytes()
    kept.write_bytes(whole[: len(whole) // 2])
    again = load(path).whole
    assert again(1.0) == 4.0 and sum(again.stats.cache_misses.values()) == 1
    third = load(path).whole
    assert third(1.0) == 4.0 and sum(third.stats.cache_hits.values()) == 1


def test_a_full_disk_loses_the_compiled_code_only(sources, tmp_path, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(compilation._SETTINGS, "CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setattr(IndexDataCacheFile, "save", full)
    assert load(sources(name="full")).whole(1.0) == 4.0
    assert not list((tmp_path / "cache").rglob("*.nbc"))


def test_without_a_home_and_beside_read_only_sources_it_goes_to_the_temporary_folder(tmp_path, monkeypatch):
    monkeypatch.setattr(compilation.tempfile, "gettempdir", lambda: str(tmp_path))
    monkeypatch.setattr(compilation._SETTINGS, "CACHE_DIR", "")
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(compilation.os.path, "expanduser", lambda name: name)  # As where no user is known.
    compilation._temporary.cache_clear()
    (own,) = compilation._folders(tmp_path / "not there")
    assert Path(own).parent == tmp_path and Path(own).stat().st_mode & 0o777 == 0o700
    assert list(compilation._folders(STRUCTURES)) == ["", own]  # Writable.
    monkeypatch.setattr(compilation._SETTINGS, "CACHE_DIR", "given")
    assert list(compilation._folders(tmp_path / "not there")) == ["given", own]
    compilation._temporary.cache_clear()
    assert compilation._temporary() == own  # As later processes find it.
    Path(own).chmod(0o777)
    compilation._temporary.cache_clear()
    assert compilation._temporary() == ""  # Others could have put code there.
    Path(own).rmdir()
    Path(own).symlink_to(tmp_path)
    compilation._temporary.cache_clear()
    assert compilation._temporary() == ""
    compilation._temporary.cache_clear()


def test_where_nothing_can_be_kept_it_compiles_all_the_same(caplog, monkeypatch):
    monkeypatch.delenv(compile_helpers._HELPER, raising=False)
    compilation._announce.cache_clear()
    scope = {}
    exec(compile("def double(x):\n    return 2 * x", "no such file", "exec"), scope)
    double = njit(scope["double"], cache=True)
    with caplog.at_level(logging.WARNING):
        assert double(3) == 6
    assert not double._cache.has_folder and double._cache.cache_path == ""
    assert "in every run" in caplog.text and "NUMBA_CACHE_DIR" in caplog.text


def test_garbage_is_collected_again_after_compiling():
    with compilation._without_collection():
        assert not compilation.gc.isenabled()
        with compilation._without_collection():
            pass
        assert not compilation.gc.isenabled()
    assert compilation.gc.isenabled()


@pytest.fixture
def listed(sources, tmp_path, monkeypatch):
    """A list of kernels of one's own, and their module."""
    monkeypatch.setattr(compilation._SETTINGS, "CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setenv(compile_helpers._HELPER, "1")
    module = load(sources(name="listed"))
    (tmp_path / "list").write_text(
        "# a comment\n"
        "caller_listed whole no\n"  # No type.
        "no_such_module whole f\n"
        "caller_listed none f\n"
        "caller_listed whole f f\n"  # It cannot be compiled for these.
        "caller_listed whole f\n"
        "callee_listed part i\n"
    )
    monkeypatch.setattr(compile_helpers, "_LIST", tmp_path / "list")
    compile_helpers.entries.cache_clear()
    yield module
    compile_helpers.entries.cache_clear()


def test_a_helper_compiles_what_is_listed_and_leaves_out_the_rest(listed, tmp_path):
    compile_helpers.help_out()
    assert listed.whole.signatures == [(types.float64,)]
    assert (types.int64,) in listed.part.signatures
    again = load(tmp_path / "caller_listed.py").whole
    assert again(1.0) == 4.0 and sum(again.stats.cache_hits.values()) == 1


def test_a_helper_leaves_out_what_another_process_has_in_hand(listed):
    place = listed.whole._cache._lock.lock_file
    Path(place).parent.mkdir(parents=True, exist_ok=True)
    with FileLock(place):
        compile_helpers.help_out()
    assert not listed.whole.signatures and (types.int64,) in listed.part.signatures


def test_helpers_are_called_once_for_a_listed_kernel_and_end_with_the_caller(listed, tmp_path, monkeypatch):
    started, ends = [], []
    popen = lambda command, **options: started.append((command, options["env"])) or "a helper"  # noqa: E731
    monkeypatch.setattr(compile_helpers, "subprocess", SimpleNamespace(Popen=popen, DEVNULL=-3))
    monkeypatch.setattr(compile_helpers.atexit, "register", lambda end, helper: ends.append((end, helper)))
    monkeypatch.setattr(compile_helpers, "processors", lambda: 3)
    monkeypatch.setattr(compile_helpers, "_HELD", [])
    compile_helpers.call_helpers("caller_listed whole", tmp_path)
    assert not started  # A helper itself.
    monkeypatch.delenv(compile_helpers._HELPER)
    compile_helpers.call_helpers("caller_listed other", tmp_path)
    assert not started
    with FileLock(tmp_path / "helpers.lock", is_singleton=False):
        compile_helpers.call_helpers("caller_listed whole", tmp_path)
    assert not started  # Another process has helpers.
    compile_helpers.call_helpers("caller_listed whole", tmp_path)
    compile_helpers.call_helpers("callee_listed part", tmp_path)
    assert [env[compile_helpers._HELPER] for _, env in started] == ["1", "2"]
    assert started[0][0][0] == sys.executable and ends == [(compile_helpers._end, "a helper")] * 2
    compile_helpers._HELD[0].release()


@pytest.mark.parametrize(("cores", "helpers"), [(1, 0), (2, 1), (64, compile_helpers.MOST)])
def test_helpers_leave_a_core_to_the_run(listed, tmp_path, monkeypatch, cores, helpers):
    started = []
    monkeypatch.setattr(compile_helpers.subprocess, "Popen", lambda *_, **__: started.append(1))
    monkeypatch.setattr(compile_helpers.atexit, "register", lambda *_: None)
    monkeypatch.setattr(compile_helpers, "processors", lambda: cores)
    monkeypatch.setattr(compile_helpers, "_HELD", [])
    monkeypatch.delenv(compile_helpers._HELPER)
    compile_helpers.call_helpers("caller_listed whole", tmp_path)
    assert len(started) == helpers
    for lock in compile_helpers._HELD:
        lock.release()


@pytest.mark.parametrize(
    "text", ["f", "i", "b", "f2r", "b1", "f1s", "f3rs", "n", "(i,i)", "(f2,(i1r,b),n)", "()"]
)
def test_types_are_written_as_they_are_read(text):
    assert text_of(compile_helpers.type_of(text)) == text


def test_types_are_those_of_arrays():
    def of(array):
        return text_of(types.misc.unliteral(__import__("numba").typeof(array)))

    locked = np.zeros((2, 3))
    locked.flags.writeable = False
    assert of(np.zeros(2)) == "f1" and of(locked) == "f2r" and of(np.zeros((2, 4))[:, 1]) == "f1s"
    assert of(np.zeros(3, int)) == "i1" and of(np.zeros(3, bool)) == "b1" and of(1.5) == "f"


def test_the_list_is_of_kernels_that_there_are():
    kernels = list(compile_helpers._kernels())
    assert len(kernels) == len(compile_helpers.entries()) == len(set(compile_helpers.entries())) > 20
    for kernel, of in kernels:
        assert isinstance(kernel._cache, compilation.Store)
        assert len(of) == kernel.py_func.__code__.co_argcount, kernel


RUN = """
import sys
sys.path.append({tests!r})
from kernels import loaded
from protochain.cli import main
for command in ("minimise", "relax"):
    sys.argv = ["protochain", command, *{arguments}]
    try:
        main()
    except SystemExit as end:
        assert not end.code
print(*loaded(), sep="\\n")
"""


def test_the_list_has_all_that_runs_by_default_call(tmp_path):
    """Where it has not, ``python tests/kernels.py`` writes the list anew."""
    arguments = [str(STRUCTURES / "1l2y.pdb"), "-o", str(tmp_path / "out.pdb")]
    program = RUN.format(arguments=arguments, tests=str(ROOT / "tests"))
    # Twice: kernels that are loaded call none.
    for _ in range(2):
        run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    called = {line for line in run.stdout.splitlines() if line.startswith("protochain.")}
    assert called <= set(compile_helpers.entries())


@pytest.mark.slow
def test_no_bit_depends_on_which_process_compiled(tmp_path):
    found = []
    for name, surroundings in (("helped", {}), ("alone", {compile_helpers._HELPER: "0"}), ("helped", {})):
        output = tmp_path / f"{len(found)}.pdb"
        command = ["minimise", str(STRUCTURES / "1l2y.pdb"), "-o", str(output), "--trace", f"{output}.csv"]
        alone = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / name)} | surroundings
        program = f"import sys; sys.argv[1:] = {command}; from protochain.cli import main; main()"
        subprocess.run([sys.executable, "-c", program], env=alone, check=True, capture_output=True)
        lines = Path(f"{output}.csv").read_text().splitlines()
        energies = [line.split(",")[3] for line in lines]
        found.append((output.read_bytes(), energies))
    assert found[0] == found[1] == found[2]


LOADED = """
import numpy as np
from protochain.core.compilation import njit

@njit(cache=True)
def loaded(x):
    seen = set(x[:, 0])
    return np.sort(np.linalg.solve(x, np.ones(len(x)))), len(seen), np.sin(x).sum()

@njit
def compiled(x):
    return np.cumsum(x[::-1])

if __name__ == "__main__":
    solved, n, total = loaded(np.array([[2.0, 1.0], [1.0, 3.0]]))
    print(solved.tolist(), n, round(total, 6), sum(loaded.stats.cache_misses.values()))
    print(compiled(np.arange(3.0)).tolist())
"""


@pytest.mark.slow
def test_loaded_code_needs_nothing_that_only_the_compiler_knows(tmp_path):
    """Memory, linear algebra, sets and mathematics work in a process that has compiled nothing."""
    (tmp_path / "own.py").write_text(LOADED)
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONPATH": str(ROOT)}
    for misses in (1, 0):
        command = [sys.executable, str(tmp_path / "own.py")]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        expected = 2 * np.sin(1.0) + np.sin(2.0) + np.sin(3.0)
        first, second = done.stdout.splitlines()
        assert first == f"[0.2, 0.4] 2 {expected:.6f} {misses}" and second == "[2.0, 3.0, 3.0]"


def test_nothing_of_the_current_folder_is_run_or_trusted(tmp_path):
    """A stranger's folder may hold modules, and settings of numba's cache, which is unpickled."""
    for name in ("gemmi", "sitecustomize", "protochain"):
        (tmp_path / f"{name}.py").write_text("raise SystemExit('the trap ran')")
    trap = tmp_path / "trap"
    (tmp_path / ".numba_config.yaml").write_text(f"cache_dir: {trap}\n")
    program = (
        "import gemmi, protochain.core.compilation; from numba import config; print(repr(config.CACHE_DIR))"
    )
    environment = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}

    def seen(program=program, **more):
        done = subprocess.run(
            own_python(program), cwd=tmp_path, env=environment | more, capture_output=True, text=True
        )
        return done.stdout.strip() or done.stderr

    # matplotlib reads the folder's settings: typesetting by LaTeX fails where there is none.
    (tmp_path / "matplotlibrc").write_text("text.usetex: True\n")
    usetex = "import matplotlib, protochain.core.figure; print(matplotlib.rcParams['text.usetex'])"
    assert seen(program=usetex) == "False"
    assert seen() == "''"
    assert seen(NUMBA_CACHE_DIR=str(tmp_path / "own")) == repr(str(tmp_path / "own"))
