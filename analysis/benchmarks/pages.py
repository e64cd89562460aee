"""The tables of the pages, from the tables of analysis/results.

    python analysis/benchmarks/pages.py [--check]

A table or paragraph of a page stands between `<!-- table NAME -->` and `<!-- end -->`, and is made anew by
what has that name in tables/; where its results are not there, it is left as it is. With --check nothing is
written, and the exit status is 1 if a page and its results differ.
"""

import argparse
import importlib
import pkgutil
import re
import sys
from pathlib import Path

import tables
from made import DOCS, RESULTS, ROOT
from tables import TABLES

for _topic in pkgutil.iter_modules(tables.__path__):
    importlib.import_module(f"tables.{_topic.name}")

FENCED = re.compile(r"^```.*?^```$", re.MULTILINE | re.DOTALL)
PAGES = (ROOT / "README.md", *sorted((ROOT / "analysis").rglob("*.md")))
MARKED = re.compile(r"(<!-- table ([\w-]+) -->\n)(.*?)(<!-- end -->)", re.DOTALL)
GUIDES = (
    "ten-minutes", "coming-from", "words", "relax", "minimise", "dynamics", "complexes", "search",
    "structures", "cluster", "files", "python",
    "commands", "mechanisms", "architecture", "theory", "programs", "pages",
)  # fmt: skip
"""Pages of analysis/docs in the order of the contents; those of measured/ follow, by name."""


@tables.table("contents")
def contents() -> str:
    """Pages of analysis/docs with their sections."""
    measured = sorted((DOCS / "measured").glob("*.md"), key=lambda page: (page.stem == "made", page.name))
    lines = []
    for page in (*(DOCS / f"{name}.md" for name in GUIDES), *measured):
        title, *sections = re.findall(r"^##? (.*)$", FENCED.sub("", page.read_text()), re.MULTILINE)
        place = page.relative_to(DOCS.parent)
        linked = (f"[{name}]({place}#{anchor(name)})" for name in sections)
        lines.append(f"- **[{title}]({place})**: {', '.join(linked)}\n")
    return "".join(lines)


def anchor(heading: str) -> str:
    """What GitHub makes of a heading."""
    return re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-")


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
    if not parser().parse_args().check:
        for page in write():
            print(f"{page.relative_to(ROOT)}: made from analysis/results")
        return
    differ = [page for page in PAGES if rendered(page.read_text(), RESULTS) != page.read_text()]
    for page in differ:
        print(f"{page.relative_to(ROOT)}: differs from analysis/results")
    sys.exit(1 if differ else 0)


if __name__ == "__main__":
    main()
