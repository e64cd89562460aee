"""Corrections of the text of a PDB file, so that gemmi reads every atom record."""

import re
from collections.abc import Mapping

import gemmi

from protochain.core.errors import StructureError
from protochain.ligands.dictionary import elements
from protochain.structure.molecule.repairs import Kind, Repair
from protochain.structure.molecule.residues import CAPS, NUCLEOTIDES, STANDARD
from protochain.structure.molecule.templates import standard_name

_INDENTED = re.compile(r"\s+(?:ATOM  |HETATM)[\w* -]{5}", re.IGNORECASE)
_RECORD = re.compile(r"\s+((?:ATOM  |HETATM|CONECT|MODEL |ENDMDL|TER\b|END\b).*)", re.IGNORECASE)
_PLACE = slice(12, 27)  # Columns of the atom name, residue name, chain id and residue number.
_SERIALS = tuple(slice(k, k + 5) for k in range(6, 31, 5))
"""Columns of serial numbers. CONECT records have several."""
_LARGEST_SERIAL = 99_999  # Largest serial number of five digits.
_ORGANIC = (*"HCNOSPFI",)


def remove_indents(lines: list[str]) -> int:
    """Remove blanks before records if atom records are indented, and return the number of these."""
    indented = sum(bool(_INDENTED.match(line)) for line in lines)
    if indented:
        lines[:] = [match[1] if (match := _RECORD.match(line)) else line for line in lines]
    return indented


def is_atom(line: str) -> bool:
    """Return whether a line is an atom record. Rosetta's score lines (atom_pair_constraint) are not."""
    record = line[:6].upper()
    return record.startswith("HETATM") or (record.startswith("ATOM") and not record[4:].strip(" 0123456789"))


def add_elements(lines: list[str]) -> None:
    """Write element symbols of molecules of the component dictionary, and of left-aligned atom names.

    gemmi derives an element from columns 13 and 14. If names begin in column 13, it reads CA of a heme as
    calcium and NA as sodium. The lines are changed in place.
    """
    names: dict[str, dict[str, str]] = {}
    left = False
    for line in lines:
        if is_atom(line) and not line[76:78].strip():
            residue, name = line[17:20].strip().upper(), line[12:16].upper()
            left = left or (residue in STANDARD and name in ("N   ", "CA  ", "C   ", "O   "))
            names.setdefault(residue, {})[name.strip()] = name
    elements_of = {
        residue: _elements(residue, atom_names, left)
        for residue, atom_names in names.items()
        if len(atom_names) > 1
        and standard_name(residue)[0] not in {*STANDARD, *CAPS, *NUCLEOTIDES}
        and not gemmi.find_tabulated_residue(residue).is_water()
    }
    for k, line in enumerate(lines) if any(elements_of.values()) else ():
        if is_atom(line) and not line[76:78].strip():
            element = elements_of.get(line[17:20].strip().upper(), {}).get(line[12:16].strip().upper(), "")
            lines[k] = f"{line[:76]:<76}{element:>2}{line[78:]}" if element else line


def _elements(residue: str, names: Mapping[str, str], left: bool) -> dict[str, str]:
    """Return the elements of atoms of a residue, except those that gemmi derives correctly."""
    listed = elements(residue)
    if all(name in listed or name.lstrip("0123456789").startswith(("H", "D")) for name in names):
        return {name: listed.get(name, "H") for name in names}
    aligned = {name for name, padded in names.items() if left and padded[0] != " "}
    return {name: element for name in aligned if (element := _first_element(name))}


def _first_element(name: str) -> str:
    letters = name.lstrip("0123456789")
    halogen = re.match(r"(CL|BR)\d*$", letters)
    return halogen[1] if halogen else letters[0] if letters[:1] in _ORGANIC else ""


def join_segments(lines: list[str], source: str) -> tuple[list[str], list[Repair]]:
    """Join segments between END and ENDMDL records into one structure, or into models if they are frames.

    gemmi reads nothing after the first END. Programs write END between the frames of a trajectory, and
    concatenated files have it between molecules.
    """
    # Lines after the last atom record are not changed: programs append tables after END.
    last = max((k for k, line in enumerate(lines) if is_atom(line)), default=-1)
    cuts = [k for k, line in enumerate(lines[: last + 1]) if _record(line) in ("MODEL", "ENDMDL", "END")]
    bounds = zip([0, *(k + 1 for k in cuts)], [*cuts, len(lines)], strict=True)
    segments = [(a, b) for a, b in bounds if any(map(is_atom, lines[a:b]))]
    loose = [(a, b) for a, b in segments if not (a and _record(lines[a - 1]) == "MODEL")]
    n_models = len(segments) - len(loose)
    if n_models > 1 and loose:
        line = next(k for k in range(*loose[0]) if is_atom(lines[k])) + 1
        raise StructureError(
            f"{source}: line {line}: atom records outside the {n_models} models; "
            "put them between MODEL and ENDMDL records"
        )
    if len(segments) < 2 or n_models > 1:
        return ["" if k in cuts and _record(line) == "END" else line for k, line in enumerate(lines)], []
    places = [[line[_PLACE] for line in lines[a:b] if is_atom(line)] for a, b in segments]
    if not n_models and all(place == places[0] for place in places):
        return _frames(lines, segments), []
    joined = _renumber_serials(lines, [k for k in cuts if _record(lines[k]) == "END"])
    for k in cuts:
        joined[k] = "" if _record(lines[k]) == "MODEL" else "TER"
    facts = {"count": sum(map(len, places[1:])), "line": segments[0][1] + 1}
    return joined, [Repair(Kind.SEGMENTS_JOINED, facts)]


def _record(line: str) -> str:
    return line[:6].strip().upper()


def _frames(lines: list[str], segments: list[tuple[int, int]]) -> list[str]:
    """Write MODEL and ENDMDL records around the atoms of each segment."""
    output = []
    for number, (start, end) in enumerate(segments, 1):
        atoms = [k for k in range(start, end) if is_atom(lines[k])]
        head = lines[start : atoms[0]] if number == 1 else []
        output += [*head, f"MODEL     {number:4d}", *lines[atoms[0] : atoms[-1] + 1], "ENDMDL"]
    return [*output, *(line for line in lines if _record(line) == "CONECT"), "END"]


def _renumber_serials(lines: list[str], ends: list[int]) -> list[str]:
    """Raise the serial numbers of each concatenated file above the numbers of the files before it."""
    numbered, highest = list[str](), 0
    for start, end in zip([0, *ends], [*ends, len(lines)], strict=True):
        part = lines[start:end]
        serials = [line[_SERIALS[0]] for line in part if is_atom(line)]
        numbers = [int(serial) for serial in serials if serial.strip().isdigit()]
        shift = highest if numbers and min(numbers) <= highest else 0
        if shift and max(numbers) + shift <= _LARGEST_SERIAL:
            part = [_shift_serials(line, shift) for line in part]
        elif shift:  # No serial number is free: CONECT records could refer to atoms of another file.
            part = [line for line in part if _record(line) != "CONECT"]
            part += [""] * (end - start - len(part))
        highest = max([highest, *(number + shift for number in numbers)])
        numbered += part
    return numbered


def _shift_serials(line: str, shift: int) -> str:
    columns = _SERIALS if _record(line) == "CONECT" else _SERIALS[:1] if is_atom(line) else ()
    for column in columns:
        if (serial := line[column].strip()).isdigit():
            line = f"{line[: column.start]}{int(serial) + shift:5d}{line[column.stop :]}"
    return line
