"""Mutation run: faults put at random into the code, one at a time, and the share that the tests notice.

``python tests/mutants.py -o analysis/results`` takes hours on two cores. A fault is a comparison, an
operator, a number, a name or a condition changed, a statement or a keyword left out. With ``--kind semantic``
it is one of ``semantic_faults.py``, as many of each kind. The fast tests that
reach its line (by a coverage run before) are run, quickest first and no longer than ``LONGEST``.
With ``--nearest N`` no coverage run is needed: the N tests are run that share most words with the line.
Compiled kernels, which coverage does not see into, and what processes run, get the tests of their package;
lines that run on import get the tests that use their file. A fault that runs into the time limit is
noticed; a test that a fault renames is not run.
"""

import argparse
import ast
import copy
import csv
import os
import random
import re
import shutil
import sqlite3
import subprocess
import sys
import tempfile
from collections import Counter, defaultdict
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace
from functools import cache
from itertools import zip_longest
from pathlib import Path
from queue import Queue
from xml.etree import ElementTree

import coverage.numbits
import pandas as pd
import semantic_faults
from scipy.stats import binomtest

ROOT = Path(__file__).parent.parent
FOLDERS = (
    "batches", "chains", "cli", "comparison", "core", "dynamics", "energies", "ligands", "mechanics",
    "mechanisms", "minimisers", "relaxation", "searching", "structure", "validation",
)  # fmt: skip
"""Packages, of which as many faults each are tried by default."""
LONGEST = 300.0
"""Seconds of tests for one fault, as they took without it. On a busy machine they take longer."""
WORD = re.compile(r"[A-Za-z_]\w{2,}")
KERNEL = re.compile(r"(?m)^@(kernel|inlined|shared|scalar)\b")
BESIDE = {"mechanics": ("dynamics", "chains")}
"""Packages whose tests are also of another's kernels."""
IN_PROCESSES = ("batches", "cli", "searching")
"""Packages that also run in processes of their own, where coverage sees nothing."""
COMPARISONS = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.In: ast.NotIn, ast.NotIn: ast.In, ast.Is: ast.IsNot, ast.IsNot: ast.Is,
}  # fmt: skip
OPERATORS = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult, ast.Pow: ast.Mult, ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd,
}  # fmt: skip


@dataclass(frozen=True)
class Fault:
    """One change of one line's text, and what came of it."""

    folder: str
    file: str
    line: int
    kind: str
    code: str
    fault: str
    result: str = ""
    test: str = ""
    """The test that fails, or why no test can."""


def changes(node: ast.AST) -> Iterator[tuple[str, ast.AST]]:
    """Kinds of fault at a node, each with the node that takes its place."""
    new = copy.deepcopy(node)
    match new:
        case ast.Compare(ops=[op]) if type(op) in COMPARISONS:
            new.ops = [COMPARISONS[type(op)]()]
            yield "comparison", new
        case ast.BinOp(op=op) if type(op) in OPERATORS:
            new.op = OPERATORS[type(op)]()
            yield "operator", new
        case ast.BoolOp(op=op):
            new.op = ast.Or() if isinstance(op, ast.And) else ast.And()
            yield "condition", new
        case ast.UnaryOp(op=ast.Not() | ast.USub(), operand=operand):
            yield "sign", operand
        case ast.Constant(value=bool(value)):
            yield "value", ast.Constant(not value)
        case ast.Constant(value=int(value)):
            yield "value", ast.Constant(value + 1)
        case ast.Constant(value=float(value)):
            yield "value", ast.Constant(2.0 * value or 1.0)
        case ast.Constant(value=str(value)) if value and not any(c in value for c in " \n{"):
            yield "name", ast.Constant(value + "X")
        case ast.Assign(targets=[ast.Name() | ast.Tuple()]):
            pass  # A name that is never set is noticed by whatever runs the line.
        case ast.Expr(value=ast.Call()) | ast.Assign() | ast.AugAssign() | ast.Raise() | ast.Continue():
            yield "left out", ast.Pass()
        case ast.Call(keywords=[*_, ast.keyword(arg=str(arg))]) if arg != "strict":
            new.keywords = new.keywords[:-1]
            yield "keyword left out", new
        case _:
            pass
    if isinstance(node, ast.If | ast.IfExp | ast.While) and not isinstance(node.test, ast.Constant):
        yield "condition", ast.Constant(False)


def sites(tree: ast.AST) -> Iterator[ast.AST]:
    """Nodes that run: no annotations, decorators, docstrings, assertions for the type checker."""
    for name, value in ast.iter_fields(tree):
        if name in ("annotation", "returns", "decorator_list", "type_params", "format_spec"):
            continue
        for child in value if isinstance(value, list) else [value]:
            if not isinstance(child, ast.AST) or isinstance(child, ast.Assert | ast.JoinedStr):
                continue
            if isinstance(child, ast.Expr) and isinstance(child.value, ast.Constant):
                continue
            if ast.unparse(child) in ("strict=True", "strict=False") or is_declaration(child):
                continue
            if isinstance(child, ast.Assign) and isinstance(tree, ast.Module):
                # Names for other modules; a missing one is an error of the import, seen by all tests.
                yield from sites(child.value)
                continue
            yield child
            yield from sites(child)


def is_declaration(node: ast.AST) -> bool:
    """Whether a statement speaks to tools only: names to export, imports for the type checker."""
    text = ast.unparse(node)
    return text.startswith(("__all__", "if TYPE_CHECKING:", "from __future__"))


def files(folder: str, root: Path) -> list[Path]:
    path = root / "protochain" / folder
    return sorted(path.rglob("*.py")) if path.is_dir() else [path] * path.is_file()


def faults(folder: str, root: Path) -> list[Fault]:
    """All faults of a folder; those that span lines are left out."""
    found = []
    for file in files(folder, root):
        text = file.read_text()
        lines = text.splitlines()
        for node in sites(ast.parse(text)):
            for kind, new in changes(node):
                at = node.test if isinstance(node, ast.If | ast.IfExp | ast.While) else node
                if at.lineno != at.end_lineno or not lines[at.lineno - 1].isascii():
                    continue
                line = lines[at.lineno - 1]
                swapped = line[: at.col_offset] + f"({ast.unparse(new)})" + line[at.end_col_offset :]
                if isinstance(new, ast.Pass):
                    swapped = line[: at.col_offset] + "pass" + line[at.end_col_offset :]
                name = file.relative_to(root).as_posix()
                found.append(Fault(folder, name, at.lineno, kind, line.strip(), swapped.strip()))
    return found


def faults_of_meaning(folder: str, root: Path) -> list[Fault]:
    """All semantic faults of a folder."""
    signatures, every = semantic_faults.read_signatures(root), []
    for file in files(folder, root):
        text, name = file.read_text(), file.relative_to(root).as_posix()
        for number, kind, line in semantic_faults.changes(text, signatures):
            code = text.splitlines()[number - 1].strip()
            every.append(Fault(folder, name, number, kind, code, line.strip()))
    return every


def sample_kinds(every: list[Fault], number: int, draw: random.Random) -> list[Fault]:
    """Draw as many faults of each kind, as far as the number goes."""
    by_kind = defaultdict(list)
    for fault in every:
        by_kind[fault.kind].append(fault)
    kinds = draw.sample(sorted(by_kind), len(by_kind))
    orders = [draw.sample(by_kind[kind], min(number, len(by_kind[kind]))) for kind in kinds]
    return [fault for rank in zip_longest(*orders) for fault in rank if fault][:number]


def nearest_tests(fault: Fault, root: Path, number: int) -> list[str]:
    """Tests that share the rarest words with the line of a fault and with the names around it."""
    file, tests = Path(fault.file), texts_of_tests(root)
    tree = ast.parse((root / file).read_text())
    names = {file.stem}.union(
        node.name
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef | ast.ClassDef)
        and node.lineno <= fault.line <= (node.end_lineno or 0)
    )
    shared = Counter(word for words in tests.values() for word in words)
    wanted = {word for word in {*WORD.findall(fault.code), *names} if shared[word]}

    def rank(test: str) -> float:
        near = (f"/{file.parts[1]}/" in test) + 2 * (f"test_{file.stem}.py" in test)
        return near + sum(1.0 + 10.0 / shared[word] for word in wanted & tests[test])

    return sorted(tests, key=rank, reverse=True)[:number]


@cache
def texts_of_tests(root: Path) -> dict[str, set[str]]:
    """Words of each fast test."""
    words = {}
    for path in sorted((root / "tests").rglob("test_*.py")):
        text = path.read_text()
        for node in ast.parse(text).body:
            if not isinstance(node, ast.FunctionDef) or not node.name.startswith("test_"):
                continue
            if "pytest.mark.slow" not in map(ast.unparse, node.decorator_list):
                name = f"{path.relative_to(root).as_posix()}::{node.name}"
                lines = text.splitlines()[node.lineno - 1 : node.end_lineno]
                words[name] = {*WORD.findall("\n".join(lines)), path.stem.removeprefix("test_")}
    return words


def tests_of_lines(root: Path, jobs: int) -> tuple[dict[tuple[str, int], set[str]], dict[str, float]]:
    """Run the fast tests once: the tests that reach each line, and how long each test takes.

    A line that runs on import, which coverage gives to the first test that imports it, has all tests that
    reach a function of its file.
    """
    timing, covered = root / "timing.xml", root / ".coverage"
    command = [*PYTEST, "-n", str(jobs), "--dist", "loadfile", f"--junitxml={timing}"]
    command += ["--cov=protochain", "--cov-context=test", "--cov-report="]
    subprocess.run(command, cwd=root, env=environment(root), stdout=subprocess.DEVNULL)
    seconds = {}
    for case in ElementTree.parse(timing).iter("testcase"):
        if len(case):
            print(f"left out, since it fails without a fault or is skipped: {case.get('name')}")
            continue
        if str(root) in case.get("name", ""):
            print(f"left out, since its name is another one elsewhere: {case.get('name')}")
            continue
        file = case.get("classname", "").replace(".", "/") + ".py"
        seconds[f"{file}::{case.get('name')}"] = float(case.get("time", 0))
    reached = defaultdict(set)
    rows = sqlite3.connect(covered).execute(
        "select path, context, numbits from line_bits"
        " join file on file_id = file.id join context on context_id = context.id"
    )
    for path, context, bits in rows:
        for line in coverage.numbits.numbits_to_nums(bits) if context else ():
            reached[Path(path).relative_to(root).as_posix(), line].add(context.split("|")[0])
    # Coverage also knows templates of pages, which are no Python.
    for file in {file for file, _ in reached if file.endswith(".py")}:
        text = (root / file).read_text()
        called = lines_of_functions(text)
        users = set().union(*(reached.get((file, line), ()) for line in called))
        for line in {*range(1, len(text.splitlines()) + 1)} - called if users else ():
            reached[file, line] = users
    return reached, seconds


def lines_of_functions(text: str) -> set[int]:
    """Lines that run when a function is called."""
    return {
        line
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.FunctionDef)
        for line in range(node.body[0].lineno, (node.end_lineno or 0) + 1)
    }


PYTEST = [sys.executable, "-m", "pytest", "-q", "-p", "no:randomly", "-p", "no:cacheprovider"]


def environment(root: Path) -> dict[str, str]:
    return os.environ | {
        "PYTHONPATH": str(root),
        "MPLBACKEND": "Agg",
        "NUMBA_CACHE_DIR": str(root / ".numba"),
    }


def tried(fault: Fault, root: Path, tests: list[str], kernel: bool, limit: float) -> Fault:
    """Put a fault into a tree, run tests until one fails, and take it out."""
    file = root / fault.file
    text, stamp = file.read_text(), file.stat()
    lines = text.splitlines(keepends=True)
    line = lines[fault.line - 1]
    lines[fault.line - 1] = line[: len(line) - len(line.lstrip())] + fault.fault + "\n"
    surroundings = environment(root)
    scratch = root / ".numba-fault"
    if kernel:
        surroundings["NUMBA_CACHE_DIR"] = str(scratch)
    try:
        file.write_text("".join(lines))
        while True:
            (root / "chosen.txt").write_text("\n".join(tests))
            command = [*PYTEST, "-x", "--tb=no", "-rfE", "@chosen.txt"]
            ended = subprocess.run(
                command, cwd=root, env=surroundings, capture_output=True, text=True, timeout=limit
            )
            failed = [
                row.split(" - ")[0].split(" ", 1)[1]
                for row in ended.stdout.splitlines()
                if row[:6] in ("FAILED", "ERROR ")
            ]
            gone = [row for row in (ended.stdout + ended.stderr).splitlines() if "not found: " in row]
            left = [test for test in tests if not any(row.endswith(test.split("[")[0]) for row in gone)]
            # None is run where the fault renames one: the others are run without it.
            if failed or not left or len(left) == len(tests):
                break
            tests = left
        result = "survived" if ended.returncode == 0 or (gone and not failed) else "noticed"
        by = (failed or [""])[0]
    except subprocess.TimeoutExpired:
        result, by = "noticed", "time limit"
    finally:
        file.write_text(text)
        os.utime(file, ns=(stamp.st_atime_ns, stamp.st_mtime_ns))
        shutil.rmtree(scratch, ignore_errors=True)
    if result == "survived" and (fault.file, fault.fault) in excuses():
        result, by = "excused", excuses()[fault.file, fault.fault]
    return replace(fault, result=result, test=by)


def chosen_tests(
    fault: Fault, reached: dict[tuple[str, int], set[str]], seconds: dict[str, float], on_import: bool
) -> tuple[list[str], bool]:
    """Tests for a fault, quickest first; whether it is in a compiled kernel or in none that was reached.

    ``on_import`` tells that the line runs when the module of a kernel is imported.
    """
    found, package = reached.get((fault.file, fault.line), set()), fault.file.split("/")[1]
    blind = not found
    own = {test for test in seconds if test.split("/")[1] in (package, *BESIDE.get(package, ()))}
    if blind or on_import or package in IN_PROCESSES:
        found = found | own
    chosen, spent = [], 0.0
    # Of a constant that kernels are compiled with, the tests that call kernels come first.
    order = {test: (on_import and test not in own, seconds[test]) for test in seconds}
    for test in sorted(found & seconds.keys(), key=order.__getitem__):
        spent += seconds[test]
        if spent > LONGEST:
            break
        chosen.append(test)
    return chosen, blind


def copied(source: Path, to: Path) -> Path:
    """Copy a tree; what lies beside it is linked."""
    ignored = shutil.ignore_patterns(".git", "__pycache__", "*.nb?", ".*_cache", ".venv")
    shutil.copytree(source, to / "tree", ignore=ignored)
    if (source.parent / "shared").exists():
        (to / "shared").symlink_to(source.parent / "shared")
    return to / "tree"


def excuses() -> dict[tuple[str, str], str]:
    """Faults that change nothing that could be seen: (file, fault) and why."""
    with (ROOT / "tests" / "mutants_excused.csv").open() as file:
        return {(row["file"], row["fault"]): row["why"] for row in csv.DictReader(file)}


def score(ended: list[Fault], by: str = "folder") -> list[dict[str, object]]:
    """By folder or kind: faults noticed, excused, not; the share noticed with its 95 % interval (Wilson)."""
    rows = []
    for name in (*dict.fromkeys(getattr(fault, by) for fault in ended), "all"):
        count = Counter(fault.result for fault in ended if name in (getattr(fault, by), "all"))
        n = count["noticed"] + count["survived"]
        low, high = binomtest(count["noticed"], n).proportion_ci(method="wilson") if n else (0.0, 1.0)
        rows.append(
            {
                by: name,
                **{result: count[result] for result in ("noticed", "excused", "survived")},
                "share": round(count["noticed"] / max(n, 1), 3),
                "low": round(float(low), 3),
                "high": round(float(high), 3),
            }
        )
    return rows


def mutation_run(
    folders: list[str], number: int, seed: int, jobs: int, tree: Path, tests: list[str] | None = None,
    semantic: bool = False, nearest: int = 0,
) -> list[Fault]:  # fmt: skip
    """Try faults chosen at random, ``number`` in each folder; with test files, only those are run."""
    with tempfile.TemporaryDirectory() as scratch:
        places = [copied(tree.resolve(), Path(scratch) / str(k)) for k in range(jobs)]
        picked = []
        for folder in folders:
            draw = random.Random(f"{seed}{folder}")
            every = faults_of_meaning(folder, places[0]) if semantic else faults(folder, places[0])
            if semantic:
                picked += sample_kinds(every, number, draw)
            else:
                picked += draw.sample(every, min(number, len(every)))
        reached, seconds = ({}, {}) if tests or nearest else tests_of_lines(places[0], jobs)
        free: Queue[Path] = Queue()
        for place in places:
            free.put(place)

        def one(fault: Fault) -> Fault:
            place = free.get()
            text = (place / fault.file).read_text()
            on_import = bool(KERNEL.search(text)) and fault.line not in lines_of_functions(text)
            chosen, blind, limit = tests, True, 60 + 4 * LONGEST
            if nearest:
                # The cache of kernels sees changes of sources, so that all faults may share it.
                chosen, blind, limit = nearest_tests(fault, place, nearest), False, LONGEST
            elif not tests:
                chosen, blind = chosen_tests(fault, reached, seconds, on_import)
            ended = tried(fault, place, chosen, blind or (on_import and not nearest), limit)
            if nearest and ended.test == "time limit":
                ended = replace(ended, result="survived")
            free.put(place)
            print(ended.result, ended.file, ended.line, "|", ended.fault, "|", ended.test, flush=True)
            return ended

        with ThreadPoolExecutor(jobs) as pool:
            return list(pool.map(one, picked))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", nargs="*", default=FOLDERS, help="these, or paths under protochain")
    parser.add_argument("-n", "--number", type=int, default=4, help="faults a folder")
    parser.add_argument("-s", "--seed", type=int, default=1)
    parser.add_argument("-j", "--jobs", type=int, default=2)
    parser.add_argument("-t", "--tree", type=Path, default=ROOT, help="tree with code and tests")
    parser.add_argument("--tests", nargs="+", help="test files to run, rather than those that reach a line")
    parser.add_argument("--nearest", type=int, default=0, metavar="N", help="N tests that name the code")
    parser.add_argument("--kind", choices=("random", "semantic"), default="random")
    parser.add_argument("-o", "--output", type=Path, help="folder for mutants*.csv and mutants*_score.csv")
    given = parser.parse_args()
    semantic = given.kind == "semantic"
    ended = mutation_run(
        given.folders, given.number, given.seed, given.jobs, given.tree, given.tests, semantic, given.nearest
    )
    scores = score(ended, "kind" if semantic else "folder")
    for row in scores:
        print(row)
    if given.output:
        sys.path.insert(1, str(ROOT / "analysis" / "benchmarks"))
        import made

        stem = "mutants_semantic" if semantic else "mutants"
        for name, rows in ((stem, [asdict(fault) for fault in ended]), (f"{stem}_score", scores)):
            table = pd.DataFrame(rows).assign(commit=made.COMMIT)
            made.write(table, given.output / f"{name}.csv", threads=given.jobs)


if __name__ == "__main__":
    main()
