"""Helpers for reading a System: plain numbers, expressions, and refusals."""

from typing import Any

import numpy as np
import openmm
from openmm import unit

from protochain.core.arrays import Floats
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


def tables(force: openmm.Force) -> dict[str, Floats]:
    """Tabulated functions of two variables of a force, by name."""
    values_of = {}
    for i in range(force.getNumTabulatedFunctions()):
        width, height, values = force.getTabulatedFunction(i).getFunctionParameters()
        values_of[force.getTabulatedFunctionName(i)] = np.array(values).reshape(height, width).T
    return values_of


def plain(value: Any) -> float:
    """Convert a value of an OpenMM getter to a number in OpenMM's units (nm, ps, amu, kJ/mol, e, rad)."""
    # OpenMM's quantities are in these units.
    return float(value._value if isinstance(value, unit.Quantity) else value)


def strip(expression: str) -> str:
    """Return an expression without blanks and final semicolon."""
    return "".join(expression.split()).rstrip(";")
