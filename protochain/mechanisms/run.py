"""Result of a simulation: table, coordinates by name, forces of joints, pictures and audit."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from protochain.core.settings import document_fields
from protochain.mechanics import multibody
from protochain.mechanisms import pictures
from protochain.mechanisms import reactions as hinge_forces
from protochain.mechanisms.assembly import Motion

if TYPE_CHECKING:
    import pandas as pd

ROUNDED = 1e3 * float(np.finfo(float).eps)
"""Rounding error, relative to the stored energy."""


@document_fields
class Audit(NamedTuple):
    """Errors of the balances, each relative to the largest of its kind in the run."""

    # Largest change of energy that is neither work nor an event's, relative to the most in motion. If nothing
    # moves, relative to the stored energy.
    energy: float
    # Largest change of momentum, relative to the sum over the bodies. None if something acts from outside, as
    # the jump of an event that does not pass may.
    momentum: float | None
    spin: float | None  # Largest change of spin about the origin, as of momentum.
    # Largest error of a loop, a cosine or length by the size of the tree. None without loops.
    gap: float | None = None
    parting: float | None = None  # Largest rate of this error, relative to the fastest hinge.


@document_fields
@dataclass(frozen=True, eq=False)
class Run(Motion):
    """Motion of a mechanism. Its arrays are made at first use."""

    @cached_property
    def table(self) -> "pd.DataFrame":
        """One row a time: energies, work of each load, dissipation, momentum and spin about the origin."""
        import pandas as pd

        columns = {
            "time": self.time, "kinetic": self.kinetic, "potential": self.potential, "total": self.total,
        }  # fmt: skip
        columns |= {f"work {name}": self.work[:, k] for k, name in enumerate(self.model.works)}
        columns["dissipation"] = self.dissipation
        columns["events"] = self.jumps
        names = [f"{quantity} {axis}" for quantity in ("momentum", "spin") for axis in "xyz"]
        columns |= dict(zip(names, self.momenta.reshape(-1, 6).T, strict=True))
        return pd.DataFrame(columns)

    motion = cached_property(hinge_forces.motion)
    reactions = hinge_forces.reactions
    view = pictures.view
    strip = pictures.strip

    def audit(self) -> Audit:
        """Compute how far energy less work, and momentum, are from constant.

        Returns
        -------
        Audit
            Largest errors, relative.
        """
        lack = self.total - np.sum(self.work, axis=1) - self.jumps
        scale = self.in_motion if self.in_motion > ROUNDED * self.stored_energy else self.stored_energy
        energy = float(np.max(np.abs(lack - lack[0])) / scale) if scale > 0.0 else 0.0
        loops = self._loop_errors() if self.model.bodies.joints is not None else (None, None)
        strikes = {watched.name for watched in self.model.events if not watched.passes}
        if not self.model.inside or any(event.name in strikes for event in self.events):
            return Audit(energy, None, None, *loops)
        totals, sizes = self._momenta
        changes = np.max(np.linalg.norm(totals - totals[0], axis=2), axis=0)
        scales = np.max(sizes, axis=0)
        momentum, spin = np.divide(changes, scales, out=np.zeros(2), where=scales > 0.0)
        return Audit(energy, float(momentum), float(spin), *loops)

    def _loop_errors(self) -> tuple[float, float]:
        """Largest error of a loop by the size of the tree, and its rate by the fastest freedom."""
        joints, tree = self.model.bodies.joints, self.model.tree
        assert joints is not None
        units = np.where(joints.turns, 1.0, tree.size)
        gap = parting = 0.0
        for q, qd in zip(self.q, self.qd, strict=True):
            frames = multibody.pose(tree, q)
            error, rows = joints.rows(frames)
            rates = multibody.row_matrix(tree, frames, rows) @ qd
            gap = max(gap, float(np.max(np.abs(error) / units)))
            parting = max(parting, float(np.max(np.abs(rates) / units)))
        fastest = float(np.max(np.abs(self.qd) / tree.units, initial=0.0))
        return gap, parting / fastest if fastest > 0.0 else 0.0

    @property
    def in_motion(self) -> float:
        """Largest moving energy: kinetic, change of the potential, work, and events."""
        parts = self.kinetic, self.potential - self.potential[0], self.work - self.work[0], self.jumps
        return max(float(np.max(np.abs(part), initial=0.0)) for part in parts)

    @property
    def stored_energy(self) -> float:
        """Stored energy, of which rounding may move a part: its potential, weights by its size."""
        return float(abs(self.potential[-1]) + np.max(self.end.effort * self.model.tree.units, initial=0.0))
