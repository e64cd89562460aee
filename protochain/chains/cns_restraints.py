"""Restraints of CNS's and X-PLOR's tables of distances and dihedrals."""

import re
from collections import deque
from collections.abc import Iterator
from typing import NamedTuple

from protochain.chains.restraint import STIFFNESS, Restraint
from protochain.core.errors import ProtochainError
from protochain.core.markup import excerpt
from protochain.core.units import KJ_PER_KCAL

_LABELS = ("peak", "spectrum", "volume", "ppm1", "ppm2", "cv")
"""Words after a distance, each with a number, that do not change its energy."""
_HEADERS = ("noe", "dihedrals", "restraints", "reset", "end")
_NUMBERED = ("nrestraints", "nassign")  # Sizes of arrays.


class _Token(NamedTuple):
    text: str
    line: int


def restraints_of_cns(text: str) -> Iterator[Restraint]:
    """Yield the restraint of each ``assign`` statement of a table: angstrom, degrees, kcal/mol."""
    # Distances between several atoms, and further pairs after ``or``, are (sum r^-6)^(-1/6). Distances have
    # no stiffness in CNS. A ``weight`` multiplies the stiffness of :class:`Restraint`. Dihedrals have E = C
    # well^ed: X-PLOR's manual (Brunger 1992), "Distance Restraints" and "Dihedral Angle Restraints".
    tokens = _tokens(text)
    while tokens:
        word, line = tokens.popleft()
        try:
            if _is(word, "assign"):
                yield _read_assign(tokens)
            else:
                _skip_header(word, tokens)
        except ProtochainError as error:
            raise ProtochainError(f"line {line}: ", *error.parts) from None


def _is(word: str, *names: str) -> bool:
    """Whether a word is one of these names, or its first four letters or more."""
    return any(name.startswith(word.lower()) and len(word) >= min(4, len(name)) for name in names)


def _tokens(text: str) -> deque[_Token]:
    """Words and parenthesised selections with their lines, without comments."""

    def blank(match: re.Match[str]) -> str:
        return "\n" * match[0].count("\n")

    text = re.sub(r"(?is)\{[^}]*\}|![^\n]*|^[ \t]*rema[^\n]*", blank, text, flags=re.MULTILINE)
    lines = (re.findall(r'"[^"]*"|[()=]|[^\s()="]+', line) for line in text.split("\n"))
    return deque(_Token(word, number) for number, words in enumerate(lines, 1) for word in words)


def _selection(tokens: deque[_Token]) -> str:
    """Text of the selection at the front of the tokens, which are removed."""
    depth, words = 0, list[str]()
    while tokens:
        words.append(tokens.popleft().text)
        depth += (words[-1] == "(") - (words[-1] == ")")
        if not depth:
            break
    else:
        raise ProtochainError("assign: a parenthesis is not closed; add )")
    selection = " ".join(words[1:-1])
    # The settings of commands read restraints, and their help must not load numpy.
    from protochain.chains.cns_selection import parse_selection

    parse_selection(selection)
    return selection


def _selections(tokens: deque[_Token]) -> list[str]:
    selections = []
    while tokens and tokens[0].text == "(":
        selections.append(_selection(tokens))
    return selections


def _numbers(tokens: deque[_Token]) -> list[float]:
    numbers = []
    while tokens and re.fullmatch(r"[-+]?(\d+\.?\d*|\.\d+)([eEdD][-+]?\d+)?", tokens[0].text):
        numbers.append(float(tokens.popleft().text.lower().replace("d", "e")))
    return numbers


def _read_assign(tokens: deque[_Token]) -> Restraint:
    """Restraint of an assign statement, whose tokens are removed."""
    places, numbers, weight = _selections(tokens), list[float](), 1.0
    n = len(places)
    while tokens:
        if further := _numbers(tokens):
            if numbers:
                raise ProtochainError(f"assign: {further[0]:g} is not expected here; remove it")
            numbers = further
        elif n == 2 and tokens[0].text.lower() == "or":
            tokens.popleft()
            pair = _selections(tokens)
            if len(pair) != 2:
                raise ProtochainError("assign: give two selections after or")
            places += pair
        elif n == 2 and _is(tokens[0].text, "weight", *_LABELS):
            word = tokens.popleft().text
            if tokens and tokens[0].text == "=":
                tokens.popleft()
            values = _numbers(tokens)
            if len(values) != 1:
                raise ProtochainError(f"assign: give a number after {word}")
            weight = values[0] if _is(word, "weight") else weight
        else:
            break
    if n == 2 and len(numbers) == 3:
        d, minus, plus = numbers
        return Restraint("distance", tuple(places), max(d - minus, 0.0), d + plus, weight * STIFFNESS)
    if n == 4 and len(numbers) == 4 and numbers[3] == int(numbers[3]):
        force, angle, width, exponent = numbers
        bounds = angle - width, angle + width
        return Restraint(
            "dihedral", tuple(places), *bounds, 2.0 * KJ_PER_KCAL * force, exponent=int(exponent)
        )
    selections = excerpt(" ".join(f"({place})" for place in places))
    raise ProtochainError(
        f"assign {selections}: not a distance nor a dihedral; give 2 selections and 3 numbers, or 4 and 4"
    )


def _skip_header(word: str, tokens: deque[_Token]) -> None:
    """Remove the tokens of a statement without an effect, and refuse all other statements."""

    def pop_value() -> str:
        while tokens and tokens[0].text == "=":
            tokens.popleft()
        return tokens.popleft().text if tokens else ""

    if _is(word, *_HEADERS):
        return
    if _is(word, *_NUMBERED, "classification"):
        pop_value()
    elif word.lower() == "set":
        while tokens and pop_value().lower() != "end":
            pass
    elif _is(word, "averaging"):
        group, method = pop_value(), pop_value()
        if not _is(method, "sum"):
            raise ProtochainError(f"averaging {group} {method} is not implemented; give sum")
    elif _is(word, "monomers"):
        group, count = pop_value(), pop_value()
        if count != "1":
            raise ProtochainError(f"monomers {group} {count} is not implemented; give 1")
    else:
        raise ProtochainError(f"{excerpt(word)!r} is not implemented; remove this statement")
