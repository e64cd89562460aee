"""Scenes and studies are found by their files: a new one is a module, and no line anywhere else."""

from collections.abc import Iterable, Mapping
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from typing import Any

from protochain.core.errors import ProtochainError


def modules(folders: Iterable[str]) -> dict[str, str]:
    """Modules of a package, with the first lines of their docstrings; none is imported."""
    return {
        name: _first_line(Path(folder, name) / "__init__.py" if is_package else Path(folder, f"{name}.py"))
        for folder in folders
        for _, name, is_package in iter_modules([folder])
        if "_" not in name
    }


def module(kind: str, known: Mapping[str, str], name: str) -> Any:
    """Module of a scene or study; ProtochainError, which lists all, if none has this name."""
    if name not in known:
        raise ProtochainError(f"there is no {kind} {name!r}; choose from {', '.join(known)}")
    return import_module(f"bench.{'scenes' if kind == 'scene' else 'studies'}.{name}")


def _first_line(path: Path) -> str:
    with path.open(encoding="utf-8") as lines:
        return next(lines).strip().strip('"').rstrip(".")
