"""Restraints of NEF and NMR-STAR files: distances and dihedrals between assigned atoms."""

import math
import re
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from protochain.chains.restraint import STIFFNESS, Restraint
from protochain.core.errors import ProtochainError
from protochain.core.markup import excerpt

Row = Mapping[str, str]  # Values of a row of a table, by items in lower case. Missing values are absent.
Numbers = tuple[float | None, ...]  # Values of ``_NUMBERS``.
_TABLES = {
    "_nef_distance_restraint.": 2, "_gen_dist_constraint.": 2, "_nef_dihedral_restraint.": 4,
    "_torsion_angle_constraint.": 4,
}  # fmt: skip
"""Categories, and the number of atoms of their restraints."""
_ATOM = (
    "chain_code pdb_strand_id auth_asym_id", "sequence_code pdb_residue_no auth_seq_id comp_index_id seq_id",
    "residue_name comp_id", "atom_name atom_id",
)  # fmt: skip
_NUMBERS = (
    "weight", "target_value target_val distance_val angle_target_val",
    "target_value_uncertainty target_val_uncertainty angle_target_val_err",
    "lower_limit distance_lower_bound_val angle_lower_bound_val",
    "upper_limit distance_upper_bound_val angle_upper_bound_val",
    "lower_linear_limit angle_lower_linear_limit", "upper_linear_limit angle_upper_linear_limit",
)  # fmt: skip
"""Items of an atom and of the numbers, by their names in all tables. The first with a value counts."""


def restraints_of_star(text: str, file: str) -> Iterator[Restraint]:
    """Yield the distances and dihedrals of a file: angstrom, degrees. Its further data are skipped."""
    # Rows of one restraint are alternatives, whose distance is (sum r^-6)^(-1/6). A ``weight`` multiplies the
    # stiffness of :class:`Restraint`. Formats: NEF 1.1 (Gutmanas et al., Nat. Struct. Mol. Biol. 22:433,
    # 2015), NMR-STAR 3 (Ulrich et al., J. Biomol. NMR 73:5, 2019).
    import gemmi

    # CIF, unlike STAR, has no plain words that begin with $.
    text = re.sub(r"(?<=\s)(\$[\w.-]+)", r"'\1'", text)
    try:
        block = gemmi.cif.read_string(text)[0]
    except (ValueError, RuntimeError, IndexError) as error:
        raise ProtochainError(f"not a NEF or NMR-STAR file ({error}); correct it") from None
    frames = [*(item.frame for item in block if item.frame is not None), block]
    chains = _chains(frames)
    for frame in frames:
        for category, n_atoms in _TABLES.items():
            rows = defaultdict[str, list[Row]](list)
            for row in _rows(frame, category):
                rows[_value(row, "restraint_id id")].append(row)
            potential = (frame.find_value(f"{category[:-1]}_list.potential_type") or "").strip("'\"")
            for name, alternatives in rows.items():
                try:
                    for places, numbers in _alternatives(alternatives, n_atoms, chains):
                        yield _restraint(
                            n_atoms == 4, places, numbers, potential, f"{file}: restraint {name}"
                        )
                except ProtochainError as error:
                    raise ProtochainError(f"restraint {name} of {frame.name}: ", *error.parts) from None


def _rows(frame: Any, category: str) -> Iterator[Row]:
    import gemmi

    table = frame.find_mmcif_category(category)
    items = [tag[len(category) :].lower() for tag in table.tags]
    for row in table:
        yield {
            item: gemmi.cif.as_string(value)
            for item, value in zip(items, row, strict=True)
            if not gemmi.cif.is_null(value)
        }


def _chains(frames: Sequence[Any]) -> dict[str, str]:
    """Chain of each number of NMR-STAR's table of molecules."""
    rows = (row for frame in frames for row in _rows(frame, "_entity_assembly."))
    return {row["id"]: name for row in rows if (name := _value(row, "pdb_chain_id asym_id"))}


def _value(row: Row, names: str, ending: str = "") -> str:
    return next((row[item] for name in names.split() if (item := f"{name}{ending}") in row), "")


def _alternatives(
    rows: Sequence[Row], n_atoms: int, chains: Mapping[str, str]
) -> Iterator[tuple[tuple[str, ...], Numbers]]:
    """Places and numbers of the rows of one restraint: of all, or of rows joined by and, of each."""
    # NEF: a row of weight 0 does not restrain.
    rows = [row for row in rows if _numbers(row)[0] != 0.0]
    members = {_value(row, "restraint_combination_id combination_id") for row in rows}
    logic = {row.get("member_logic_code", "OR").upper() for row in rows}
    is_joined = len(rows) > 1 and (members != {""} or logic == {"AND"})
    if len(members) > 1 or len(logic) > 1 or (n_atoms == 4 and len(rows) > 1 and not is_joined):
        raise ProtochainError("alternatives of several coordinates are not implemented; remove its rows")
    for group in [[row] for row in rows] if is_joined else [rows] * bool(rows):
        if len(bounds := {_numbers(row) for row in group}) > 1:
            raise ProtochainError("its rows have different bounds or weights; give them the same")
        places = dict.fromkeys(tuple(_place(row, k, chains) for k in range(1, n_atoms + 1)) for row in group)
        yield sum(places, ()), bounds.pop()


def _numbers(row: Row) -> Numbers:
    texts = [_value(row, names) for names in _NUMBERS]
    try:
        return tuple(float(text) if text else None for text in texts)
    except ValueError:
        raise ProtochainError(f"{excerpt(' '.join(texts))} are not numbers; correct them") from None


def _restraint(
    turns: bool, places: tuple[str, ...], numbers: Numbers, potential: str, label: str
) -> Restraint:
    """Restraint of a potential type of NEF, or of the stated bounds if the type is another word."""
    if potential.startswith("log"):
        raise ProtochainError(f"the potential {potential} is not implemented; give square-well-parabolic")
    weight, target, uncertainty, lower, upper, *ends = numbers
    lower = None if potential.startswith("upper-bound") else lower
    upper = None if potential.startswith("lower-bound") else upper
    if target is not None and (potential == "parabolic" or lower is upper is None):
        spread = 0.0 if potential == "parabolic" else uncertainty or 0.0
        lower = None if potential.startswith("upper-bound") else target - spread
        upper = None if potential.startswith("lower-bound") else target + spread
    if lower is upper is None or (turns and None in (lower, upper)):
        raise ProtochainError("has no bounds; give its lower and upper limit, or its target value")
    stiffness = STIFFNESS * (1.0 if weight is None else weight)
    sides = (stiffness, 0.0 if upper is None else stiffness)
    low = lower or 0.0
    high = low if upper is None else upper
    # A dihedral between 170 and -170 degrees is between 170 and 190.
    high += 360.0 * math.ceil((low - high) / 360.0) if turns and high < low else 0.0
    is_linear = not potential.endswith("parabolic")
    lengths = zip(ends, (low, high), (-1.0, 1.0), strict=True)
    below, above = (0.0 if end is None else sign * (end - at) * is_linear for end, at, sign in lengths)
    linear = (below % 360.0, above % 360.0) if turns else (max(below, 0.0), max(above, 0.0))
    return Restraint("dihedral" if turns else "distance", places, low, high, sides, linear, label=label)


def _place(row: Row, k: int, chains: Mapping[str, str]) -> str:
    """Selection of the k-th atom of a row, or of the set of atoms that its name means."""
    chain, number, residue, name = (_value(row, names, f"_{k}") for names in _ATOM)
    if not (number and name):
        raise ProtochainError(f"its atom {k} has no residue or name; add them, or remove the restraint")
    molecule = row.get(f"entity_assembly_id_{k}", "")
    chain = chain or chains.get(molecule, molecule) or '""'
    # Of a name for either of two atoms, NMR-STAR chooses one. The author's name is the other.
    author = row.get(f"auth_atom_id_{k}", "")
    name = author if re.search("[xy]%?$", author) else name
    # NEF: x and y are either of two atoms, and without an assignment both: primes of sugars, or digits.
    name = re.sub("'[xy]$", "'*", re.sub("^H5[xy]$", "H5'x", name))
    name = re.sub("[xy]?%$|[xy]$", "+#", name)
    resname = f" and resname {residue}" if residue else ""
    return f"atom {chain} {number} {name}{resname}"
