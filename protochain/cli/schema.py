"""``protochain schema``: output of the commands, as JSON Schema."""

import hashlib
import json
from importlib.resources import files
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from protochain.results.schema import Schema

_VERSIONS = "schemas.txt"  # Lines with command, version of its results, and digest of the schema.


def schema(
    command: Annotated[
        str | None, typer.Argument(metavar="[COMMAND]", help="Command. Without one, list all.")
    ] = None,
) -> None:
    """Show the JSON Schema of the output of a command.

    Each schema has a version, and changes only with it.
    """
    from protochain.cli.contracts import CONTRACTS
    from protochain.core.checks import refuse_unknown

    schema_versions = versions()
    if command is None:
        for name, (version, _) in schema_versions.items():
            print(f"{name:<9} {version}  {', '.join(['--json', *CONTRACTS[name].tables])}")
        return
    refuse_unknown(command, "command", schema_versions)
    print(json.dumps(schema_of(command), indent=2))


def schema_of(command: str) -> "Schema":
    """Schema of the printed output of a command, with tables and folder in ``$defs``."""
    return _document(command, versions()[command][0])


def _document(command: str, version: int) -> "Schema":
    from protochain.cli.contracts import CONTRACTS
    from protochain.results.schema import document

    return document(command, version, CONTRACTS[command])


def digest(command: str) -> str:
    """Digest of a schema, without its version."""
    text = json.dumps(_document(command, 0), sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def versions() -> dict[str, tuple[int, str]]:
    """Latest version of each command's results, and the digest of its schema."""
    lines = (files("protochain.cli") / _VERSIONS).read_text(encoding="utf-8").splitlines()
    return {command: (int(version), checksum) for command, version, checksum in map(str.split, lines)}
