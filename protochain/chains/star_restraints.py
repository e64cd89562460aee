"""Restraints of NEF and NMR-STAR files: distances and dihedrals between assigned atoms."""

import re
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from protochain.chains.restraint import STIFFNESS, Restraint
from protochain.core.errors import ProtochainError
from protochain.core.markup import excerpt

Row = Mapping[str, str]
"""Values of a row of a table, by items in lower case. Missing values are absent."""


class _Table(NamedTuple):
    """Items of a table. Of several names of an item, the first with a value counts."""

    category: str
    kind: str
    n_atoms: int
    restraint: str
    atom: tuple[str, str, str, str]  # Chain, number of the residue, residue, atom.
    numbers: tuple[str, ...]  # In the order of ``_Numbers``.


class _Numbers(NamedTuple):
    weight: float | None
    target: float | None
    uncertainty: float | None
    lower: float | None
    upper: float | None
    lower_linear: float | None
    upper_linear: float | None


_NEF = "chain_code", "sequence_code", "residue_name", "atom_name"
_STAR = (
    "pdb_strand_id auth_asym_id", "pdb_residue_no auth_seq_id comp_index_id seq_id", "comp_id", "atom_id",
)  # fmt: skip
_NEF_NUMBERS = (
    "weight", "target_value", "target_value_uncertainty", "lower_limit", "upper_limit", "lower_linear_limit",
    "upper_linear_limit",
)  # fmt: skip
_TABLES = (
    _Table("_nef_distance_restraint.", "distance", 2, "restraint_id", _NEF, _NEF_NUMBERS),
    _Table("_nef_dihedral_restraint.", "dihedral", 4, "restraint_id", _NEF, _NEF_NUMBERS),
    _Table(
        "_gen_dist_constraint.", "distance", 2, "id", _STAR,
        ("weight", "target_val distance_val", "target_val_uncertainty", "distance_lower_bound_val",
         "distance_upper_bound_val", "lower_linear_limit", "upper_linear_limit"),
    ),
    _Table(
        "_torsion_angle_constraint.", "dihedral", 4, "id", _STAR,
        ("weight", "angle_target_val", "angle_target_val_err", "angle_lower_bound_val",
         "angle_upper_bound_val", "angle_lower_linear_limit", "angle_upper_linear_limit"),
    ),
)  # fmt: skip


def restraints_of_star(text: str, file: str) -> Iterator[Restraint]:
    """Yield the distances and dihedrals of a file: angstrom, degrees. Its further data are skipped.

    Rows of one restraint are alternatives, whose distance is (sum r^-6)^(-1/6). A ``weight`` multiplies the
    stiffness of :class:`Restraint`. Formats: NEF 1.1 (Gutmanas et al., Nat. Struct. Mol. Biol. 22:433, 2015),
    NMR-STAR 3 (Ulrich et al., J. Biomol. NMR 73:5, 2019).
    """
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
        for table in _TABLES:
            rows = defaultdict[str, list[Row]](list)
            for row in _rows(frame, table.category):
                rows[row.get(table.restraint, ".")].append(row)
            potential = frame.find_value(f"{table.category[:-1]}_list.potential_type") or ""
            for name, alternatives in rows.items():
                label = f"{file}: restraint {name}"
                try:
                    yield from _restraints(table, alternatives, potential.strip("'\""), label, chains)
                except ProtochainError as error:
                    raise ProtochainError(f"restraint {name} of {frame.name}: ", *error.parts) from None


def _rows(frame: Any, category: str) -> Iterator[Row]:
    """Rows of a table of a saveframe."""
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


def _restraints(
    table: _Table, rows: Sequence[Row], potential: str, label: str, chains: Mapping[str, str]
) -> Iterator[Restraint]:
    """Restraints of the rows of one restraint: one, or of rows joined by and, several."""
    # NEF: a row without weight does not restrain.
    rows = [row for row in rows if _numbers(table, row).weight != 0.0]
    if not rows:
        return
    members = {_value(row, "restraint_combination_id combination_id") for row in rows}
    logic = {row.get("member_logic_code", "OR").upper() for row in rows}
    is_joined = len(rows) > 1 and (members != {""} or logic == {"AND"})
    if len(members) > 1 or len(logic) > 1 or (table.n_atoms == 4 and len(rows) > 1 and not is_joined):
        raise ProtochainError("alternatives of several coordinates are not implemented; remove its rows")
    for group in [[row] for row in rows] if is_joined else [rows]:
        bounds = {_numbers(table, row) for row in group}
        if len(bounds) > 1:
            raise ProtochainError("its rows have different bounds or weights; give them the same")
        places = dict.fromkeys(
            tuple(_place(table, row, k, chains) for k in range(1, table.n_atoms + 1)) for row in group
        )
        yield _restraint(table, sum(places, ()), bounds.pop(), potential, label)


def _numbers(table: _Table, row: Row) -> _Numbers:
    texts = {names: _value(row, names) for names in table.numbers}
    try:
        return _Numbers(*(float(text) if text else None for text in texts.values()))
    except ValueError:
        raise ProtochainError(f"{excerpt(' '.join(texts.values()))} are not numbers; correct them") from None


def _restraint(
    table: _Table, places: tuple[str, ...], numbers: _Numbers, potential: str, label: str
) -> Restraint:
    """Restraint of a potential type of NEF, or of the stated bounds if the type is another word."""
    if potential.startswith("log"):
        raise ProtochainError(f"the potential {potential} is not implemented; give square-well-parabolic")
    lower = None if potential.startswith("upper-bound") else numbers.lower
    upper = None if potential.startswith("lower-bound") else numbers.upper
    if numbers.target is not None and (potential == "parabolic" or lower is upper is None):
        spread = 0.0 if potential == "parabolic" else numbers.uncertainty or 0.0
        lower, upper = numbers.target - spread, numbers.target + spread
    stiffness = STIFFNESS * (1.0 if numbers.weight is None else numbers.weight)
    is_dihedral = table.kind == "dihedral"
    if (lower is None and upper is None) or (is_dihedral and None in (lower, upper)):
        raise ProtochainError("has no bounds; give its lower and upper limit, or its target value")
    sides = (stiffness, stiffness if upper is not None else 0.0)
    low, high = (lower if lower is not None else 0.0), (upper if upper is not None else lower)
    assert high is not None
    # A dihedral between 170 and -170 degrees is between 170 and 190.
    high += 360.0 * (is_dihedral and high < low)
    is_linear = not potential.endswith("parabolic")
    lengths = (numbers.lower_linear, low, -1.0), (numbers.upper_linear, high, 1.0)
    below, above = (0.0 if end is None else sign * (end - at) * is_linear for end, at, sign in lengths)
    linear = (below % 360.0, above % 360.0) if is_dihedral else (max(below, 0.0), max(above, 0.0))
    return Restraint(table.kind, places, low, high, sides, linear, label=label)


def _place(table: _Table, row: Row, k: int, chains: Mapping[str, str]) -> str:
    """Selection of the k-th atom of a row, or of the set of atoms that its name means."""
    chain, number, residue, name = (_value(row, names, f"_{k}") for names in table.atom)
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
