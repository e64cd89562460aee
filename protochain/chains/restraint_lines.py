"""Restraints from lines, values and files."""

import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from protochain.chains.amber_restraints import restraints_of_amber
from protochain.chains.cns_restraints import restraints_of_cns
from protochain.chains.restraint import EXAMPLE, PLACES, Restraint
from protochain.chains.star_restraints import restraints_of_star
from protochain.core.checks import brief
from protochain.core.errors import ProtochainError, refusal


def read_restraints(source: Any, name: str = "restraints") -> tuple[Restraint, ...]:
    """Read restraints from Restraints, their lines, or a file (lines, AMBER, CNS, NEF or NMR-STAR)."""
    if isinstance(source, Restraint):
        return (source,)
    if isinstance(source, str | Path):
        if len(str(source)) > 255 or not Path(source).is_file():
            if is_missing(source):
                raise refusal(name, str(source), "no such file")
            return (Restraint.read(str(source)),)
        text = Path(source).read_text(errors="replace")
        try:
            restraints = tuple(_of_text(text, Path(source).name))
        except ProtochainError as error:
            raise ProtochainError(f"{source}: ", *error.parts) from None
        if not restraints:
            raise ProtochainError(f"{source}: no restraints; give a line each, as '{EXAMPLE}'")
        return restraints
    if not isinstance(source, Iterable) or not all(isinstance(item, Restraint | str) for item in source):
        raise refusal(name, brief(source), "give Restraints, their lines, or a file of them")
    return tuple(restraint for item in source for restraint in read_restraints(item))


def _of_text(text: str, file: str) -> Iterable[Restraint]:
    """Restraints of the text of a file. Its keywords determine the format."""
    if re.search(r"(?im)^\s*data_\S", text):
        return restraints_of_star(text, file)
    if re.search(r"(?im)^[ \t]*[&$]\w", text):
        return restraints_of_amber(text)
    if re.search(r"(?im)^[^#\n]*\bassi(gn?)?\b", text):
        return restraints_of_cns(text)
    lines = (re.sub(r"(^|\s)#.*", "", line).strip() for line in text.splitlines())
    return (Restraint.read(line) for line in lines if line)


def is_missing(source: str | Path) -> bool:
    """Whether a source that is neither a file nor a number is one word, and thus a missing file."""
    return isinstance(source, Path) or (len(source.split()) == 1 and source not in PLACES)


def are_restraints(source: Any) -> bool:
    """Whether a value is restraints, their lines or their file, rather than strengths of springs."""
    if isinstance(source, Restraint | Path):
        return True
    if isinstance(source, str):
        return source.partition(" ")[0] in PLACES or (0 < len(source) < 256 and Path(source).is_file())
    return isinstance(source, list | tuple) and any(map(are_restraints, source))
