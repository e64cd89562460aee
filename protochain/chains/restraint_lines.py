"""Restraints of one form, in words: lines, AMBER's and CNS's tables of distances and dihedrals."""

import math
import re
import shlex
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from protochain.core.checks import check_fields, number, one_of, shown, words
from protochain.core.errors import ProtochainError, refused
from protochain.core.units import ANGSTROM_PER_NM

STIFFNESS = 1000.0
"""kJ/mol/nm^2, or of dihedrals kJ/mol/rad^2."""
_KCAL = 4.184
_FAR = 1e6
"""Angstrom: no upper bound."""
_EXAMPLE = "distance A:3:CA A:9:CA 0 6 1000"
PLACES = {"distance": (2,), "dihedral": (1, 4), "position": (1,)}


@dataclass(frozen=True)
class Restraint:
    """A value that is held between two bounds: E = k/2 e^2, where e is how far it is outside.

    Parameters
    ----------
    kind : str
        ``distance``, ``dihedral`` or ``position`` (distance of each atom from where it is at the start).
    places : tuple of str
        Two places of a distance, as ``A:3:CA``, a residue, or a selection; between several atoms it is
        (sum r^-6)^(-1/6), as of NOEs. Four atoms of a dihedral, or its name, ``phi A:3``. One of positions.
    lower, upper : float, angstrom or degrees
        Bounds.
    stiffness : float, kJ/mol/nm^2 or kJ/mol/rad^2
        Constant k.
    linear : float, angstrom or degrees
        How far outside the energy goes on linearly; 0 for nowhere.

    Raises
    ------
    ProtochainError
        If a number makes no sense, or there are too few places.

    Examples
    --------
    >>> str(pc.Restraint("distance", ("A:3:CA", "A:9:CA"), 0.0, 6.0))
    'distance A:3:CA A:9:CA 0 6 1000'
    """

    kind: str
    places: tuple[str, ...]
    lower: float
    upper: float
    stiffness: float = STIFFNESS
    linear: float = 0.0

    def __post_init__(self) -> None:
        numbers = dict.fromkeys(("lower", "upper", "stiffness", "linear"), number)
        check_fields(self, kind=one_of(PLACES), places=words, **numbers)
        if len(self.places) not in PLACES[self.kind]:
            n = " or ".join(map(str, PLACES[self.kind]))
            raise ProtochainError(f"restraint {self}: give {n} places of a {self.kind}")
        turns = self.kind == "dihedral"
        if self.lower > self.upper and self.kind != "position":
            up = self.upper + 360.0 * math.ceil((self.lower - self.upper) / 360.0)
            low, high = (self.lower, up) if turns else (self.upper, self.lower)
            remedy = f"the lower bound is above the upper; give {low:g} {high:g}"
        elif turns and self.upper - self.lower >= 360.0:
            remedy = "every angle is within these bounds; give less than 360 degrees"
        elif not (self.lower <= self.upper and 0.0 <= self.stiffness < math.inf and self.linear >= 0.0):
            remedy = "give a lower and an upper bound, and a stiffness"
        else:
            return
        raise ProtochainError(f"restraint {self}: {remedy}")

    @property
    def is_external(self) -> bool:
        """Whether it holds the molecule from outside: its energy is of places, not of distances."""
        return self.kind == "position" and self.stiffness > 0.0

    @classmethod
    def read(cls, line: str) -> Self:
        """Read ``distance A:3:CA A:9:CA 0 6 1000``; the stiffness may be left out, quotes hold blanks."""
        try:
            kind, *rest = shlex.split(line)
            values = [float(word) for word in rest[_first_number(rest) :]]
            places = tuple(rest[: _first_number(rest)])
            values = [0.0, *values] if kind == "position" else values
            lower, upper, stiffness, *more = [*values, STIFFNESS] if len(values) == 2 else values
            if more or len(places) not in PLACES[kind]:
                raise ValueError(kind)
        except (ValueError, KeyError):
            raise ProtochainError(
                f"restraint {line.strip()!r}: give kind, places, bounds and stiffness, as "
                f"'{_EXAMPLE}', 'dihedral \"phi A:3\" -70 -50', 'position A:3:CA 0.5'"
            ) from None
        return cls(kind, places, lower, upper, stiffness)

    def __str__(self) -> str:
        bounds = (self.upper,) if self.kind == "position" else (self.lower, self.upper)
        numbers = " ".join(f"{value:g}" for value in (*bounds, self.stiffness))
        return f"{self.kind} {shlex.join(self.places)} {numbers}"


def _first_number(words: Sequence[str]) -> int:
    """Place of the first of the numbers at the end."""
    n = len(words)
    while n and re.fullmatch(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?", words[n - 1]):
        n -= 1
    return n


def read_restraints(given: Any, name: str = "restraint") -> tuple[Restraint, ...]:
    """Restraints of a file (a line each, AMBER's or CNS's), of one or several, or of their lines."""
    if isinstance(given, Restraint):
        return (given,)
    if isinstance(given, str | Path):
        if not Path(given).is_file():
            if is_missing(given):
                raise refused(name, str(given), "no such file")
            return (Restraint.read(str(given)),)
        text = Path(given).read_text(errors="replace")
        try:
            if "&rst" in text.lower():
                listed = tuple(_of_amber(text))
            elif re.search(r"(?im)^\s*assi", text):
                listed = tuple(_of_cns(text))
            else:
                lines = (re.sub(r"(^|\s)#.*", "", line).strip() for line in text.splitlines())
                listed = tuple(Restraint.read(line) for line in lines if line)
        except ProtochainError as error:
            raise ProtochainError(f"{given}: ", *error.parts) from None
        if not listed:
            raise ProtochainError(f"{given}: no restraints; give a line each, as '{_EXAMPLE}'")
        return listed
    if not isinstance(given, Iterable) or not all(isinstance(each, Restraint | str) for each in given):
        raise refused(name, shown(given), "give Restraints, their lines, or a file of them")
    return tuple(its for each in given for its in read_restraints(each))


def is_missing(given: str | Path) -> bool:
    """Whether what is neither a file nor a number can only have been meant as a file: it is one word."""
    return isinstance(given, Path) or (len(given.split()) == 1 and given not in PLACES)


def are_restraints(given: Any) -> bool:
    """Whether these are restraints, their lines, or a file of them, and not strengths of springs."""
    if isinstance(given, Restraint | Path):
        return True
    if isinstance(given, str):
        return given.partition(" ")[0] in PLACES or (0 < len(given) < 256 and Path(given).is_file())
    return isinstance(given, list | tuple) and any(map(are_restraints, given))


def _of_amber(text: str) -> Iterator[Restraint]:
    """Restraints of AMBER's DISANG files: kcal/mol, angstrom, degrees; atoms by their numbers in the file."""
    for block in re.findall(r"(?is)&rst(.*?)(?:&end|/)", re.sub(r"(?m)[!#].*$", "", text)):
        named = f"&rst {' '.join(block.split())}"
        pairs = re.findall(r"(\w+)(?:\([\d,]*\))?\s*=\s*([^=]*?)(?=,?\s*\w+(?:\([\d,]*\))?\s*=|$)", block)
        values = {key.lower(): its.replace(",", " ").split() for key, its in pairs}
        try:
            atoms = [int(each) for each in values["iat"] if int(each)]
            r1, r2, r3, r4 = (float(values[f"r{k}"][0]) for k in range(1, 5))
            k2, k3 = (float(values[key][0]) for key in ("rk2", "rk3"))
        except (KeyError, ValueError, IndexError):
            raise ProtochainError(f"{named}: give iat, r1 to r4, rk2 and rk3") from None
        places, is_distance = tuple(f"@{each}" for each in atoms), len(atoms) == 2
        if min(atoms, default=0) < 0 or len(atoms) not in (2, 4) or (not is_distance and k2 != k3):
            raise ProtochainError(f"{named}: give two atoms, or four of a dihedral with rk2 as rk3")
        unit = 2.0 * _KCAL * (ANGSTROM_PER_NM**2 if is_distance else 1.0)
        if not is_distance:
            yield Restraint("dihedral", places, r2, r3, unit * k2, max(r4 - r3, 1e-9))
            continue
        yield Restraint("distance", places, r2, _FAR, unit * k2, max(r2 - r1, 1e-9))
        yield Restraint("distance", places, 0.0, r3, unit * k3, max(r4 - r3, 1e-9))


def _of_cns(text: str) -> Iterator[Restraint]:
    """Restraints of CNS's tables of distances and dihedrals; distances have no stiffness there."""
    for rest in re.split(r"(?im)^\s*assi\w*", re.sub(r"(?m)!.*$", "", text))[1:]:
        selections = re.findall(r"\(([^()]*(?:\([^()]*\)[^()]*)*)\)", rest)
        tail = rest[rest.rfind(")") + 1 :].split()
        try:
            numbers = [float(each) for each in tail[:4]]
            if len(selections) == 2:
                d, minus, plus = numbers[:3]
                made = Restraint("distance", (*selections,), max(d - minus, 0.0), d + plus)
            else:
                force, angle, width, _ = numbers
                places, k = tuple(selections[:4]), 2.0 * _KCAL * force
                made = Restraint("dihedral", places, angle - width, angle + width, k)
        except ValueError:
            raise ProtochainError(f"assign {' '.join(rest.split())}: not a distance nor a dihedral") from None
        yield made
