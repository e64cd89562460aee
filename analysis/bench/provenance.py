"""Where evidence comes from: machine, threads, versions and commit."""

import platform
import subprocess
from collections.abc import Sequence
from pathlib import Path

from protochain.core.processors import processors
from protochain.results.provenance import versions

__all__ = ["commit", "made", "processor"]


def made(threads: str, libraries: Sequence[str] = ("openmm", "numpy", "scipy", "numba")) -> dict[str, str]:
    """Machine, threads, versions of the package, of Python and of some libraries, and commit."""
    known = [f"{name} {its}" for name, its in versions(*libraries).items()]
    return {
        "machine": f"{processor()}, {processors()} processors, {platform.system()}",
        "threads": threads,
        "versions": ", ".join([f"Python {platform.python_version()}", *known]),
        "commit": commit(Path(__file__).parents[2], "protochain"),
    }


def processor() -> str:
    """Look up the name of the processor.

    Returns
    -------
    str
        As the system has it.
    """
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()


def commit(root: Path, *places: str) -> str:
    """Ask git for the last commit of places in a repository, all by default, and whether they changed since.

    Parameters
    ----------
    root : Path
        Folder of the repository.
    *places : str
        Paths, as git takes them.

    Returns
    -------
    str
        Says so where it is no repository, or git is not installed.
    """
    if not (root / ".git").exists():
        return "none: an installed package"

    def git(*words: str) -> str:
        done = subprocess.run(["git", *words], cwd=root, capture_output=True, text=True)
        return done.stdout.strip()

    try:
        changed = git("status", "--porcelain", "--untracked-files=no", "--", *(places or ["."]))
        its = git("log", "-1", "--format=%h", "--", *places)
        return (its or "unknown") + (" and changes" if changed else "")
    except OSError:
        return "unknown: git is not installed"
