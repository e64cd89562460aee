"""Runs commands in processes split off this one, and judges what they did to files, output and status.

A command does its work (status 0, 1 or 3; JSON that others can read; files that are read again) or refuses in
one line that names the file, with status 2 and nothing written. All else is a fault.
"""

import gc
import json
import math
import os
import re
import resource
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, partial
from multiprocessing import get_context
from pathlib import Path
from types import ModuleType

import damage
import gemmi
from damage import FILES, MADE, OF_MADE, OPTIONS, Case

import protochain as pc
from protochain import cli

MEMORY = 12 << 30
"""Bytes of address space, of which imports alone take some 4 GiB."""
SECONDS = 60
"""Of the processor."""
WAIT = 600
"""s, of sleep too."""
LARGEST_FILE = 1 << 28
LONGEST_LINE = 1000
"""Characters of a line that is read at a glance, with some long names in it."""
DONE, REFUSED = (0, 1, 3), 2


@dataclass(frozen=True)
class Ran:
    """What a process left.

    Parameters
    ----------
    status : int
        Below 0 the signal that ended it.
    output, errors : bytes
    before, after : mapping
        Path: content, of all files; None for a folder.
    """

    status: int
    output: bytes
    errors: bytes
    before: Mapping[str, bytes | None]
    after: Mapping[str, bytes | None]


@dataclass(frozen=True)
class Outcome:
    """Of a case; ``faults`` is empty if all is well."""

    kind: str
    seed: int
    words: tuple[str, ...]
    status: int
    faults: tuple[str, ...]
    said: str


def contents(folder: Path) -> dict[str, bytes | None]:
    return {
        str(path.relative_to(folder)): path.read_bytes() if path.is_file() else None
        for path in sorted(folder.rglob("*"))
    }


def split_off(call: Callable[[], object], folder: Path, seconds: int = SECONDS) -> tuple[int, bytes, bytes]:
    """Call in a process of its own, in a folder; status, standard output and standard error."""
    with tempfile.TemporaryFile() as output, tempfile.TemporaryFile() as errors:
        number = os.fork()
        if not number:
            _alone(call, folder, seconds, output.fileno(), errors.fileno())
        status, until = None, time.monotonic() + WAIT
        while status is None:
            ended, code = os.waitpid(number, os.WNOHANG)
            if ended:
                status = os.waitstatus_to_exitcode(code)
            elif time.monotonic() > until:
                os.killpg(number, signal.SIGKILL)
                status = -signal.SIGXCPU
                os.waitpid(number, 0)
            else:
                time.sleep(0.002)
        output.seek(0)
        errors.seek(0)
        return status, output.read(), errors.read()


def _alone(call: Callable[[], object], folder: Path, seconds: int, output: int, errors: int) -> None:
    """Become a process as the shell starts it, and end."""
    code = 70
    try:
        os.setsid()
        os.chdir(folder)
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        os.dup2(output, 1)
        os.dup2(errors, 2)
        sys.stdin = open(0, encoding="utf-8", closefd=False)  # noqa: SIM115
        sys.stdout = open(1, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
        sys.stderr = open(2, "w", encoding="utf-8", errors="backslashreplace", closefd=False)  # noqa: SIM115
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
        resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 5))
        resource.setrlimit(resource.RLIMIT_FSIZE, (LARGEST_FILE, LARGEST_FILE))
        # Processes that commands start would read the file of this one's main module.
        sys.modules["__main__"] = ModuleType("__main__")
        call()
        code = 0
    except SystemExit as ended:
        code = ended.code if isinstance(ended.code, int) else 0
    except BaseException:
        traceback.print_exc()
    try:
        sys.stdout.flush()
        sys.stderr.flush()
    except BaseException:
        traceback.print_exc()
    finally:
        os._exit(code)


def command(words: Iterable[str]) -> None:
    """The command line."""
    sys.argv = ["protochain", *words]
    cli.main()


def ran(
    case: Case, folder: Path, call: Callable[[tuple[str, ...]], object] = command, seconds: int = SECONDS
) -> Ran:
    """Put the files of a case into an empty folder and run its command there."""
    _put(case.files, folder)
    before = contents(folder)
    status, output, errors = split_off(lambda: call(case.words), folder, seconds)
    return Ran(status, output, errors, before, contents(folder))


def _put(files: Mapping[str, bytes], folder: Path) -> None:
    for name, data in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)


def faults(case: Case, end: Ran) -> list[str]:
    """What is wrong with the end of a command, each fault in a few words."""
    found = []
    output, errors = (text.decode("utf-8", "replace") for text in (end.output, end.errors))
    lines = [line for line in errors.split("\n") if line]
    if end.status in (-signal.SIGXCPU, -signal.SIGKILL):
        found.append("time")
    elif end.status < 0:
        found.append(f"signal {-end.status}")
    elif end.status not in (*DONE, REFUSED):
        found.append(f"status {end.status}")
    if "Traceback (most recent call last)" in errors:
        found.append("traceback")
    if re.search(r"MemoryError|bad_alloc|Cannot allocate memory", errors):
        found.append("memory")
    if re.search(r"\b\w+Warning\b", errors):
        found.append("warning")
    if re.search(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u2028\u2029]", errors + output):
        found.append("control characters")
    if any(len(line) > LONGEST_LINE for line in lines):
        found.append("long line")
    for name, data in end.before.items():
        replaced = end.status in DONE and name in case.outputs
        if end.after.get(name) != data and not replaced:
            found.append(f"input changed: {name}")
    new = [name for name in end.after if name not in end.before]
    if end.status == REFUSED:
        found += _of_refusal(case, lines, new)
    elif end.status in DONE:
        found += [f"temporary file left: {name}" for name in new if re.search(r"(^|/)(tmp|\.)[^/]*$", name)
                  and not name.endswith(".lock")]  # fmt: skip
        if "--json" in case.words and "--help" not in case.words and "-" not in case.words:
            found += _of_json(output, end.status)
    if output.strip() and end.status == REFUSED and case.words[0] in SEVERAL and "--json" in case.words:
        found += _of_json(output, end.status)
    return list(dict.fromkeys(found))


SEVERAL = ("validate", "rmsd", "batch", "relax")
"""Commands of several inputs, each of which is refused by itself."""


def _of_refusal(case: Case, lines: list[str], new: list[str]) -> list[str]:
    """Faults of a refusal: its lines, and what it wrote."""
    found = []
    # Before it, a line may say what was changed in a file that was read.
    said = [line for line in lines if line.startswith("protochain: ")]
    notes = [line for line in lines if line not in said]
    # One refused of several is named without the program.
    if not said and case.words[0] in SEVERAL and notes:
        said = notes[-1:]
        notes = notes[:-1]
    if len(said) != 1 or lines[-1] != said[0]:
        found.append(f"{len(said)} lines of refusal")
    known = tuple(f"{' '.join(word.split())}: " for word in case.words)
    if any(not line.startswith(known) for line in notes):
        found.append("other lines")
    # What is wrong with a prepared structure is told by its name, the stem of its file's.
    if case.named and said and not any(Path(name).name.split(".")[0] in said[-1] for name in case.named):
        found.append("file not named")
    # What was asked for beside the table of refusals.
    if new and case.words[0] not in SEVERAL:
        found.append(f"left: {new[0]}")
    return found


def _of_json(output: str, status: int) -> list[str]:
    if not output.strip() and status == 1:
        return []
    try:
        json.loads(output, parse_constant=_no_number)
    except ValueError:
        return ["invalid JSON"]
    return []


def _no_number(text: str) -> float:
    raise ValueError(text)


def unread(case: Case, end: Ran, folder: Path) -> list[str]:
    """Faults of structures that were written, when they are read again."""
    written = [
        name
        for name, data in end.after.items()
        if data is not None and end.before.get(name) != data and re.search(r"\.(pdb|cif)(\.gz)?$", name)
    ]
    if end.status not in DONE or not written:
        return []
    asked = ""
    if "--json" in case.words:
        try:
            asked = json.loads(end.output).get("n_atoms")
        except (ValueError, AttributeError):
            asked = ""
    found = []
    for name in written:
        call = partial(
            _read_again, name, asked if len(written) == 1 else "", "--strip-hydrogens" in case.words
        )
        status, _, errors = split_off(call, folder)
        if status:
            found.append(
                f"not read again: {name}: {errors.decode('utf-8', 'replace').strip().splitlines()[-1:]}"
            )
    return found


def _read_again(name: str, n_atoms: object, stripped: bool) -> None:
    read = pc.load(name, keep="all")
    count = gemmi.read_structure(name)[0].count_atom_sites()
    n_read = sum(a.element.symbol != "H" for a in read.topology.atoms()) if stripped else read.n_atoms
    if n_read != count:
        raise ValueError(f"{n_read} atoms of {count}")
    if isinstance(n_atoms, int) and not stripped and n_atoms != count:
        raise ValueError(f"{count} atoms were written, {n_atoms} told")
    if not all(map(math.isfinite, read.positions.ravel().tolist())):
        raise ValueError("positions that are not finite")


# All cases.

READY = (
    ("info", "in/ala10.pdb", "--threads", "1"),
    ("validate", "in/ala10.pdb"),
    ("rmsd", "in/ala10.pdb", "in/ala10.pdb"),
    ("relax", "in/ala10.pdb", "-o", "out.pdb", "--max-iterations", "3", "--threads", "1"),
    ("minimise", "in/ala10.pdb", "-o", "out.pdb", "--max-evaluations", "3", "--threads", "1"),
    (
        "minimise",
        "in/ala10.pdb",
        "-o",
        "out.pdb",
        "--max-evaluations",
        "3",
        "--threads",
        "1",
        "--method",
        "lbfgs",
    ),
)
"""Commands that load what most cases need; one thread, for a process split off has none of the others."""


def warm_up() -> None:
    """Import and load in this process what commands need."""
    place, streams, handler = Path.cwd(), (sys.stdout, sys.stderr), signal.getsignal(signal.SIGTERM)
    with tempfile.TemporaryDirectory() as scratch, open(os.devnull, "w") as nowhere:  # noqa: PTH123
        _put(damage.beside(), Path(scratch))
        os.chdir(scratch)
        try:
            sys.stdout = sys.stderr = nowhere
            for words in READY:
                with suppress(SystemExit):
                    command(words)
        finally:
            sys.stdout, sys.stderr = streams
            os.chdir(place)
            signal.signal(signal.SIGTERM, handler)
    gc.freeze()


@cache
def made(name: str) -> dict[str, bytes]:
    """Files that a command of MADE leaves."""
    with tempfile.TemporaryDirectory() as scratch:
        end = ran(Case(name, 0, MADE[name], damage.beside()), Path(scratch))
    if end.status not in DONE:
        raise RuntimeError(f"{' '.join(MADE[name])}: {end.errors.decode()}")
    return {path: data for path, data in end.after.items() if data is not None}


def case_of(kind: str, seed: int) -> Case:
    """A case by its kind and seed."""
    if kind in OPTIONS:
        return damage.options(kind, seed)
    make = FILES[kind][1]
    return make(kind, seed, made) if kind in OF_MADE else make(kind, seed)


def judged(kind: str, seed: int) -> Outcome:
    """Run and judge a case, in a folder of its own."""
    case = case_of(kind, seed)
    with tempfile.TemporaryDirectory(prefix="fuzz-") as scratch:
        folder = Path(scratch)
        end = ran(case, folder)
        found = [*faults(case, end), *unread(case, end, folder)]
    said = end.errors.decode("utf-8", "replace")[-2000:]
    return Outcome(case.kind, seed, case.words, end.status, tuple(found), said)


def chosen(weights: Mapping[str, float], n: int) -> list[tuple[str, int]]:
    """Kinds and seeds of n cases, shared out by weight."""
    whole, out = sum(weights.values()), []
    passed = 0.0
    for kind, weight in weights.items():
        begin, passed = round(n * passed / whole), passed + weight
        out += [(kind, seed) for seed in range(round(n * passed / whole) - begin)]
    return out


def outcomes(cases: list[tuple[str, int]], jobs: int) -> Iterable[Outcome]:
    """Outcomes of cases by kind and seed, as they end."""
    with ProcessPoolExecutor(jobs, get_context("spawn"), warm_up) as pool:
        yield from pool.map(judged, *zip(*cases, strict=True), chunksize=4)
