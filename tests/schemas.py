"""Give results whose schema has changed a new version: run it after such a change, and commit the file."""

from pathlib import Path

from protochain.cli.contracts import CONTRACTS
from protochain.cli.schema import digest, versions

FILE = Path(__file__).parents[1] / "protochain" / "cli" / "schemas.txt"


def main() -> None:
    known, lines = versions(), FILE.read_text(encoding="utf-8").splitlines()
    for command in CONTRACTS:
        version, before = known.get(command, (0, ""))
        if digest(command) != before:
            lines.append(f"{command} {version + 1} {digest(command)}")
            print(f"{command}: version {version + 1}")
    FILE.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")


if __name__ == "__main__":
    main()
