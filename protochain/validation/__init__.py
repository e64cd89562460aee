"""What is wrong with a structure: violations, clashes, threaded rings, strain."""

from protochain.validation.rings import ThreadedRing, threaded_rings
from protochain.validation.violations import Violations, violations

__all__ = ["ThreadedRing", "Violations", "threaded_rings", "violations"]
