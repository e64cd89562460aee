"""Studies to repeat on any machine: ``python analysis/bench NAME``. A new one is a module with ``run``."""

from importlib import import_module
from typing import Any

from bench.discovery import modules
from protochain.core.errors import ProtochainError

__all__ = ["STUDIES", "study"]

STUDIES = modules(__path__)
"""One line on each, by name; their modules are imported on use."""


def study(name: str) -> Any:
    """Return the module of a study, whose ``run(output, inputs)`` yields its tables."""
    if name not in STUDIES:
        raise ProtochainError(f"there is no study {name!r}; choose from {', '.join(STUDIES)}")
    return import_module(f"bench.studies.{name}")
