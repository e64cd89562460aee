"""Faults of a structure: violations, clashes, threaded rings, strain, statistical outliers."""

from protochain.validation.clashes import Clashes, clashes
from protochain.validation.findings import MEASURES
from protochain.validation.interface import CONFIDENCES, MAKEUP, SCORES, Interface, score_interface
from protochain.validation.ligands import LigandFound
from protochain.validation.likeness import LIKENESS, likeness
from protochain.validation.rings import ThreadedRing, threaded_rings
from protochain.validation.strain import Strain, strain
from protochain.validation.validate_structure import Validation, measures, validate
from protochain.validation.violations import Violations, violations

__all__ = [
    "CONFIDENCES",
    "LIKENESS",
    "MAKEUP",
    "MEASURES",
    "SCORES",
    "Clashes",
    "Interface",
    "LigandFound",
    "Strain",
    "ThreadedRing",
    "Validation",
    "Violations",
    "clashes",
    "likeness",
    "measures",
    "score_interface",
    "strain",
    "threaded_rings",
    "validate",
    "violations",
]
