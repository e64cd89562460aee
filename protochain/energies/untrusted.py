"""Checks of untrusted force-field files for content that OpenMM would run.

``openmm/app/forcefield.py`` (8.6) reads a file as follows:

===========================================  ===============================================
text                                         read by
===========================================  ===============================================
``Script``, ``InitializationScript``         ``exec``: runs
``Include``, attribute ``file``              opened, with its entire content
``useDispersionCorrection`` of two forces    ``eval``: runs
``energy``, ``expression``, text of          Lepton, a language of numbers and functions
``ComputedValue`` and ``EnergyTerm``
text of ``Function`` and ``Map``             ``float``
all other attributes                         ``float``, ``int``, tables of words, or names
===========================================  ===============================================

The allowed content is narrower, so that an ``eval`` of a later version cannot call anything.
"""

import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

from protochain.core.errors import Argument, ForceFieldError

ACTIVE = ("Script", "InitializationScript", "Include")
EVALUATED = ("useDispersionCorrection",)
_NEVER_READ = ("Info", "Source", "Reference")  # Elements that describe the origin of a file.
_NOTES = ("def", "desc", "doi", "overrides", "source", "comment")
"""Attributes of other programs (Foyer), which OpenMM does not read."""
_LEPTON = ("energy", "expression")
_LEPTON_TEXT = ("ComputedValue", "EnergyTerm")
_FREE = ("name", *_LEPTON, *_NOTES)
"""Attributes without restrictions. Names are only compared: openmmforcefields names residues by SMILES."""
_BOOLEAN = re.compile(r"\s*(True|False|[01])\s*")
_PLAIN = re.compile(r"[\w.+\-*'\"#:/,~&|^%!?@$<> ]*")
"""Numbers and names. Python cannot call anything without brackets."""
_LONGEST, _DEEPEST, _LARGEST = 4000, 50, 400
"""Limits of an expression: letters, nested brackets, parts with its definitions inserted. Lepton recurses.
Derivatives need time and memory in the third power of the parts: seconds and 300 MB at these limits."""
_WEIGHTS = {"(": 0, ")": 0, ",": 0, "*": 2, "/": 2, "^": 4}
_TOKEN = re.compile(r"[A-Za-z_]\w*|[\d.]+(?:[eE][+-]?\d+)?|\S")


def check_passive(path: Path, root: ElementTree.Element) -> None:
    """Refuse a force field if OpenMM would run a part of it as Python, or if it opens other files."""
    trust = "if you trust the file, allow that with ", Argument("trust_forcefield", True)
    for node in root.iter():
        if node.tag in ACTIVE:
            raise ForceFieldError(f"{path}: has <{node.tag}>, which runs code or opens files; ", *trust)
        if node.tag in _NEVER_READ:
            continue
        for name, value in node.attrib.items():
            place = f"{path}: {name} of <{node.tag}> is {_short(value)}"
            if name in EVALUATED and not _BOOLEAN.fullmatch(value):
                raise ForceFieldError(
                    f"{place}, which OpenMM would run as Python: give True or False; ", *trust
                )
            if name not in _FREE and not _PLAIN.fullmatch(value):
                raise ForceFieldError(
                    f"{place}, which is neither a number nor a plain name: mend it; ", *trust
                )


def check_expressions(path: Path, root: ElementTree.Element) -> None:
    """Refuse expressions that OpenMM could not process in acceptable time and memory."""
    for node in root.iter():
        texts = [node.attrib[name] for name in _LEPTON if name in node.attrib]
        texts += [node.text or ""] if node.tag in _LEPTON_TEXT else []
        for text in texts:
            if not _is_small(text):
                raise ForceFieldError(
                    f"{path}: the expression {_short(text)} of <{node.tag}> is too long, deep or large "
                    "once its definitions are put in; simplify it"
                )


def _is_small(text: str) -> bool:
    if len(text) > _LONGEST:
        return False
    definitions: dict[str, tuple[int, int]] = {}
    for part in reversed(text.split(";")):
        name, _, formula = part.rpartition("=")
        size = depth = deepest = 0
        for token in _TOKEN.findall(formula):
            depth += (token == "(") - (token == ")")
            token_size, nested = definitions.get(token, (_WEIGHTS.get(token, 1), 0))
            size, deepest = size + token_size, max(deepest, depth + nested)
        definitions[name.strip()] = size, deepest
        if size > _LARGEST or deepest > _DEEPEST:
            return False
    return True


def _short(text: str) -> str:
    return ascii(text if len(text) <= 40 else f"{text[:37]}...")
