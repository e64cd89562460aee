"""Restraint of one coordinate between two bounds, and its line of text."""

import math
import re
import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Self

from protochain.core.checks import at_least, check_fields, integer, number, one_of, text, words
from protochain.core.errors import ProtochainError, refusal
from protochain.core.settings import document_fields

STIFFNESS = 1000.0  # kJ/mol/nm^2, or of dihedrals kJ/mol/rad^2.
EXAMPLE = "distance A:3:CA A:9:CA 0 6 1000"
PLACES = {
    "distance": range(2, 10_000, 2), "mean-distance": (2,), "centroid-distance": (2,), "dihedral": (1, 4),
    "position": (1,),
}  # fmt: skip
"""Number of places of each kind of restraint."""
Sides = float | tuple[float, float]
"""One number for both sides, or the numbers below the lower and above the upper bound."""


@document_fields
@dataclass(frozen=True)
class Restraint:
    """A coordinate between two bounds: E = k/2 e^n, with e the distance outside the bounds.

    Raises
    ------
    ProtochainError
        If a number is invalid, or there are too few places.

    Notes
    -----
    Tails: Nilges et al., Protein Eng. 2:27 (1988).

    Examples
    --------
    >>> str(pc.Restraint("distance", ("A:3:CA", "A:9:CA"), 0.0, 6.0))
    'distance A:3:CA A:9:CA 0 6 1000'
    """

    # ``distance``, ``mean-distance``, ``centroid-distance``, ``dihedral`` or ``position`` (distance of each
    # atom from its initial position).
    kind: str
    # Two places of a distance, as ``A:3:CA``, a residue, or a selection. Between several atoms a ``distance``
    # is (sum r^-6)^(-1/6), as of NOEs. Further pairs of places add to this sum. A ``mean-distance`` is (mean
    # r^-6)^(-1/6). A ``centroid-distance`` is the distance of the centres of mass. A dihedral has four atoms,
    # or its name, ``phi A:3``. A position has one place.
    places: tuple[str, ...]
    lower: float  # angstrom or degrees: Lower bound.
    upper: float  # angstrom or degrees: Upper bound.
    # kJ/mol/nm^2 or kJ/mol/rad^2: Constant k, or two below and above the bounds.
    stiffness: Sides = STIFFNESS
    # angstrom or degrees: Length l, or two, from which the energy continues as a power of e, with the same
    # slope. 0 means never.
    linear: Sides = 0.0
    exponent: int = 2  # Exponent n of the energy. The unit of k is kJ/mol/nm^n or kJ/mol/rad^n.
    # Power p of the energy beyond l, E(l) + l E'(l) ((e/l)^p - 1)/p: 1 is linear, -1 levels off.
    tail: int = 1
    label: str = ""  # Name in messages and tables, as ``noe.nef: restraint 12``.

    def __post_init__(self) -> None:
        check_fields(
            self, kind=one_of(PLACES), places=words, lower=number, upper=number, stiffness=_sides,
            linear=_sides, exponent=at_least(1), tail=_tail, label=text,
        )  # fmt: skip
        if len(self.places) not in PLACES[self.kind]:
            n = " or ".join(map(str, PLACES[self.kind][:2]))
            raise ProtochainError(f"restraint {self}: give {n} places of a {self.kind}")
        turns = self.kind == "dihedral"
        sound = all(0.0 <= k < math.inf for k in both_sides(self.stiffness))
        sound &= min(both_sides(self.linear)) >= 0.0
        if self.lower > self.upper and self.kind != "position":
            up = self.upper + 360.0 * math.ceil((self.lower - self.upper) / 360.0)
            low, high = (self.lower, up) if turns else (self.upper, self.lower)
            remedy = f"the lower bound is above the upper; give {low:g} {high:g}"
        elif turns and self.upper - self.lower >= 360.0:
            remedy = "every angle is within these bounds; give less than 360 degrees"
        elif not (self.lower <= self.upper and sound):
            remedy = "give a lower and an upper bound, and a stiffness"
        else:
            return
        raise ProtochainError(f"restraint {self}: {remedy}")

    @property
    def is_external(self) -> bool:
        """Whether the energy depends on places in space, not on distances within the molecule."""
        return self.kind == "position" and max(both_sides(self.stiffness)) > 0.0

    @classmethod
    def read(cls, line: str) -> Self:
        """Read ``distance A:3:CA A:9:CA 0 6 1000``. The stiffness is optional. Quotes protect blanks."""
        try:
            kind, *remainder = shlex.split(line)
            options = {}
            while remainder and (option := re.fullmatch(rf"({'|'.join(_OPTIONS)})=(.+)", remainder[-1])):
                options[option[1]] = _OPTIONS[option[1]](option[2])
                remainder.pop()
            first = _first_number(remainder)
            places, numbers = tuple(remainder[:first]), remainder[first:]
            numbers = ["0", *numbers] if kind == "position" else numbers
            lower, upper, *stiffness_text = numbers
            stiffness = _read_sides(*stiffness_text) if stiffness_text else STIFFNESS
            if len(places) not in PLACES[kind]:
                raise ValueError(kind)
            bounds = float(lower), float(upper)
        except (ValueError, KeyError, TypeError):
            raise ProtochainError(
                f"restraint {line.strip()!r}: give kind, places, bounds and stiffness, as "
                f"'{EXAMPLE}', 'dihedral \"phi A:3\" -70 -50', 'position A:3:CA 0.5'"
            ) from None
        return cls(kind, places, *bounds, stiffness, **options)

    def __str__(self) -> str:
        bounds = (self.upper,) if self.kind == "position" else (self.lower, self.upper)
        numbers = " ".join(map(_text, (*bounds, self.stiffness)))
        plain = Restraint.__dataclass_fields__
        further = [
            f" {name}={_text(value)}" for name in _OPTIONS
            if (value := getattr(self, name)) != plain[name].default
        ]  # fmt: skip
        return f"{self.kind} {shlex.join(self.places)} {numbers}{''.join(further)}"


def both_sides(value: Sides) -> tuple[float, float]:
    """Numbers below and above the bounds."""
    return value if isinstance(value, tuple) else (value, value)


def _sides(value: Any, name: str) -> Sides:
    """Check for one number, or for two below and above the bounds."""
    if not isinstance(value, tuple | list):
        return number(value, name)
    if len(value) != 2:
        raise refusal(name, value, "give one number, or two below and above the bounds")
    below, above = (number(side, name) for side in value)
    return below if below == above else (below, above)


def _tail(value: Any, name: str) -> int:
    if (power := integer(value, name)) not in (1, -1):
        raise refusal(name, power, "give 1 (linear) or -1 (levels off)")
    return power


def _read_sides(text: str) -> Sides:
    """Read ``1000``, or ``1000,500`` for the two sides."""
    numbers = tuple(map(float, text.split(",")))
    return numbers[0] if len(numbers) == 1 else _sides(numbers, "restraint")


_OPTIONS: dict[str, Any] = {"linear": _read_sides, "exponent": int, "tail": int, "label": str}
"""Further values of a line, by name."""


def _text(value: Sides | str) -> str:
    if isinstance(value, str):
        return shlex.quote(value)
    return ",".join(f"{number:.10g}" for number in (value if isinstance(value, tuple) else (value,)))


def _first_number(line: Sequence[str]) -> int:
    """Index of the first of the numbers at the end."""
    n, one = len(line), r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?"
    while n and re.fullmatch(f"{one}(,{one})?", line[n - 1]):
        n -= 1
    return n
