"""What is wrong with a structure: violations, clashes, threaded rings, strain."""

from protochain.validation.clashes import Clashes, clashes
from protochain.validation.rings import ThreadedRing, threaded_rings
from protochain.validation.strain import Strain, strain
from protochain.validation.violations import Violations, violations

__all__ = [
    "Clashes",
    "Strain",
    "ThreadedRing",
    "Violations",
    "clashes",
    "strain",
    "threaded_rings",
    "violations",
]
