"""JSON Schema (draft 2020-12) of kinds of values."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from enum import Enum
from types import NoneType, UnionType
from typing import Any, Literal, NotRequired, Union, get_args, get_origin, get_type_hints, is_typeddict

from protochain.results.columns import UNITS, Kind, heading

Schema = dict[str, Any]
DRAFT = "https://json-schema.org/draft/2020-12/schema"
OTHERS = "*"
"""Key for the kind of values under all other names."""
_PLAIN = {str: "string", bool: "boolean", int: "integer", float: "number", NoneType: "null"}


@dataclass(frozen=True)
class Contract:
    """Output of a command."""

    json: tuple[Kind, ...] = ()  # Alternative kinds of the output of ``--json``.
    # Alternative kinds of a row, by the name of the CSV or its option.
    tables: Mapping[str, tuple[Kind, ...]] = field(default_factory=dict)
    files: tuple[str, ...] = ()  # Names of files that are always in its folder.
    patterns: tuple[str, ...] = ()  # Patterns of the names of other files there.


def document(command: str, version: int, contract: Contract) -> Schema:
    """Schema of a command's output, with tables (arrays of rows) and its folder (names) in ``$defs``."""
    defs: dict[str, Schema] = {
        name: {"type": "array", "items": _one_of(rows)} for name, rows in contract.tables.items()
    }
    if contract.files:
        names: list[Schema] = [{"const": name} for name in contract.files]
        names += [{"pattern": pattern} for pattern in contract.patterns]
        defs["folder"] = {
            "type": "array", "items": {"anyOf": names},
            "allOf": [{"contains": {"const": name}} for name in contract.files],
        }  # fmt: skip
    return {
        "$schema": DRAFT,
        "$id": f"urn:protochain:{command}:{version}",
        "title": f"protochain {command}, version {version} of its results",
        **_one_of(contract.json),
        **({"$defs": defs} if defs else {}),
    }


def _one_of(kinds: Sequence[Kind]) -> Schema:
    return schema(kinds[0]) if len(kinds) == 1 else {"anyOf": [schema(kind) for kind in kinds]}


def schema(kind: Kind) -> Schema:
    """Schema of the values of a kind."""
    if get_origin(kind) is NotRequired:
        return schema(get_args(kind)[0])
    if isinstance(kind, Mapping):
        needed = [name for name, hint in kind.items() if get_origin(hint) is not NotRequired]
        return _object(kind, needed)
    if isinstance(kind, list):
        return {"type": "array", "items": _one_of(kind)}
    if kind in _PLAIN:
        return {"type": _PLAIN[kind]}
    if kind is Any:
        return {}
    if isinstance(kind, type) and issubclass(kind, Enum):
        return {"enum": [part.value for part in kind]}
    if is_typeddict(kind):
        return _object(get_type_hints(kind), sorted(kind.__required_keys__))
    if is_dataclass(kind):
        hints = get_type_hints(kind)
        return _object(hints, [part.name for part in fields(kind)])
    origin, args = get_origin(kind), get_args(kind)
    if origin is Literal:
        return {"enum": [*args]}
    if origin in (Union, UnionType):
        schemas = [schema(part) for part in args]
        # Plain types are in one list, which is shorter.
        is_plain = all({*part} == {"type"} for part in schemas)
        return {"type": [part["type"] for part in schemas]} if is_plain else {"anyOf": schemas}
    if origin in (list, tuple):
        return {"type": "array", "items": schema(args[0])}
    if origin is dict:
        return {"type": "object", "additionalProperties": schema(args[1])}
    raise TypeError(f"{kind!r} has no schema")


def _object(kinds: Mapping[str, Kind], needed: Sequence[str]) -> Schema:
    """Schema of an object with exactly these names, or any others with ``OTHERS``, and units in words."""
    known_kinds = {name: kind for name, kind in kinds.items() if name != OTHERS}
    return {
        "type": "object",
        "properties": {name: schema(kind) | _units_of(name) for name, kind in known_kinds.items()},
        "required": [name for name in needed if name in known_kinds],
        "additionalProperties": schema(kinds[OTHERS]) if OTHERS in kinds else False,
    }


def _units_of(name: str) -> Schema:
    return {"description": heading(name)} if any(name.endswith(unit) for unit in UNITS) else {}


def cell(kind: Kind) -> Kind:
    """Kind of a cell of a table, with missing values. Lists and counts are text."""
    if get_origin(kind) is NotRequired:
        return NotRequired[cell(get_args(kind)[0])]
    origin = get_origin(kind)
    plain = get_args(kind) if origin in (Union, UnionType) else (kind,)
    if any(isinstance(kind_schema, list) or kind_schema not in _PLAIN for kind_schema in plain):
        return str | None
    return Union[(*plain, NoneType)]  # of types known at run time only
