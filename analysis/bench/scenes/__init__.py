"""Scenes: systems of many kinds on the core, each with its oracles, error against run time and extremes.

None of them is a protein: units are m, kg, s and N. A new one is a module with ``run(quick) -> Scene``.
(``python analysis/bench scenes`` is something else: runs of proteins.)
"""

from collections.abc import Callable
from importlib import import_module

from threadpoolctl import threadpool_limits

from bench.cases import Found, Point, Scene, plot_work
from bench.discovery import modules
from protochain.core.errors import ProtochainError

__all__ = ["SCENES", "Found", "Point", "Scene", "plot_work", "run"]

SCENES = modules(__path__)
"""One line on each, by name; their modules are imported on use."""


def run(name: str, quick: bool = False) -> Scene:
    """Run a scene."""
    check_name(name)
    made: Callable[[bool], Scene] = import_module(f"{__name__}.{name}").run
    # As everywhere on one thread: kernels are small, and seconds are compared.
    with threadpool_limits(1, "blas"):
        return made(quick)


def check_name(name: str) -> None:
    """Raise ProtochainError, which lists the scenes, if none has this name."""
    if name not in SCENES:
        raise ProtochainError(f"there is no scene {name!r}; choose from {', '.join(SCENES)}")
