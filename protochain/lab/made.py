"""Where results come from: machine, threads, versions and commit."""

import platform
import subprocess
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path

from protochain.processors import processors


def made(threads: str, libraries: Sequence[str] = ("openmm", "numpy", "scipy", "numba")) -> dict[str, str]:
    """Machine, threads, versions of the package, of Python and of some libraries, and commit."""
    versions = [f"{name} {version(name)}" for name in ("protochain", *libraries)]
    return {
        "machine": f"{processor()}, {processors()} processors, {platform.system()}",
        "threads": threads,
        "versions": ", ".join([f"Python {platform.python_version()}", *versions]),
        "commit": _commit(),
    }


def processor() -> str:
    """Name of the processor."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()


def _commit() -> str:
    """Commit of the package's own repository, and whether it had changes; of an installed one, none."""
    package = Path(__file__).parents[1]
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
