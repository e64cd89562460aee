"""Where results come from: machine, threads, versions, command and commit, and how a file says so."""

import platform
import shlex
import subprocess
import sys
from collections.abc import Iterable, Iterator, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from protochain.core.processors import processors


def versions(*libraries: str) -> dict[str, str]:
    """Versions of the package and of libraries, by name."""
    return {name: version(name) for name in ("protochain", *libraries)}


def command_line() -> str:
    """Command of this process, as a shell takes it."""
    return shlex.join(sys.argv)


def of_run(*libraries: str) -> dict[str, Any]:
    """Command line, Python and versions of this process."""
    return {"command": sys.argv, "python": platform.python_version(), "versions": versions(*libraries)}


def remarks(
    result: Any,
    method: str,
    energies: tuple[float, float],
    judge: str,
    rmsds: tuple[float, float],
    how: Iterable[str] = (),
) -> Iterator[str]:
    """Lines of the file of a result: energies kJ/mol, rmsds angstrom."""
    e = result.energy_function
    yield f"PROTOCHAIN {version('protochain')}, METHOD {method}, STATUS {result.status}"
    yield f"WITH OPENMM {version('openmm')}, GEMMI {version('gemmi')}"
    yield f"FORCE FIELD {e.forcefield}, SOLVENT {e.solvent}, ENGINE {e.engine}"
    yield from how
    yield f"ENERGY {energies[1]:.4f} KJ/MOL BEFORE ROUNDING, AT THE START {energies[0]:.4f}"
    yield f"ENERGIES BY {judge.upper()}"
    yield (
        f"C-ALPHA RMSD TO THE START {rmsds[0]:.3f} ANGSTROM, AS FILED {rmsds[1]:.3f}, "
        f"{str(result.frame).upper()}"
    )


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
    """Ask git for the commit of a repository, and whether there are changes in places of it, all by default.

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
        return (git("rev-parse", "--short", "HEAD") or "unknown") + (" and changes" if changed else "")
    except OSError:
        return "unknown: git is not installed"
