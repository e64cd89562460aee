"""What is wrong with a structure: violations, clashes, threaded rings, strain, statistical outliers."""

from protochain.validation.api import measures, validate
from protochain.validation.found import MEASURES
from protochain.validation.likeness import LIKENESS, likeness
from protochain.validation.result import Validation
from protochain.validation.rings import ThreadedRing, threaded_rings
from protochain.validation.violations import Violations, violations

__all__ = [
    "LIKENESS",
    "MEASURES",
    "ThreadedRing",
    "Validation",
    "Violations",
    "likeness",
    "measures",
    "threaded_rings",
    "validate",
    "violations",
]
