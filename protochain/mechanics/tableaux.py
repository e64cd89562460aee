"""Butcher tableaux of explicit Runge-Kutta methods."""

from dataclasses import dataclass
from functools import cached_property

from protochain.core.arrays import Floats, read_only


@dataclass(frozen=True)
class Tableau:
    """Butcher tableau of an explicit method: a, b (s, s), (s,); b less the weights embedded, error (s,)."""

    a: tuple[tuple[float, ...], ...]
    b: tuple[float, ...]
    error: tuple[float, ...]

    @cached_property
    def arrays(self) -> tuple[Floats, Floats, Floats]:
        """(s, s), (s,) and (s,) float: all of it."""
        return read_only(self.a), read_only(self.b), read_only(self.error)


CLASSICAL = Tableau(
    a=((0.0, 0.0, 0.0, 0.0), (1 / 2, 0.0, 0.0, 0.0), (0.0, 1 / 2, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0)),
    b=(1 / 6, 1 / 3, 1 / 3, 1 / 6),
    error=(0.0, 0.0, 0.0, 0.0),
)
"""Kutta (1901)."""

_FIFTH = (35 / 384, 0.0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84, 0.0)
DORMAND_PRINCE = Tableau(
    a=(
        (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
        (1 / 5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
        (3 / 40, 9 / 40, 0.0, 0.0, 0.0, 0.0, 0.0),
        (44 / 45, -56 / 15, 32 / 9, 0.0, 0.0, 0.0, 0.0),
        (19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729, 0.0, 0.0, 0.0),
        (9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656, 0.0, 0.0),
        _FIFTH,
    ),
    b=_FIFTH,
    error=(71 / 57600, 0.0, -71 / 16695, 71 / 1920, -17253 / 339200, 22 / 525, -1 / 40),
)
"""Dormand, Prince, J. Comput. Appl. Math. 6:19 (1980), RK5(4)7M."""
