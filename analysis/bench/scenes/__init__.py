"""Scenes: systems of many kinds on the core, each with its oracles, error against run time and extremes.

None of them is a protein: units are m, kg, s and N. A new one is a module with ``run(quick) -> Scene``.
"""

from collections.abc import Callable

from threadpoolctl import threadpool_limits

from bench.cases import Found, Point, Scene, plot_work
from bench.discovery import module, modules

__all__ = ["SCENES", "Found", "Point", "Scene", "plot_work", "run"]

SCENES = modules(__path__)
"""One line on each, by name; their modules are imported on use."""


def run(name: str, quick: bool = False) -> Scene:
    """Run a scene."""
    made: Callable[[bool], Scene] = module("scene", SCENES, name).run
    # As everywhere on one thread: kernels are small, and seconds are compared.
    with threadpool_limits(1, "blas"):
        return made(quick)
