"""A summary of what was changed to prepare a file: losses first, alike changes in one line."""

import re
from collections import defaultdict
from collections.abc import Callable, Iterable

from protochain.residues import BLANK

_SHOWN = 8
"""Places named in a line that tells many changes."""

_RESIDUE = r"residue (?P<number>\S+) (?P<name>\S+) of chain (?P<chain>\S+?)"
_COUNT = re.compile(r"(?P<count>\d+) (?P<kind>.+) left out")
_BESIDE = re.compile(r'.+ left out.*; keep="all" keeps everything')
_GAP = re.compile(r"chain (?P<chain>\S+) is broken between (?P<a>\S+) and (?P<b>\S+) (?P<far>\(.+?\)): .*")
_HISTIDINE = re.compile(
    rf"{_RESIDUE}(?: taken as (?P<state>HI[DEP])|: taken as HIS in protonation state (?P<named>HI[DEP]))"
)
_OF_RESIDUE = re.compile(rf"{_RESIDUE}(?::| (?=taken)) ?(?P<what>.+)")
_LOSS = re.compile(r"left out|is broken|ignored|incomplete|cut short|check that it is complete")
_WATERS = ("waters", "deuterium atoms")
_ALIKE: tuple[tuple[str, str], ...] = (
    (r"alternate location .+ left out", "alternate locations left out"),
    (
        r".+ given more than once; the first of each kept",
        "atoms given more than once, the first of each kept",
    ),
    (r"left out: its backbone atom .+ is missing", "left out, without a backbone atom,"),
    (r"missing OXT added", "missing OXT added"),
    (r"missing .+ added", "missing atoms added"),
    (r"\d+ hydrogens left out: .+", "hydrogens left out that do not belong to the state"),
    (r"side chain turned from .+", "side chains turned"),
    (r"polar hydrogen turned", "polar hydrogens turned"),
    (r"C.+ of the wrong hand turned right", "chiral atoms of the wrong hand turned right"),
    (r"converted to its standard parent .+", "modified residues converted to their standard parents"),
)
"""What a line says of one residue, and what is said of many."""


def summarised(repairs: Iterable[str]) -> tuple[str, ...]:
    """Summarise the lines of ``Structure.repairs``.

    Parameters
    ----------
    repairs : iterable of str

    Returns
    -------
    tuple of str
        First what is lost: molecules left out, gaps, other losses. Then what was changed, the states of all
        histidines in one line, and last the hydrogens added. Lines that are like no other stay as they are.
    """
    groups: dict[tuple[int, str], list[str]] = defaultdict(list)
    for line in repairs:
        groups[_group(line)].append(line)
    return tuple(_told(what, groups[rank, what]) for rank, what in sorted(groups, key=lambda group: group[0]))


def _group(line: str) -> tuple[int, str]:
    """Rank of a line in the summary, and what it says, alike for the lines that are told as one."""
    if _BESIDE.fullmatch(line):
        return 0, line
    if _COUNT.fullmatch(line):
        return 0, "left out"
    if _GAP.fullmatch(line):
        return 1, "gaps"
    if _HISTIDINE.fullmatch(line):
        return 4, "HIS states"
    rank = 2 if _LOSS.search(line) else 5 if "hydrogens added" in line else 3
    found = _OF_RESIDUE.fullmatch(line)
    if not found:
        return rank, line
    alike = (told for form, told in _ALIKE if re.fullmatch(form, found["what"]))
    return rank, next(alike, found["what"])


def _told(what: str, lines: list[str]) -> str:
    """Tell the lines of a group as one; a single one as it is, if it is no list by nature."""
    by_nature: dict[str, Callable[[list[str]], str]] = {"left out": _counts, "HIS states": _states}
    if what in by_nature:
        return by_nature[what](lines)
    if len(lines) == 1:
        return lines[0]
    if what == "gaps":
        found = [match for line in lines if (match := _GAP.fullmatch(line))]
        places = [f"{_chain(each['chain'])}{each['a']}-{each['b']} {each['far']}" for each in found]
        return (
            f"split at {len(places)} gaps in the chains, with charged termini: {_listed(places)}; "
            "to avoid it, model the missing residues"
        )
    places = [_place(line) for line in lines]
    return f"{what} in {len(places)} residues: {_listed(places)}"


def _counts(lines: list[str]) -> str:
    """Tell molecules left out: the rare ones first, waters last."""
    found = [(match["count"], match["kind"]) for line in lines if (match := _COUNT.fullmatch(line))]
    return "left out: " + ", ".join(
        f"{count} {kind}" for count, kind in sorted(found, key=lambda each: each[1] in _WATERS)
    )


def _states(lines: list[str]) -> str:
    """Tell the protonation states of histidines."""
    of: dict[str, list[str]] = defaultdict(list)
    for line in lines:
        if match := _HISTIDINE.fullmatch(line):
            of[match["state"] or match["named"]].append(f"{_chain(match['chain'])}{match['number']}")
    return "HIS states: " + "; ".join(f"{state} {_listed(of[state])}" for state in sorted(of))


def _place(line: str) -> str:
    found = _OF_RESIDUE.fullmatch(line)
    return f"{_chain(found['chain'])}{found['number']} {found['name']}" if found else line


def _chain(chain_id: str) -> str:
    return "" if chain_id == BLANK else f"{chain_id}:"


def _listed(places: list[str]) -> str:
    more = f" and {len(places) - _SHOWN} more" if len(places) > _SHOWN else ""
    return ", ".join(places[:_SHOWN]) + more
