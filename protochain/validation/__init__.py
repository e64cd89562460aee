"""What is wrong with a structure: violations, clashes, threaded rings, strain, outliers of many structures."""

from protochain.validation.api import MEASURES, measures
from protochain.validation.violations import Violations, violations

__all__ = ["MEASURES", "Violations", "measures", "violations"]
