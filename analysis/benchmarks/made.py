"""Parser of all benchmarks, and the record of tables, pictures and notebooks in made.csv."""

import argparse
import hashlib
import os
import shlex
import subprocess
import sys
from collections.abc import Callable, Iterable, Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from time import monotonic
from typing import Any

import numpy as np
import pandas as pd

ROOT = Path(__file__).parents[2]
sys.path.insert(1, str(ROOT / "analysis"))  # Where benchmarks find bench.
SAMPLES = ROOT / "structures"
MORE = ROOT.parent / "shared" / "structures"
"""Default of --more: the larger collection, which is not in the repository."""
HELD_OUT = (
    "1a1p_compstatin.pdb", "5vav_cyclic.pdb", "3jqh_altloc.cif", "3al1_caps_altloc.pdb",
    "3znf_zinc_finger.pdb", "1grm_gramicidin.pdb", "1v6p_cobrotoxin_amber.pdb", "1cih_scop_oldcols.pdb",
    "2beg_abeta_fibril.pdb", "4cup_missing.cif", "1bhl_gap_cas.pdb", "dhfr_jac_amber.pdb",
)  # fmt: skip
"""Of that collection: 208 to 2,489 atoms, no protein of the samples, none that a minimiser was tuned on."""
RESULTS = ROOT / "analysis" / "results"
DOCS = ROOT / "analysis" / "docs"
RECORD = "made.csv"
_last = monotonic()
"""When this process began, or wrote its last table."""
LIBRARIES = ("protochain", "openmm", "numpy", "scipy", "numba", "gemmi", "pin", "dartpy")


def parser(text: str, studies: Iterable[str] = (), more: bool = False) -> argparse.ArgumentParser:
    """Return the parser of a benchmark: its studies, -o DIR, --quick and, if need be, --more FOLDER."""
    own = argparse.ArgumentParser(description=text, formatter_class=argparse.RawDescriptionHelpFormatter)
    if studies:
        own.add_argument("studies", nargs="*", metavar="STUDY", choices=[*studies, []], help="all by default")
    own.add_argument("-o", "--output", type=Path, metavar="DIR", help="folder for its tables, and figures")
    own.add_argument("--quick", action="store_true", help="small inputs: shows that it works, no more")
    if more:
        own.add_argument("--more", type=Path, default=MORE, metavar="FOLDER", help="of further structures")
    return own


def study(
    options: argparse.Namespace,
    tables: Mapping[str, Callable[[argparse.Namespace], pd.DataFrame]],
    stem: str,
    inputs: Callable[[str, pd.DataFrame], Iterable[object]],
    threads: int = 1,
) -> dict[str, pd.DataFrame]:
    """Make the tables that are asked for, all by default; print each, and write it as STEM_NAME.csv."""
    made = {}
    for name in options.studies or tables:
        made[name] = table = tables[name](options)
        print(f"\n{tables[name].__doc__}\n\n{markdown(table)}", flush=True)
        if options.output:
            write(table, options.output / f"{stem}_{name}.csv", inputs(name, table), threads)
    return made


def markdown(table: pd.DataFrame) -> str:
    """Table as README shows it."""
    cells = [[f"{v:.4g}" if isinstance(v, float) else str(v) for v in row] for row in table.to_numpy(object)]
    lines = [list(table.columns), ["---"] + ["--:"] * (len(table.columns) - 1), *cells]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def write(
    table: pd.DataFrame,
    path: Path,
    inputs: Iterable[object] = (),
    threads: int = 1,
    by: list[str] | None = None,
    seconds: float | None = None,
) -> None:
    """Write a table as CSV, and its row in made.csv next to it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    table.to_csv(path, index=False)
    record(path, path.parent, inputs, threads, by, seconds)


def draw(figure: Any, path: Path, inputs: Iterable[object] = ()) -> None:
    """Write a matplotlib figure as SVG, and its row in made.csv next to it."""
    from protochain.core.figure import image

    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(image(figure, "svg"))
    record(path, path.parent, inputs)


def record(
    path: Path,
    folder: Path,
    inputs: Iterable[object] = (),
    threads: int = 1,
    by: list[str] | None = None,
    seconds: float | None = None,
) -> None:
    """Write the row of a file in made.csv: command, commit, machine, seconds, versions, inputs and digest.

    A commit whose tree had other changes is marked "and changes". Inputs are named without their folders.
    The command is that of this process, or ``by``. The seconds are those since its last file, or ``seconds``.
    """
    from bench.provenance import processor

    global _last
    if seconds is None:
        seconds, _last = monotonic() - _last, monotonic()
    row = {
        "table": path.name, "command": command(by), "commit": COMMIT,
        "machine": f"{processor()}, {len(os.sched_getaffinity(0))} cores", "threads": threads,
        "load": round(os.getloadavg()[1], 1), "seconds": round(seconds, 1),
        "versions": ", ".join(f"{name} {number}" for name in LIBRARIES if (number := _version(name))),
        "inputs": " ".join(Path(str(item)).name for item in inputs), "digest": digest(path),
    }  # fmt: skip
    place = folder / RECORD
    rows = pd.read_csv(place, dtype=str) if place.exists() else pd.DataFrame(columns=list(row))
    rows = pd.concat([rows[rows["table"] != path.name], pd.DataFrame([row], dtype=str)])
    rows.sort_values("table").to_csv(place, index=False)


def digest(path: Path) -> str:
    """First 16 digits of the SHA-256 of a file: it shows whether the file is the one of its row."""
    return hashlib.sha256(path.read_bytes()).hexdigest()[:16]


def surroundings(**more: str) -> dict[str, str]:
    """Environment of a command that is timed: modules are compiled once, as `pip install` does.

    Where Python is told to write no bytecode, each start would compile all of an editable installation anew.
    """
    return {name: its for name, its in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"} | more


def command(words: list[str] | None = None) -> str:
    """Command of this process, or one, as others would type it: -o DIR, MORE for the folder of --more."""
    program, *given = words or ["python", *sys.argv]
    folders = {"-o": "DIR", "--output": "DIR", "--gallery": "DIR", "--kept": "KEPT", "--more": "MORE"}
    shown = [
        folders.get(before) or _shown(word) for before, word in zip([program, *given], given, strict=False)
    ]
    return shlex.join(["python" if program == sys.executable else Path(program).name, *shown])


def _shown(word: str) -> str:
    path = Path(word)
    if path.is_file():
        path = Path(os.path.abspath(path))  # noqa: PTH100 - samples may be links
    if not path.is_absolute():
        return word
    for folder, name in ((ROOT, Path()), (MORE, Path("MORE"))):
        if path.is_relative_to(folder):
            return str(name / path.relative_to(folder))
    return path.name


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return ""


def kept(path: Path, make: Callable[[], np.ndarray]) -> np.ndarray:
    """Array of a file, which is made, and written as a whole, if it is not there."""
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        begun = path.with_suffix(".begun.npy")
        np.save(begun, make())
        begun.replace(path)
    return np.load(path)


def kept_rows(path: Path, make: Callable[[], Iterable[Mapping[str, object]] | pd.DataFrame]) -> pd.DataFrame:
    """Rows of a CSV file, which are made, and written as a whole, if it is not there."""
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        begun = path.with_suffix(".begun")
        pd.DataFrame(make()).to_csv(begun, index=False)
        begun.replace(path)
    return pd.read_csv(path)


CODE = (
    "protochain",
    "analysis/bench",
    "analysis/benchmarks",
    ":(exclude)analysis/benchmarks/pages.py",
    ":(exclude)analysis/benchmarks/tables",
    "tests/fixtures",
    "structures",
    "pyproject.toml",
)
"""What tables are made from, as git takes it: not results and pages, nor what shows them, which change."""


def commit() -> str:
    """Commit of the tree, by git."""
    from bench.provenance import commit as commit_of

    return commit_of(ROOT, *CODE)


def is_of_today(its: str) -> bool:
    """Whether the code of a commit is that of today, to the last change; no if either has other changes."""
    if " " in f"{its}{COMMIT}":
        return False
    words = ["git", "diff", "--quiet", its, "--", *CODE]
    return its == COMMIT or subprocess.run(words, cwd=ROOT, stderr=subprocess.DEVNULL).returncode == 0


COMMIT = commit()
"""Of the tree when the command began."""
