"""Energies that users give as Python callables."""

import hashlib
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from protochain.arrays import Floats, Integers
from protochain.checks import plain
from protochain.energies.factory import energy
from protochain.energies.protocol import Energy, check_is_of
from protochain.errors import ProtochainError
from protochain.structure.model import Structure

EnergyFunction = Callable[[Floats], tuple[float, ArrayLike]]
"""Positions (na, 3) in nm to energy in kJ/mol and forces (na, 3) in kJ/mol/nm."""


class CustomEnergy:
    """Energy by a Python callable. No other engine can check it: it is its own reference.

    Parameters
    ----------
    function : callable
        Positions (na, 3) in nm -> energy in kJ/mol and forces (na, 3) in kJ/mol/nm.
    """

    engine = forcefield = solvent = "custom"
    reason = "a Python callable, judged by itself: no other engine computes it"
    system: Any = None
    atoms = ""
    threads = 1
    is_exact = True
    left_out: Mapping[str, int] = MappingProxyType({})
    lists_at: Floats | None = None

    def __init__(self, function: EnergyFunction) -> None:
        self.function, self.reference, self.name = function, self, name_of(function)
        self.fingerprint = hashlib.sha256(self.name.encode()).hexdigest()

    def without_constants(self, groups: Integers, x: Floats) -> "CustomEnergy":
        """Return itself: its terms are not known."""
        return self

    def list_at(self, x: Floats) -> None:
        """Do nothing: it has no neighbour lists."""

    def __call__(self, x: Floats) -> tuple[float, Floats]:
        """Energy in kJ/mol and forces (na, 3) in kJ/mol/nm at positions x (na, 3) in nm.

        Raises
        ------
        ProtochainError
            If the callable does not return a number and an array of the shape of x.
        """
        x = plain(x, "nanometer", "x")
        # Copies on both sides: the callable may write into its argument, or reuse its array of forces.
        returned = self.function(np.array(x))
        try:
            value, forces = returned
            value, forces = float(value), np.array(forces, dtype=np.float64, order="C")
        except (TypeError, ValueError) as error:
            raise ProtochainError(f"energy {self.name}: return (energy, forces): {error}") from None
        if forces.shape != np.shape(x):
            raise ProtochainError(
                f"energy {self.name}: return (energy, forces) with forces {np.shape(x)}, not {forces.shape}"
            )
        return value, forces

    def parts(self, x: Floats) -> tuple[dict[str, float], Floats]:
        """Energy in kJ/mol under the name of the callable, and forces (na, 3) in kJ/mol/nm."""
        value, forces = self(x)
        return {self.name: value}, forces

    def __repr__(self) -> str:
        return f"<CustomEnergy {self.name}>"


def name_of(value: Any) -> str:
    """Qualified name of a function or class, or of an object's class."""
    named = value if hasattr(value, "__qualname__") else type(value)
    return f"{named.__module__ or '__main__'}.{named.__qualname__}"


def as_energy(given: Any, structure: Structure) -> Energy:
    """Make an energy of what a caller gives.

    Parameters
    ----------
    given : Energy, callable or None
        Energy of this structure, callable as of :class:`CustomEnergy`, or None for the default force field.
    structure : Structure
        Structure whose energy it is.

    Returns
    -------
    Energy
        The given energy, or one that wraps the callable.

    Raises
    ------
    ProtochainError
        If it is neither, or was built for other atoms.
    """
    if given is None:
        return energy(structure)
    if hasattr(given, "without_constants"):
        check_is_of(given, structure)
        return given
    if not callable(given):
        raise ProtochainError(
            f"energy {given!r}: give pc.energy(structure) or a callable x -> (energy, forces)"
        )
    return CustomEnergy(given)
