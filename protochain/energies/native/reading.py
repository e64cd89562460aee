"""Helpers for reading a System: plain numbers, expressions, and refusals."""

from typing import Any

import openmm
from openmm import unit

from protochain.core.errors import ForceFieldError


class UnsupportedForceError(ForceFieldError):
    """Error for a force without an exact native kernel. The text names the force.

    Parameters
    ----------
    *parts
        As of ``ProtochainError``.
    fault : Fault, optional
        As of ``ProtochainError``.
    """


def rows(force: openmm.Force, count: str, get: str) -> list[Any]:
    """Return the values of a force's getter for each index, as plain numbers in OpenMM's units."""
    # OpenMM's Python getter wraps each value in a quantity, which takes three quarters of the time.
    read = getattr(openmm.openmm._openmm, f"{type(force).__name__}_{get}", None)
    indices = range(getattr(force, count)())
    if read is None:  # In a version of OpenMM with other internals.
        return [[plain(v) if unit.is_quantity(v) else v for v in getattr(force, get)(i)] for i in indices]
    return [read(force, i) for i in indices]


def plain(value: Any) -> float:
    """Convert a value of an OpenMM getter to a number in OpenMM's units (nm, ps, amu, kJ/mol, e, rad)."""
    # OpenMM's quantities are in these units.
    return float(value._value if isinstance(value, unit.Quantity) else value)


def strip(expression: str) -> str:
    """Return an expression without blanks and final semicolon."""
    return "".join(expression.split()).rstrip(";")


def check_cutoff(name: str, cutoff: float, reference: float) -> None:
    """Refuse a force whose cutoff in nm (infinite for none) differs from NonbondedForce's cutoff."""
    if cutoff != reference:
        raise UnsupportedForceError(
            f"{name} with a cutoff of {cutoff:g} nm, NonbondedForce with {reference:g} nm"
        )
