"""Tables of results with a record of how each was made, in made.csv beside them."""

import os
import platform
import subprocess
import sys
from collections.abc import Iterable
from importlib.metadata import version
from pathlib import Path

import pandas as pd

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "analysis" / "results"
RECORD = "made.csv"
LIBRARIES = ("protochain", "openmm", "numpy", "numba")


def write(table: pd.DataFrame, path: Path, inputs: Iterable[object] = (), threads: int = 1) -> None:
    """Write a table as CSV, and in made.csv beside it command, commit, machine, versions and inputs.

    A commit whose tree had other changes is marked "and changes"; inputs are named without their folders.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    table.to_csv(path, index=False)
    row = {
        "table": path.name,
        "command": command(),
        "commit": COMMIT,
        "machine": f"{processor()}, {len(os.sched_getaffinity(0))} cores",
        "threads": threads,
        "load": round(os.getloadavg()[1], 1),
        "versions": ", ".join(f"{name} {version(name)}" for name in LIBRARIES),
        "inputs": " ".join(Path(str(given)).name for given in inputs),
    }
    record = path.parent / RECORD
    rows = pd.read_csv(record, dtype=str) if record.exists() else pd.DataFrame(columns=list(row))
    rows = pd.concat([rows[rows["table"] != path.name], pd.DataFrame([row], dtype=str)])
    rows.sort_values("table").to_csv(record, index=False)


def command() -> str:
    """Command of this process, without folders other than the project's."""
    own = Path(sys.argv[0]).resolve()
    program = own.relative_to(ROOT) if own.is_relative_to(ROOT) else own.name
    given = [Path(word).name if Path(word).is_absolute() else word for word in sys.argv[1:]]
    return " ".join(["python", str(program), *given])


def commit() -> str:
    """Commit of the tree, by git."""

    def git(*words: str) -> str:
        done = subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True)
        return done.stdout.strip()

    changed = git("status", "--porcelain", "--untracked-files=no", "--", ".", ":!analysis/results", ":!*.md")
    return (git("rev-parse", "--short", "HEAD") or "none") + (" and changes" if changed else "")


def processor() -> str:
    """Name of the processor."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    return next((line.split(":")[1].strip() for line in lines if line.startswith("model name")), "unknown")


COMMIT = commit()
"""Of the tree when the command began."""
