"""Page of the curves: each with its picture, with what it says, and with its points."""

import platform
import subprocess
from base64 import b64encode
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path

import pandas as pd

from protochain.analysis.viewer import template
from protochain.processors import processors
from protochain.storage import write_atomically

PICTURES = {"minimisers": "precision"}
"""Names of pictures that are not those of their kinds."""


def write_page(
    folder: Path, parts: Sequence[tuple[str, str, str, list[str]]], tables: Mapping[str, pd.DataFrame]
) -> None:
    """Write ``report.html``.

    Parameters
    ----------
    folder : Path
        Where the pictures are.
    parts : sequence of (str, str, str, list of str)
        Name, title, what is measured, and sentences of each kind.
    tables : mapping of str to pandas.DataFrame
        Points by name of the kind.
    """
    shown = [
        {
            "name": name,
            "title": title,
            "measured": measured,
            "said": sentences,
            "picture": _data_url(folder / f"{PICTURES.get(name, name)}.png"),
            "points": tables[name].to_dict("records"),
        }
        for name, title, measured, sentences in parts
    ]
    text = template("curves.html").render(parts=shown, made=made())
    write_atomically(folder / "report.html", lambda to: to.write_text(text, encoding="utf-8"))


def made() -> dict[str, str]:
    """Machine, threads, versions and commit."""
    versions = [f"{name} {version(name)}" for name in ("protochain", "openmm", "numpy", "scipy", "numba")]
    return {
        "machine": f"{_processor()}, {processors()} processors, {platform.system()}",
        "threads": f"1, of minimisers {processors()}",
        "versions": ", ".join([f"Python {platform.python_version()}", *versions]),
        "commit": _commit(),
    }


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()


def _commit() -> str:
    """Commit of the package's own repository, and whether it had changes; of an installed one, none."""
    package = Path(__file__).parents[3]
    if not (package.parent / ".git").exists():
        return "none: an installed package"

    def git(*words: str) -> str:
        done = subprocess.run(["git", *words], cwd=package, capture_output=True, text=True)
        return done.stdout.strip()

    try:
        changed = git("status", "--porcelain", "--untracked-files=no", "--", ".")
        return (git("rev-parse", "--short", "HEAD") or "unknown") + (" and changes" if changed else "")
    except OSError:
        return "unknown: git is not installed"


def _data_url(path: Path) -> str:
    return f"data:image/png;base64,{b64encode(path.read_bytes()).decode()}" if path.exists() else ""
