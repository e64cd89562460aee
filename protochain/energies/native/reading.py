"""Helpers for reading a System: plain numbers, expressions, and refusals."""

from typing import Any

from openmm import unit

from protochain.core.errors import ForceFieldError


class UnsupportedForceError(ForceFieldError):
    """A force for which there is no exact native kernel; its text names the force.

    Parameters
    ----------
    *parts
        As of ``ProtochainError``.
    fault : Fault, optional
        As of ``ProtochainError``.
    """


def plain(value: Any) -> float:
    """Return what a getter of OpenMM returns as a number in OpenMM's units (nm, ps, amu, kJ/mol, e, rad).

    Its quantities are in these units; to convert each of some hundred thousand would take a second.
    """
    return float(value._value if isinstance(value, unit.Quantity) else value)


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
