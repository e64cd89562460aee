"""The tables of README.md and analysis/README.md, from the tables of analysis/results.

    python analysis/benchmarks/pages.py [--check]

A table or paragraph of a page stands between `<!-- table NAME -->` and `<!-- end -->`, and is made anew by
the function of that name in tables.py or tables_*.py; where its results are not there, it is left as it is.
With --check nothing is written, and the exit status is 1 if a page and its results differ.
"""

import argparse
import importlib
import re
import sys
from pathlib import Path

from made import RESULTS, ROOT
from tables import TABLES

# They register their tables.
for _path in sorted(Path(__file__).parent.glob("tables_*.py")):
    importlib.import_module(_path.stem)

PAGES = tuple(
    ROOT / name
    for name in ("README.md", "analysis/README.md", "analysis/docs/cluster.md", "analysis/docs/theory.md")
)
MARKED = re.compile(r"(<!-- table ([\w-]+) -->\n)(.*?)(<!-- end -->)", re.DOTALL)


def rendered(page: str, results: Path) -> str:
    """A page with its tables made from a folder of results.

    Raises
    ------
    KeyError
        If the page marks a table that nothing makes, or results lack a column.
    """

    def one(found: re.Match[str]) -> str:
        try:
            return found[1] + TABLES[found[2]](results) + found[4]
        except FileNotFoundError:
            return found[0]

    return MARKED.sub(one, page)


def without_results(page: str, results: Path) -> list[str]:
    """Names of the tables of a page that are typed, for their results are not there."""
    names = []
    for _, name, _, _ in MARKED.findall(page):
        try:
            TABLES[name](results)
        except FileNotFoundError:
            names.append(name)
    return names


def write(results: Path = RESULTS, root: Path = ROOT) -> list[Path]:
    """Write the pages that results change, in their places or below another folder; return which."""
    changed = []
    for page in PAGES:
        text = page.read_text()
        new = rendered(text, results)
        to = root / page.relative_to(ROOT)
        if new != text or to != page:
            to.parent.mkdir(parents=True, exist_ok=True)
            to.write_text(new)
            changed.append(to)
    return changed


def parser() -> argparse.ArgumentParser:
    own = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    own.add_argument("--check", action="store_true", help="only say which pages differ")
    return own


def main() -> None:
    options = parser().parse_args()
    for page in PAGES:
        for name in without_results(page.read_text(), RESULTS):
            print(f"{page.relative_to(ROOT)}: {name} has no results, and is as typed")
    if not options.check:
        for page in write():
            print(f"{page.relative_to(ROOT)}: made from analysis/results")
        return
    differ = [page for page in PAGES if rendered(page.read_text(), RESULTS) != page.read_text()]
    for page in differ:
        print(f"{page.relative_to(ROOT)}: differs from analysis/results")
    sys.exit(1 if differ else 0)


if __name__ == "__main__":
    main()
