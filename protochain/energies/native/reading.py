"""Helpers for reading a System: plain numbers, expressions, and refusals."""

from functools import lru_cache
from typing import Any

from openmm import unit

from protochain.errors import ForceFieldError


class UnsupportedForceError(ForceFieldError):
    """A force for which there is no exact native kernel; its text names the force."""


def plain(value: Any) -> float:
    """Return a quantity as a number in OpenMM's units (nm, ps, amu, kJ/mol, e, rad)."""
    # Tens of thousands are read, all in a few units: OpenMM's own conversion compares units each time.
    return float(value._value * _factor(value.unit) if isinstance(value, unit.Quantity) else value)


@lru_cache(maxsize=64)
def _factor(its_unit: unit.Unit) -> float:
    return float(unit.Quantity(1.0, its_unit).value_in_unit_system(unit.md_unit_system))


def bare(expression: str) -> str:
    """Return an expression without blanks and closing semicolon."""
    return "".join(expression.split()).rstrip(";")


def one_cutoff(name: str, cutoff: float, other: float) -> None:
    """Refuse a force whose cutoff (nm; infinite for none) differs from that of NonbondedForce.

    Raises
    ------
    UnsupportedForceError
        Naming both cutoffs.
    """
    if cutoff != other:
        raise UnsupportedForceError(
            f"{name} with a cutoff of {cutoff:g} nm, NonbondedForce with {other:g} nm"
        )
