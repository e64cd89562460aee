"""Restraints of AMBER's DISANG files: namelists &rst."""

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from protochain.chains.restraint import Restraint
from protochain.core.errors import ProtochainError
from protochain.core.units import ANGSTROM_PER_NM, KJ_PER_KCAL

_GROUPS = range(1, 9)
_INTEGERS = {
    "iat": 8, **dict.fromkeys(("iresid", "nstep1", "nstep2", "irstyp", "ialtd", "ifvari", "ninc", "imult",
    "ir6", "ifntyp", "ixpk", "nxpk", "iconstr", "outxyz"), 1), "fxyz": 5, **{f"igr{k}": 200 for k in _GROUPS},
}  # fmt: skip
_NAMES = {"atnam": 8, "restraint": 1, **{f"grnam{k}": 200 for k in _GROUPS}}
_REALS = {
    "rstwt": 4, "rjcoef": 3,
    **dict.fromkeys(("r0", "r1", "r2", "r3", "r4", "k0", "rk2", "rk3"), 1),
    **dict.fromkeys(("r0a", "r1a", "r2a", "r3a", "r4a", "k0a", "rk2a", "rk3a"), 1),
}  # fmt: skip
_SIZES = _INTEGERS | _NAMES | _REALS
"""Variables of &rst, and their numbers of values: AMBER's manual, section on distance restraints."""
_INHERITED = (
    "ialtd", "ir6", "ninc", "imult", "r1", "r2", "r3", "r4", "rk2", "rk3", "r1a", "r2a", "r3a", "r4a",
    "rk2a", "rk3a", "fxyz", "outxyz",
)  # fmt: skip
"""Variables whose values persist from the previous namelist."""
_REFUSED = {
    "nstep1": "restraints of some steps only", "nstep2": "restraints of some steps only",
    "irstyp": "bounds relative to the initial value", "ifvari": "restraints that change with time",
    "rstwt": "generalised distance coordinates", "rjcoef": "J couplings",
    "iconstr": "constraints of a direction", "outxyz": "output of components",
    "restraint": "restraints in natural language",
}  # fmt: skip
"""Variables that are not implemented and must have their defaults."""
_COMMENT = re.compile(r"""('(?:[^'\n]|'')*'|"(?:[^"\n]|"")*")|[!#][^\n]*""")
_BEGIN = r"[ \t]*[&$](?!end\b)(\w+)"
_NEXT, _LINE = re.compile(_BEGIN, re.IGNORECASE), re.compile(f"^{_BEGIN}", re.IGNORECASE | re.MULTILINE)
_BODY = re.compile(r"""(?i)((?:'(?:[^']|'')*'|"(?:[^"]|"")*"|[^'"/&$])*)(/|[&$]end\b)""")
_TOKEN = re.compile(
    r"""\s*(?:(?P<variable>\w+)\s*(?:\(\s*(?P<first>\d+)?\s*(?::\s*\d*\s*)?\))?\s*=|(?P<comma>,)
    |(?:(?P<times>\d+)\*)?(?:(?P<text>'(?:[^']|'')*'|"(?:[^"]|"")*")|(?P<word>[^\s,'"=]+))?)\s*""",
    re.VERBOSE,
)
_WELL = ("r1", "r2", "r3", "r4", "rk2", "rk3")


def restraints_of_amber(text: str) -> Iterator[Restraint]:
    """Yield the restraint of each namelist of a DISANG file, with atoms and residues by number."""
    # Units are kcal/mol, angstrom and degrees. The namelist with ``iat(1)=0`` ends the file, as in AMBER's
    # manual, "Distance, angle and torsional restraints". Between ``r3`` and ``r4`` the energy is
    # rk3 (R - r3)^2, beyond ``r4`` linear, or with ``ialtd=1`` hyperbolic.
    inherited: dict[str, Any] = {}
    end = 0
    for line, name, body in _namelists(text):
        try:
            if name != "rst":
                raise ProtochainError(f"namelist &{name} is not implemented; give a file with &rst only")
            if end:
                raise ProtochainError(f"AMBER reads no &rst after that without iat in line {end}; remove it")
            variables = _expand_parabola(inherited | _read_variables(body, inherited))
            inherited = {key: value for key, value in variables.items() if key in _INHERITED}
            if any(any(variables.get(name, {}).values()) for name in ("iat", "restraint")):
                yield _restraint(variables)
            else:
                end = line
        except ProtochainError as error:
            raise ProtochainError(f"line {line}: ", *error.parts) from None


def _namelists(text: str) -> Iterator[tuple[int, str, str]]:
    """Line, name and body of each namelist. Text between namelists is a comment."""
    text, position = _COMMENT.sub(lambda match: match[1] or "", text), 0
    while begin := _NEXT.match(text, position) or _LINE.search(text, position):
        line, name = text.count("\n", 0, begin.start(1)) + 1, begin[1].lower()
        if not (body := _BODY.match(text, begin.end())):
            raise ProtochainError(f"line {line}: namelist &{name} has no end; end it by / or &end")
        yield line, name, body[1]
        position = body.end()


def _read_variables(body: str, inherited: Mapping[str, Any]) -> dict[str, Any]:
    """Variables of a namelist: scalars, and arrays as values by their index."""
    variables: dict[str, Any] = {}
    name, index, after_comma, position = "", 0, True, 0
    while position < len(body):
        token = _TOKEN.match(body, position)
        if not token or token.end() == position:
            raise ProtochainError(f"&rst: {body[position:].split()[0]!r} cannot be read; give NAME=VALUE")
        position = token.end()
        if token["variable"]:
            name, index, after_comma = token["variable"].lower(), int(token["first"] or 1), True
            if name not in _SIZES:
                raise ProtochainError(f"&rst has no variable {name}; remove it, or correct its name")
            continue
        if not name:
            raise ProtochainError(f"&rst: {token[0]!r} is not assigned to a variable; give NAME=VALUE")
        if token["comma"]:
            # An omitted value remains unchanged.
            index, after_comma = index + after_comma, True
            continue
        for _ in range(int(token["times"] or 1)):
            if index > _SIZES[name]:
                raise ProtochainError(f"&rst: {name} has more than {_SIZES[name]} values; remove some")
            if (value := token["text"] or token["word"]) is not None:
                variables.setdefault(name, dict(inherited.get(name, {})))[index] = _value(name, value)
            index += 1
        after_comma = False
    return variables


def _value(name: str, word: str) -> Any:
    """Value of a word, as Fortran reads it."""
    if name in _NAMES:
        quote = word[0]
        return word[1:-1].replace(2 * quote, quote).strip() if quote in "'\"" else word
    try:
        value = float(re.sub(r"[dDqQ]", "e", word))
        if not math.isfinite(value) or (name in _INTEGERS and not re.fullmatch(r"[-+]?\d+", word)):
            raise ValueError(word)
    except ValueError:
        kind = "a whole number" if name in _INTEGERS else "a number"
        raise ProtochainError(f"&rst: {name}={word} is not {kind}; correct it") from None
    return int(word) if name in _INTEGERS else value


def _expand_parabola(variables: dict[str, Any]) -> dict[str, Any]:
    """Variables in which a parabola of k0 around r0 is replaced by bounds and constants, as in AMBER."""
    if not (k0 := variables.get("k0", {}).get(1)):
        return variables
    r0 = variables.get("r0", {}).get(1, 0.0)
    turns = variables.get("iat", {}).get(4)
    ends = (r0 - 180.0, r0 + 180.0) if turns else (0.0, r0 + 500.0)
    well = (ends[0], r0, r0, ends[1], k0, k0)
    return variables | {name: {1: value} for name, value in zip(_WELL, well, strict=True)}


def _restraint(variables: Mapping[str, Mapping[int, Any]]) -> Restraint:
    for name, feature in _REFUSED.items():
        if any(variables.get(name, {}).values()):
            raise ProtochainError(f"&rst: {name}: {feature} are not implemented; remove it")
    if any(value != 1 for value in variables.get("fxyz", {}).values()):
        raise ProtochainError("&rst: fxyz: components of a distance are not implemented; remove it")

    def scalar(name: str, default: Any = None) -> Any:
        return variables.get(name, {}).get(1, default)

    iat = [variables["iat"].get(k, 0) for k in range(1, 9)]
    n = iat.index(0) if 0 in iat else 8
    if n not in (2, 4) or any(iat[n:]):
        feature = "angles" if n == 3 else f"restraints of {n} atoms"
        raise ProtochainError(
            f"&rst: iat: {feature} are not implemented; give two atoms, or four of a dihedral"
        )
    has_groups, turns = min(iat) < 0, n == 4
    if has_groups and turns:
        raise ProtochainError("&rst: igr: groups in dihedrals are not implemented; give four atoms")
    values = [scalar(name) for name in _WELL]
    if None in values:
        raise ProtochainError("&rst: the well is incomplete; give r1 to r4, rk2 and rk3, here or before")
    r1, r2, r3, r4, k2, k3 = values
    if not r1 <= r2 <= r3 <= r4:
        raise ProtochainError(f"&rst: r1 to r4 are {r1:g}, {r2:g}, {r3:g}, {r4:g}; give them in rising order")
    levels = scalar("ialtd", 0) == 1 and not turns
    if any(scalar(name, 0) not in (0, 1) for name in ("ialtd", "ir6", "iresid")):
        raise ProtochainError("&rst: ialtd, ir6 and iresid are 0 or 1; correct them")
    # If the parabola has no width, slope and energy are zero.
    below = k2 if r2 > r1 or levels else 0.0
    above = k3 if r4 > r3 else 0.0
    unit = 2.0 * KJ_PER_KCAL * (1.0 if turns else ANGSTROM_PER_NM**2)
    kind = "dihedral" if turns else "distance"
    if has_groups:
        kind = "mean-distance" if scalar("ir6", 0) else "centroid-distance"
    return Restraint(
        kind, tuple(_place(variables, k) for k in range(1, n + 1)), r2, r3, (unit * below, unit * above),
        (0.0 if levels else r2 - r1, r4 - r3), tail=-1 if levels else 1,
    )  # fmt: skip


def _place(variables: Mapping[str, Mapping[int, Any]], k: int) -> str:
    """Place of the k-th atom of a restraint, or of its group: ``@12``, ``:8@CA``, ``@44,@45``."""
    numbers: Sequence[int] = [variables["iat"][k]]
    names = [variables.get("atnam", {}).get(k)]
    if numbers[0] < 0:
        group = variables.get(f"igr{k}", {})
        size = next((i for i in range(1, 201) if group.get(i, 0) <= 0), 201) - 1
        numbers = [group[i] for i in range(1, size + 1)]
        names = [variables.get(f"grnam{k}", {}).get(i) for i in range(1, size + 1)]
        if not size:
            raise ProtochainError(
                f"&rst: iat({k}) is {variables['iat'][k]}; give the atoms of its group, igr{k}"
            )
    if not variables.get("iresid", {}).get(1):
        return ",".join(f"@{number}" for number in numbers)
    if not all(names):
        raise ProtochainError(f"&rst: iresid=1 needs a name of atom {k}; give atnam, or grnam{k} of a group")
    return ",".join(f":{number}@{name}" for number, name in zip(numbers, names, strict=True))
