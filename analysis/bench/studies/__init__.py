"""Studies to repeat on any machine: ``python analysis/bench NAME``. A new one is a module with ``run``."""

from typing import Any

from bench.discovery import module, modules

__all__ = ["STUDIES", "study"]

STUDIES = modules(__path__)
"""One line on each, by name; their modules are imported on use."""


def study(name: str) -> Any:
    """Return the module of a study, whose ``run(output, inputs)`` yields its tables."""
    return module("study", STUDIES, name)
