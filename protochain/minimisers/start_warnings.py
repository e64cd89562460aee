"""Reports of errors in a start and their treatment, before a run, and of the distance moved by a run."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from protochain.chains.contacts import overlaps
from protochain.core.arrays import Floats
from protochain.core.markup import plural
from protochain.minimisers.recipes import Recipe
from protochain.structure.molecule.model import Structure
from protochain.structure.superpose import rmsd_angstrom
from protochain.validation.rings import threaded_rings
from protochain.validation.violations import violations

FAR = 2.0  # angstrom. C-alpha RMSD from the start at which the fold differs from the input.
_SHOWN_RINGS = 3
_FROM_OVERLAPS = "from a start whose atoms overlapped; relax preserves the fold"
_HOLD = "a largest RMSD (max_rmsd) or restraints of positions"


def describe_start(structure: Structure, recipe: Recipe) -> list[str]:
    """Describe errors in a start, and their treatment by a method."""
    crowd = len(overlaps(structure, structure.positions))
    threaded, violation_counts = threaded_rings(structure), violations(structure)
    faults = [f"{plural(crowd, 'pair')} of atoms overlap"] if crowd else []
    faults += [str(violation_counts)] if violation_counts else []
    lines = ["; ".join(faults)] if faults else []
    lines += [str(ring) for ring in threaded[:_SHOWN_RINGS]]
    if len(threaded) > _SHOWN_RINGS:
        lines.append(f"and {len(threaded) - _SHOWN_RINGS} more threaded rings")
    if crowd or threaded:
        lines.append(f"{recipe.name}: {_way(recipe, bool(threaded))}; relax preserves the fold")
    return lines


def _way(recipe: Recipe, threaded: bool) -> str:
    frees = threaded and bool(recipe.runs) and not recipe.in_torsions
    if not (recipe.parts_overlaps or frees):
        return "does not resolve overlaps under restraints first, and may end far from the start"
    ring = "pulls bonds out of rings, " if threaded else ""
    if not recipe.keeps_geometry:
        return f"{ring}resolves overlaps under restraints, which are then removed"
    ring = "; this rarely frees threaded rings: cartesian moves all atoms" if threaded else ""
    return f"resolves overlaps by turning bonds under restraints, which are then removed{ring}"


def is_crowded(structure: Structure) -> bool:
    """Whether atoms of a structure overlap, or a bond passes through a ring."""
    return bool(overlaps(structure, structure.positions) or threaded_rings(structure))


@dataclass
class StrayWatcher:
    """Watcher of a run from a start with overlaps, which reports once if the run has moved far away."""

    structure: Structure  # The start.
    report: Callable[[str], None]  # Called with the line.
    is_reported: bool = False  # Whether it has been called.

    def __call__(self, x: Floats) -> None:
        """Check positions (na, 3) of the run."""
        if not self.is_reported and (line := describe_stray(self.structure, x)):
            self.is_reported = True
            self.report(line)


def describe_stray(structure: Structure, x: Floats) -> str:
    """Describe the distance of positions (na, 3) from a start with overlaps. It is empty within ``FAR``."""
    alpha = structure.alpha_carbons
    if len(alpha) <= 2 or not np.isfinite(x[alpha]).all():
        return ""
    away = rmsd_angstrom(x[alpha], structure.positions[alpha])
    return f"{away:.1f} angstrom {_FROM_OVERLAPS}" if away > FAR else ""


def describe_rmsd(away: float, recipe: Recipe, start: Structure, turned: bool) -> str:
    """Describe the distance of an end from its start, angstrom, and options to stay nearer."""
    if not away > FAR or len(start.alpha_carbons) <= 2:
        return ""
    if turned:
        return f"{away:.1f} angstrom from the input; to stay nearer: a smaller spread"
    near = f"cartesian with {_HOLD}" if recipe.by_openmm else _HOLD
    near = f"cartesian, {_HOLD}" if recipe.in_torsions else near
    origin = _FROM_OVERLAPS if is_crowded(start) else "from its start"
    return f"{away:.1f} angstrom {origin}; to stay nearer: {near}"
