"""The judge of a run, which sums all pairs in double precision, and a cache of energies at its ends."""

from functools import partial
from typing import Any

import numpy as np

from protochain.core import defaults
from protochain.core.arrays import Floats
from protochain.core.interrupts import run_interruptible
from protochain.core.timings import part
from protochain.energies.native import NativeEnergy
from protochain.energies.protocol import Energy

NAMES = {
    "native": "the native engine, in double precision",
    "openmm": "OpenMM's Reference platform, in double precision",
    "custom": "the callable itself",
}
"""Names of judges by their engines. The native engine equals the Reference platform to 1e-10."""


class CachedEnergy:
    """An energy with its judge, which caches its values at two points that runs evaluate again."""

    # A cached value is used only with the same neighbour lists, so that results are equal bit for bit.

    def __init__(self, energy: Energy, judge: str = defaults.JUDGE) -> None:
        self.energy = energy
        self.judging = energy.exact if judge == defaults.JUDGE else energy.reference
        self._cache: list[tuple[Floats, Floats, tuple[float, Floats]]] = []
        """First and last point: positions, positions of the neighbour lists, energy and forces."""

    def __getattr__(self, name: str) -> Any:
        return getattr(self.energy, name)

    @property
    def judge(self) -> str:
        """Name of the judge."""
        return NAMES[self.judging.engine]

    def __call__(self, x: Floats) -> tuple[float, Floats]:
        """Energy in kJ/mol and forces (na, 3) in kJ/mol/nm at positions x (na, 3) in nm."""
        for at, lists_at, (value, forces) in self._cache:
            if lists_at is self.energy.lists_at and np.array_equal(at, x):
                return value, forces.copy()
        result = self.energy(x)
        if self.energy.lists_at is not None:
            self._cache[1:] = [(x.copy(), self.energy.lists_at, (result[0], result[1].copy()))]
        return result

    @part("judging")
    def judge_at(self, x: Floats, first: bool = False) -> tuple[float, Floats]:
        """Energy, kJ/mol, and forces (na, 3) by the judge, at a start or another point x (na, 3), nm."""
        if self.judging is self.energy:
            if first and self._cache and np.array_equal(self._cache[0][0], x):
                return self._cache[0][2]
            if first:
                self.energy.list_at(x)
            return self(x)
        choice = getattr(self.energy, "tree_measurement", None)
        if choice and self.judging is self.energy.exact and np.array_equal(choice[0], x):
            return choice[1]
        # The order of sums depends on the point only. It may take many seconds for a large protein.
        self.judging.list_at(x)
        value, forces = run_interruptible(partial(self.judging, x))
        if isinstance(self.energy, NativeEnergy) and not first:
            self.energy.note_error(self(x)[1], forces)
        return value, forces
