"""One loop; directions times step rules; OpenMM's minimiser as the reference."""

from protochain.minimisers.api import minimise
from protochain.minimisers.methods import METHODS
from protochain.minimisers.solution import Solution
from protochain.minimisers.starts import Starts, explore
from protochain.minimisers.verdict import Judgement, Status

minimize = minimise

__all__ = [
    "METHODS",
    "Judgement",
    "Solution",
    "Starts",
    "Status",
    "explore",
    "minimise",
    "minimize",
]
