"""Settings of a search, for the call and the command."""

import math
from dataclasses import dataclass
from typing import Any

from protochain.chains.restraint import Restraint
from protochain.chains.restraint_lines import read_restraints
from protochain.core import defaults
from protochain.core.checks import Check, at_least, brief, flag, in_range, number, one_of, optional, plain
from protochain.core.errors import refusal
from protochain.core.settings import Settings, setting

METHODS = ("csa", "hopping", "tempering")

_LOWEST, _HIGHEST = 1.0, 1e5
_MOST = 10_000  # Limit of walks, and of replicas of each walk. Each has its own random numbers.


def _up_to_most(least: int) -> Check:
    return in_range(at_least(least), lambda n: n <= _MOST, f"give at most {_MOST}")


def interval(value: Any, name: str) -> tuple[float, float]:
    """Return two temperatures, K, the lower first, from numbers or a text such as ``300-600``."""
    parts = value.split("-") if isinstance(value, str) else plain(value, "kelvin", name)
    try:
        low, high = (float(part) for part in parts)
    except (TypeError, ValueError):
        low = high = math.nan
    if not _LOWEST <= low < high <= _HIGHEST:
        raise refusal(name, brief(value), "give two temperatures in K, the lower first, as 300-600")
    return low, high


@dataclass(frozen=True, kw_only=True)
class SearchSettings(Settings):
    """Settings that define a search, documented in :func:`protochain.search`."""

    method: str = setting(
        defaults.SEARCH, "csa (conformational space annealing), hopping or tempering.", one_of(METHODS),
        doc="``csa`` (conformational space annealing: a bank of minima is crossed), ``hopping`` (Metropolis "
        "over minima) or ``tempering`` (replica exchange, which also yields populations).",
    )  # fmt: skip
    temperatures: tuple[float, float] = setting(
        defaults.SEARCH_TEMPERATURES,
        "Lowest and highest temperature, K. hopping uses the lowest, csa none [default: 300-600].",
        interval,
        str,
        metavar="LOW-HIGH",
        type="(float, float) or str, K",
        doc='Lowest and highest, as ``"300-600"``. Hopping uses the lowest, csa none.',
    )
    n_walkers: int = setting(
        defaults.N_WALKERS,
        "Independent walks, which share the evaluations.",
        _up_to_most(1),
        int,
        "--walkers",
    )
    n_replicas: int = setting(
        defaults.N_REPLICAS, "Temperatures of each walk of tempering.", _up_to_most(2), int, "--replicas"
    )
    pilot: int = setting(
        defaults.PILOT,
        "Rounds in which tempering adjusts its temperatures, before sampling.",
        at_least(3),
        int,
        doc="Rounds of the pilot, without sampling. Use more if energies change late, as a peptide folds.",
    )
    seed: int = setting(
        defaults.SEED, "Seed of all random numbers.", at_least(0), int,
        doc="Seed of all random numbers. Results are bitwise equal for a seed, also after a kill, on any "
        "number of processes.",
    )  # fmt: skip
    restraints: tuple[Restraint, ...] = setting(
        (), "Restraint, as 'distance A:3:CA A:9:CA 0 6 1000' (angstrom, kJ/mol/nm^2), or a file of them.",
        read_restraints, list[str], "--restraints --restrain", metavar="LINE|FILE",
        type="Restraint, str, path-like, or sequence of them",
        doc="Restraints as in :func:`protochain.minimise`, as lines, or a file of them. All energies of the "
        "search include them.",
    )  # fmt: skip

    def record(self) -> dict[str, Any]:
        """Return the settings as plain values by name."""
        plain = vars(self) | {"temperatures": [*self.temperatures]}
        return plain | {"restraint": [*map(str, plain.pop("restraints"))] or None}


@dataclass(frozen=True, kw_only=True)
class SearchRunSettings(Settings):
    """Length of a search, and use of its folder. Another run may continue it with other values."""

    evaluations: int | None = setting(
        None,
        f"Total energy evaluations, with those of an earlier run [default: {defaults.SEARCH_EVALUATIONS}, "
        "unlimited with --hours].",
        optional(at_least(1)),
        int,
        doc="Total energy evaluations of all walks. The last step of each may exceed its share. Default: "
        "400,000, unlimited if ``hours`` are given.",
    )
    hours: float | None = setting(
        None,
        "Hours of this run.",
        optional(in_range(number, lambda hours: 0.0 < hours < math.inf, "give a number above 0")),
        float,
        doc="Time after which the search ends, after at least one walk has begun.",
    )
    resume: bool = setting(
        False, "Continue the search in DIR.", flag, bool,
        doc="Continue the search in the folder, also with more evaluations.",
    )  # fmt: skip
    force: bool = setting(
        False, "Replace the search in DIR.", flag, bool, doc="Replace the search in the folder."
    )

    @property
    def budget(self) -> float:
        """Total evaluations."""
        if self.evaluations is not None:
            return self.evaluations
        return defaults.SEARCH_EVALUATIONS if self.hours is None else math.inf
