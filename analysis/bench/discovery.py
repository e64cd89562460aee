"""Scenes and studies are found by their files: a new one is a module, and no line anywhere else."""

from collections.abc import Iterable
from pathlib import Path
from pkgutil import iter_modules


def modules(folders: Iterable[str]) -> dict[str, str]:
    """Modules of a package, with the first lines of their docstrings; none is imported."""
    return {
        name: _first_line(Path(folder, name) / "__init__.py" if is_package else Path(folder, f"{name}.py"))
        for folder in folders
        for _, name, is_package in iter_modules([folder])
        if "_" not in name
    }


def _first_line(path: Path) -> str:
    with path.open(encoding="utf-8") as lines:
        return next(lines).strip().strip('"').rstrip(".")
