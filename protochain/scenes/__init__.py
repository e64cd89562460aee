"""Scenes: systems of many kinds on the core, each with its oracles, error against run time and extremes.

None of them is a protein: units are m, kg, s and N. A new one is a module with ``run(quick) -> Scene``, and
its line in ``SCENES``. (``protochain bench scenes`` is something else: runs of proteins.)
"""

from collections.abc import Callable
from importlib import import_module

from threadpoolctl import threadpool_limits

from protochain.core.errors import ProtochainError
from protochain.lab.cases import Check, Extreme, LeftOut, Scene, plot_work

__all__ = ["SCENES", "Check", "Extreme", "LeftOut", "Scene", "plot_work", "run"]

SCENES = {
    "serial": "serial chains of revolute hinges: M^-1 by three routes, long, light, thin and straight",
    "impact": "impacts with friction by Newton, Poisson and Stronge; one point, several, loops",
    "gear": "spur gears: teeth on springs, flanks that press on each other, against ISO 6336 and scipy",
    "bucket": "a backhoe's bucket in a soil of cubes: slopes, weights, work of drives, bushings, sleep",
    "beam": "a cantilever of finite segments: frequencies, rotation, spin-up, rigid ends, limits",
    "manipulator": "an arm of three flexible links: cells, explicit and implicit integrators, rigid ends",
    "canonical": "chains of links that bend: momenta against accelerations, three ways to rates",
    "helicopter": "a helicopter that lands: ground resonance, touchdown, run-up, gusts, limits",
    "gun": "a gun on a deck: recoil, a tube that bends, and if a soft axle keeps its muzzle still",
}
"""One line on each, by name; their modules are imported on use."""


def run(name: str, quick: bool = False) -> Scene:
    """Run a scene.

    Parameters
    ----------
    name : str
        One of ``SCENES``.
    quick : bool
        Small cases only: some seconds, instead of up to two minutes.

    Returns
    -------
    Scene
        Checks, work, extremes and what was left out.

    Raises
    ------
    ProtochainError
        If there is no such scene.
    """
    check_name(name)
    made: Callable[[bool], Scene] = import_module(f"{__name__}.{name}").run
    # As everywhere on one thread: kernels are small, and seconds are compared.
    with threadpool_limits(1, "blas"):
        return made(quick)


def check_name(name: str) -> None:
    """Raise ProtochainError, which lists the scenes, if none has this name."""
    if name not in SCENES:
        raise ProtochainError(f"there is no scene {name!r}; choose from {', '.join(SCENES)}")
