"""Atom selections in the language of CNS and X-PLOR."""

import re
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from protochain.core.arrays import Integers
from protochain.core.errors import ProtochainError
from protochain.structure.molecule.model import Structure, per_structure

Selection = Callable[[Structure], NDArray[np.bool_]]  # Structure -> mask of the selected atoms (na,).

_WILDCARDS = {"*": ".*", "%": ".", "#": r"\d*", "+": r"\d"}
"""Any string, a character, a number, a digit."""
_COLUMNS = {"segid": 0, "residue": 1, "resid": 1, "name": 2, "resname": 3}
_TOKEN = re.compile(r"""[()]|"[^"]*"|'[^'\s]*'(?=[\s)]|$)|[^\s()"]+""")


def parse_selection(text: str) -> Selection:
    """Parse ``resid 3 and (name HB# or name HG*) and not segid B``.

    Factors are ``resid``, ``residue`` (numbers, ranges ``3:8``), ``resname``, ``segid``, ``name``, ``atom``
    (segment, residue, name), ``all``, ``none``, ``known`` and ``hydrogen``, joined by ``and``, ``or``,
    ``not`` and parentheses. Four letters of a word are enough, in any case: X-PLOR's manual (Brunger 1992),
    "Atom Selection".
    """
    tokens = _TOKEN.findall(re.sub(r"\s*:\s*", ":", text))
    selection, remainder = _any_of(tokens)
    if remainder:
        raise ProtochainError(f"selection ({text}): {remainder[0]!r} is not expected; give and, or")
    return selection


def _any_of(tokens: list[str]) -> tuple[Selection, list[str]]:
    return _group(tokens, "or", np.logical_or, lambda rest: _group(rest, "and", np.logical_and, _factor))


def _group(
    tokens: list[str], word: str, join: np.ufunc, read: Callable[[list[str]], tuple[Selection, list[str]]]
) -> tuple[Selection, list[str]]:
    """Selection of the parts that a word joins, and the tokens after them."""
    part, tokens = read(tokens)
    parts = [part]
    while tokens and tokens[0].lower() == word:
        part, tokens = read(tokens[1:])
        parts.append(part)
    return lambda structure: join.reduce([part(structure) for part in parts]), tokens


def _factor(tokens: list[str]) -> tuple[Selection, list[str]]:
    """Selection of one factor, and the tokens after it."""
    if not tokens:
        raise ProtochainError("selection: incomplete; give for example resid 3 and name CA")
    word, tokens = tokens[0].lower(), tokens[1:]
    if word == "not":
        inner, tokens = _factor(tokens)
        return lambda structure: ~inner(structure), tokens
    if word == "(":
        inner, tokens = _any_of(tokens)
        if not tokens or tokens[0] != ")":
            raise ProtochainError("selection: a parenthesis is not closed; add )")
        return inner, tokens[1:]
    if word in ("all", "none") or (len(word) >= 4 and "known".startswith(word)):
        return lambda structure: np.full(structure.n_atoms, word != "none"), tokens
    if len(word) >= 4 and "hydrogen".startswith(word):
        return lambda structure: structure.atom_element == "H", tokens
    indices = {column for name, column in _COLUMNS.items() if len(word) >= 4 and name.startswith(word)}
    columns = [0, 1, 2] if word == "atom" else [*indices]
    if not columns:
        raise ProtochainError(
            f"selection: {word!r} is not implemented; give resid, resname, segid, name, atom"
        )
    patterns, tokens = tokens[: len(columns)], tokens[len(columns) :]
    if len(patterns) < len(columns) or {*patterns} & {"(", ")"}:
        raise ProtochainError(f"selection: {word} needs {len(columns)} words after it; add them")
    tests = [_match_column(column, pattern) for column, pattern in zip(columns, patterns, strict=True)]
    return lambda structure: np.logical_and.reduce([test(structure) for test in tests]), tokens


def _match_column(column: int, pattern: str) -> Selection:
    """Atoms whose value in a column matches a pattern, or is a number in a range."""
    quoted = pattern[0] in "\"'" and len(pattern) > 1
    plain = (pattern[1:-1] if quoted else pattern).strip().upper()
    if ":" in plain:
        limits = plain.split(":")
        if column != 1 or len(limits) != 2 or not all(re.fullmatch(r"-?\d+", limit) for limit in limits):
            raise ProtochainError(f"selection: range {pattern} is not implemented; give numbers of residues")
        first, last = map(int, limits)

        def matches(value: str) -> bool:
            return first <= int(re.sub(r"[^-\d]", "", value) or last + 1) <= last
    else:
        # The amide hydrogen has another name in CNS.
        plain = "H" if column == 2 and plain == "HN" else plain
        expression = "".join(_WILDCARDS.get(letter) or re.escape(letter) for letter in plain)

        def matches(value: str) -> bool:
            return re.fullmatch(expression, value.upper()) is not None

    def selection(structure: Structure) -> NDArray[np.bool_]:
        values, inverse = _columns(structure)[column]
        # In a structure of one chain the segment may be blank.
        blank = column == 0 and not plain and len(values) == 1
        return np.array([blank or matches(value) for value in values], dtype=bool)[inverse]

    return selection


@per_structure
def _columns(structure: Structure) -> list[tuple[list[str], Integers]]:
    """Unique values of segment, residue number, atom name and residue name, and their index for each atom."""
    rows = structure.atom_residue
    number = np.char.add(structure.residue_number, structure.residue_insertion_code)
    columns = structure.residue_chain[rows], number[rows], structure.atom_name, structure.residue_name[rows]
    pairs = (np.unique(column, return_inverse=True) for column in columns)
    return [(values.tolist(), inverse) for values, inverse in pairs]
