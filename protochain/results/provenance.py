"""Provenance of results: versions and command, and remarks in files."""

import platform
import shlex
import sys
from collections.abc import Iterable, Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any


def versions(*libraries: str) -> dict[str, str]:
    """Versions of the package and of libraries, by name."""
    return {name: version(name) for name in ("protochain", *libraries)}


def command() -> list[str]:
    """Words of the command of this process, as typed, also for ``python -m protochain``."""
    as_module = Path(sys.argv[0]).parts[-2:] == ("protochain", "__main__.py")
    return ["python", "-m", "protochain", *sys.argv[1:]] if as_module else sys.argv


def command_line() -> str:
    """Command of this process, quoted for a shell."""
    return shlex.join(command())


def of_run(*libraries: str) -> dict[str, Any]:
    """Command line, Python and versions of this process."""
    return {"command": command(), "python": platform.python_version(), "versions": versions(*libraries)}


def remarks(
    result: Any,
    method: str,
    energies: tuple[float, float],
    judge: str,
    rmsds: tuple[float, float],
    how: Iterable[str] = (),
) -> Iterator[str]:
    """Lines of remarks in the file of a result: energies kJ/mol, rmsds angstrom."""
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
    if len(motion := result.ligand_motion):
        rmsd, farthest = motion.max(axis=0)
        yield f"LIGAND RMSD {rmsd:.3f}, LARGEST DISPLACEMENT {farthest:.3f} ANGSTROM, NOT SUPERPOSED"
