"""Energies of users' Python callables."""

import hashlib
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from protochain.core.arrays import Floats, Integers
from protochain.core.checks import brief, plain
from protochain.core.errors import Fault, ProtochainError

EnergyFunction = Callable[[Floats], tuple[float, ArrayLike]]
"""Positions (na, 3) in nm to energy in kJ/mol and forces (na, 3) in kJ/mol/nm."""
_DISPLACEMENT = 0.005  # nm. Deviation of each coordinate, too small to make atoms overlap.
_STEPS = (1e-5, 1e-4, 1e-3)
"""nm. The first is for double precision: terms are nonlinear over some 0.01 nm. The last is for single
precision: 1e-7 of a million kJ/mol, over 1e-3 nm, is 1e2 kJ/mol/nm. The check passes if one step does."""
_TOLERANCE = 0.02
"""Relative to the slope. Truncation is less than a hundredth at all steps unless atoms overlap. Forces with a
wrong factor, sign or part differ by more."""
_ROUNDING = 64 * float(np.finfo(float).eps)  # Rounding error relative to an energy, for some dozen sums.


class CustomEnergy:
    """Energy by a Python callable. No other engine can check it, so it is its own reference.

    Parameters
    ----------
    function : callable
        Positions (na, 3) in nm -> energy in kJ/mol and forces (na, 3) in kJ/mol/nm.
    """

    engine = forcefield = solvent = "custom"
    device = "cpu"
    reason = "a Python callable, judged by itself: no other engine computes it"
    system: Any = None
    atoms = ""
    threads = 1
    is_exact = True
    left_out: Mapping[str, int] = MappingProxyType({})
    settings: Mapping[str, Any] = MappingProxyType({})
    lists_at: Floats | None = None

    def __init__(self, function: EnergyFunction) -> None:
        self.function, self.name = function, name_of(function)
        self.reference = self.exact = self
        self.fingerprint = hashlib.sha256(self.name.encode()).hexdigest()

    def without_constants(self, groups: Integers, x: Floats) -> "CustomEnergy":
        """Return itself, because its terms are not known."""
        return self

    def list_at(self, x: Floats) -> None:
        """Do nothing, because it has no neighbour lists."""

    def __call__(self, x: Floats) -> tuple[float, Floats]:
        """Energy in kJ/mol and forces (na, 3) in kJ/mol/nm at positions x (na, 3) in nm."""
        return call_user(self.function, plain(x, "nanometer", "x"), f"energy {self.name}")

    def parts(self, x: Floats) -> tuple[dict[str, float], Floats]:
        """Energy in kJ/mol under the name of the callable, and forces (na, 3) in kJ/mol/nm."""
        value, forces = self(x)
        return {self.name: value}, forces

    def __repr__(self) -> str:
        return f"<CustomEnergy {self.name}>"


def call_user(function: EnergyFunction, x: Floats, name: str) -> tuple[float, Floats]:
    """Call a user's function for energy and forces (na, 3) at positions x (na, 3) in nm."""
    # Copies on both sides: the callable may write into its argument, or reuse its array of forces.
    returned = function(np.array(x))
    if not isinstance(returned, tuple | list) or len(returned) != 2:
        raise ProtochainError(f"{name}: return (energy, forces), not {brief(returned)}")
    value, forces = (_real(part) for part in returned)
    if value is None or value.size != 1 or forces is None:
        values = f"{brief(returned[0])} and {brief(returned[1])}"
        raise ProtochainError(f"{name}: return (energy, forces), a real number and an array, not {values}")
    if forces.shape != np.shape(x):
        raise ProtochainError(
            f"{name}: return (energy, forces) with forces of shape {np.shape(x)}, not {forces.shape}",
            fault=Fault.SHAPE,
        )
    return float(value.item()), np.array(forces, dtype=np.float64, order="C")


def _real(value: Any) -> NDArray[Any] | None:
    """Array of real numbers, or None for any other value."""
    try:
        array = np.asarray(value)
    except (TypeError, ValueError, RuntimeError):
        return None
    return array if array.dtype.kind in "biuf" else None


def check_forces(function: EnergyFunction, x: Floats, name: str) -> None:
    """Refuse forces that are not the derivative of a callable's energy, by a difference along one line."""
    # The line starts near x (na, 3), where springs to the start act, along forces plus a random direction.
    # The slope is then at least as large as the forces, so errors by a factor or in a part are visible.
    rng = np.random.default_rng(0)
    center = x + _DISPLACEMENT * rng.normal(size=x.shape)
    value, forces = call_user(function, center, name)
    if not (np.isfinite(value) and np.isfinite(forces).all()):
        return
    size = float(np.linalg.norm(forces))
    line = rng.normal(size=x.shape)
    line = (line if np.vdot(line, forces) >= 0.0 else -line) + (forces / size if size > 0.0 else 0.0)
    force_slope = -float(np.vdot(forces, line))
    slope = np.nan
    for step in _STEPS:
        (up, _), (down, _) = (call_user(function, center + sign * step * line, name) for sign in (1.0, -1.0))
        slope = (up - down) / (2.0 * step)
        rounding = _ROUNDING * (abs(value) + 1.0) / step
        # NaN is not larger: the run handles values that are not finite.
        if not abs(slope - force_slope) > _TOLERANCE * max(abs(slope), abs(force_slope)) + rounding:
            return
    raise ProtochainError(
        f"{name}: its forces are not those of its energy, whose slope along a line is {slope:.4g} kJ/mol/nm "
        f"where they say {force_slope:.4g}; return forces -dE/dx, in kJ/mol/nm"
    )


def name_of(value: Any) -> str:
    """Qualified name of a function or class, or of an object's class."""
    definition = value if hasattr(value, "__qualname__") else type(value)
    return f"{definition.__module__ or '__main__'}.{definition.__qualname__}"
