"""Store the public interface of a release: run it when the CHANGELOG has its section.

``PYTHONPATH=tests:analysis python tests/released.py``; commit the file.

Until then ``tests/project/test_changelog.py`` requires a line under Unreleased for each difference.
"""

from pathlib import Path

FILE = Path(__file__).parent / "project" / "released.tsv"


def main() -> None:
    from fixtures.public_names import interface

    rows = sorted(interface().items())
    FILE.write_text("".join(f"{name}\t{default}\n" for name, default in rows), encoding="utf-8")
    print(f"{len(rows)} names")


if __name__ == "__main__":
    main()
