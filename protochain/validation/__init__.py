"""What is wrong with a structure: violations, clashes, threaded rings, strain."""

from protochain.validation.violations import Violations, violations

__all__ = ["Violations", "violations"]
