"""Words of identifiers, docstrings and pages: counts which may only fall.

    python tests/project/test_plain_words.py     # lower the table to today's counts

A text may have as many as words.csv permits, or as many as its length permits by the final limits here. The
final limits are 1.5 times the rates of OpenMM's manual and Python layer. A text without a row has only these.
"""

import ast
import csv
import functools
import math
import re
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "protochain"
TABLE = Path(__file__).with_name("words.csv")
DOCS = ROOT / "analysis" / "docs"
PAGES = [
    ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "analysis" / "README.md", *sorted(DOCS.glob("*.md")),
    *sorted((DOCS / "measured").glob("*.md")),
]  # fmt: skip
ROOMS = sorted({path.relative_to(PACKAGE).parts[0] for path in PACKAGE.rglob("*.py")})

EMPTY = frozenset(
    re.findall(
        r"\w+",
        """each found its own given known made done kept mine there named whole beside most what others apart
        wanted called held why more asked gone which told theirs odd said taken both here such else either
        another every other some any rest wrong good bad""",
    )
)
"""Pronouns, bare participles and adverbs: names that describe no value."""
PARTICIPLE = re.compile(r"_?[a-z]+(?:ed|en|old|aid|ept|eld|ound|iven|ade|one|ung|uck|own)")
NO_PARTICIPLE = frozenset(
    re.findall(
        r"\w+",
        """seed speed need shed bond found_ hydrogen screen open even seven token listen written_ alone one
        zone backbone sound bound ground round background second end cone clone down own_ tone ring""",
    )
)
IDENTIFIERS, FUNCTIONS = "identifiers", "functions"
LIMIT_OF_NAMES = 3.0
"""Per 1,000 identifiers, and per 1,000 functions."""


class Phrase(NamedTuple):
    """A fingerprint of the prose, and its limits per 1,000 words."""

    pattern: str
    limit_of_pages: float
    limit_of_docstrings: float


PHRASES = {
    "what as a noun": Phrase(
        r"\b[Ww]hat (?:is|are|was|were|has|have|had|does|do|did|it|a|the|they|one|changed|moves|stays|holds"
        r"|leaves|others|people|no|its|each)\b", 0.3, 0.1,
    ),
    "that of, those of": Phrase(r"\b(?:those|that) (?:of|which|by|with|in|at)\b", 0.4, 0.1),
    "tell, say": Phrase(r"\b(?:told|tells?|said|says|telling)\b", 0.4, 0.1),
    "keep": Phrase(r"\b(?:kept|keeps|keep)\b", 0.5, 0.5),
    "hold": Phrase(r"\b(?:held|holds|hold)\b", 0.3, 0.3),
    "take": Phrase(r"\b(?:taken|takes|take)\b", 1.0, 0.6),
    "leave out": Phrase(r"\b(?:left|leave|leaves|leaving) out\b", 0.2, 0.1),
    "beside": Phrase(r"\bbeside\b", 0.1, 0.1),
    "where as a condition": Phrase(r"(?<!only )\b[Ww]here\b(?! (?:is|are|to)\b)", 2.6, 0.6),
    "is no": Phrase(r"\b(?:is|are|was|were) no\b", 0.4, 0.3),
    "semicolon": Phrase(r";", 3.0, 1.0),
}  # fmt: skip
LONGEST = {"sentence, median": (0.5, 17), "sentence, 90th percentile": (0.9, 33)}
"""Quantile of the words in a sentence, and its limit."""


class Figure(NamedTuple):
    """A count of a text, its final limit per 1,000 words or names, and places."""

    text: str
    name: str
    count: int
    limit_per_thousand: float
    size: int = 1000
    """Words or names of the text."""
    places: tuple[str, ...] = ()

    @property
    def limit(self):
        return math.ceil(self.limit_per_thousand * self.size / 1000.0)


class Module(NamedTuple):
    """Words of a module: identifiers that it defines, its functions among them, its docstrings."""

    identifiers: list[str]
    functions: list[str]
    docstrings: str


def module_of(code):
    """Words of the code of a module. Its docstrings are those of constants too, without examples."""
    identifiers, functions, texts = [], [], []
    for node in ast.walk(ast.parse(code)):
        match node:
            case ast.Name(id=name, ctx=ast.Store()) | ast.Attribute(attr=name, ctx=ast.Store()):
                identifiers.append(name)
            case ast.arg(arg=name) | ast.ClassDef(name=name):
                identifiers.append(name)
            case ast.FunctionDef(name=name):
                identifiers.append(name)
                functions.append(name)
            case ast.Expr(value=ast.Constant(value=str(text))):
                texts.append(re.sub(r"(?m)^\s*(>>>|\.\.\.).*$", "", text))
    return Module(identifiers, functions, "\n".join(texts))


def is_empty(name):
    return name.strip("_") in EMPTY


def is_participle(name):
    return PARTICIPLE.fullmatch(name) is not None and name.strip("_") not in NO_PARTICIPLE


def prose(text):
    """A text without code, tables, comments and addresses."""
    text = re.sub(r"```.*?```", "", text, flags=re.DOTALL)
    text = re.sub(r"<!-- table .*?<!-- end -->", "", text, flags=re.DOTALL)
    text = re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL)
    text = "\n".join(line for line in text.split("\n") if not line.lstrip().startswith("|"))
    text = re.sub(r"`+[^`]*`+", "CODE", text)
    return re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", text)


def figures_of_names(text, modules):
    """Counts of empty identifiers and of functions named by a participle, of modules by their paths."""
    places, sizes = {IDENTIFIERS: [], FUNCTIONS: []}, {IDENTIFIERS: 0, FUNCTIONS: 0}
    for path, module in modules.items():
        for kind, candidates, is_counted in (
            (IDENTIFIERS, module.identifiers, is_empty),
            (FUNCTIONS, module.functions, is_participle),
        ):
            sizes[kind] += len(candidates)
            places[kind] += [f"{name} in {path}" for name in candidates if is_counted(name)]
    return [
        Figure(text, kind, len(places[kind]), LIMIT_OF_NAMES, sizes[kind], tuple(places[kind]))
        for kind in (IDENTIFIERS, FUNCTIONS)
    ]


def figures_of_phrases(text, words, of_docstrings=False):
    """Counts of the phrases in a prose."""
    n_words = max(len(re.findall(r"[A-Za-z']+", words)), 1)
    figures = []
    for name, phrase in PHRASES.items():
        limit = phrase.limit_of_docstrings if of_docstrings else phrase.limit_of_pages
        places = tuple(
            " ".join(words[max(0, match.start() - 30) : match.end() + 30].split())
            for match in re.finditer(phrase.pattern, words)
        )
        figures.append(Figure(text, name, len(places), limit, n_words, places))
    return figures


def figures_of_sentences(text, words):
    """Quantiles of the lengths of sentences."""
    lengths = sorted(len(s.split()) for s in re.split(r"(?<=[.!?])\s+", words) if len(s.split()) > 2)
    return [
        Figure(text, name, lengths[int(quantile * len(lengths))] if lengths else 0, limit)
        for name, (quantile, limit) in LONGEST.items()
    ]


@functools.cache
def modules_of(room):
    """Words of the modules in a room of the package, by their paths."""
    paths = sorted((PACKAGE / room).rglob("*.py")) if (PACKAGE / room).is_dir() else [PACKAGE / room]
    return {str(path.relative_to(ROOT)): module_of(path.read_text(encoding="utf8")) for path in paths}


@functools.cache
def docstrings_of_room(room):
    return prose("\n".join(module.docstrings for module in modules_of(room).values()))


@functools.cache
def prose_of_page(page):
    return prose(page.read_text(encoding="utf8"))


@functools.cache
def figures_of_room(room):
    """Figures of the names in a room and of its docstrings."""
    text, words = f"protochain/{room}", docstrings_of_room(room)
    return (
        *figures_of_names(text, modules_of(room)),
        *figures_of_phrases(text, words, of_docstrings=True),
        *figures_of_sentences(text, words),
    )


@functools.cache
def figures_of_page(page):
    text, words = str(page.relative_to(ROOT)), prose_of_page(page)
    return (*figures_of_phrases(text, words), *figures_of_sentences(text, words))


def total(text, parts):
    """Sums of the counts of several texts, but not of the lengths of sentences."""
    by_name = {}
    for figure in (figure for figures in parts for figure in figures if figure.name not in LONGEST):
        by_name.setdefault(figure.name, []).append(figure)
    return [
        Figure(
            text,
            name,
            sum(figure.count for figure in figures),
            figures[0].limit_per_thousand,
            sum(figure.size for figure in figures),
        )
        for name, figures in by_name.items()
    ]


@functools.cache
def figures_of_all():
    """Figures of the package and of all pages, each as one text."""
    package, pages = "protochain", "all pages"
    return (
        *total(package, map(figures_of_room, ROOMS)),
        *figures_of_sentences(package, "\n".join(map(docstrings_of_room, ROOMS))),
        *total(pages, map(figures_of_page, PAGES)),
        *figures_of_sentences(pages, "\n".join(map(prose_of_page, PAGES))),
    )


def figures_of_today():
    return [
        *figures_of_all(),
        *(figure for room in ROOMS for figure in figures_of_room(room)),
        *(figure for page in PAGES for figure in figures_of_page(page)),
    ]


def permitted():
    """Counts of the table, by text and figure."""
    with TABLE.open(newline="") as file:
        return {(row["text"], row["figure"]): int(row["count"]) for row in csv.DictReader(file)}


def excesses(figures, table):
    """A line for each figure above the table and above its final limit, with its places."""
    return [
        f"{figure.text}: {figure.name} {figure.count}, not more than {most}: {', '.join(figure.places)}"
        for figure in figures
        if figure.count > (most := max(table.get((figure.text, figure.name), 0), figure.limit))
    ]


@pytest.mark.parametrize("room", ROOMS)
def test_names_and_docstrings_of_a_room_have_no_more_empty_words(room):
    assert excesses(figures_of_room(room), permitted()) == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_a_page_has_no_more_empty_words(page):
    assert excesses(figures_of_page(page), permitted()) == []


def test_all_texts_together_have_no_more_empty_words():
    assert excesses(figures_of_all(), permitted()) == []


def test_the_table_is_of_texts_that_exceed_their_limits():
    """A figure at its final limit has no row, so it cannot rise again."""
    exceeding = {(figure.text, figure.name) for figure in figures_of_today() if figure.count > figure.limit}
    assert sorted(set(permitted()) - exceeding) == [], f"run: python {Path(__file__).relative_to(ROOT)}"


TEXT = """# Title

It is kept; that of the others is held. `kept; told` is code. [What is wrong](kept.md#told) remains.

| kept; told | is a table |
|---|---|

```sh
kept; told
```
<!-- kept; told -->
<!-- table kept -->
told
<!-- end -->
"""
COUNTS = {"keep": 1, "semicolon": 1, "that of, those of": 1, "hold": 1, "what as a noun": 1}
CODE = '''
"""A docstring; it is told."""
each, told = 1, 2
its_atoms, box.own = 1, 2
def _marked(known, *, atoms):
    """Report.

    >>> kept;
    """
def write_bond(): ...
def second(): ...
def seed(): ...
'''


def test_figures_of_a_text_with_known_counts():
    figures = {figure.name: figure for figure in figures_of_phrases("page", prose(TEXT))}
    assert {name: figure.count for name, figure in figures.items() if figure.count} == COUNTS
    assert figures["semicolon"].places == ("# Title It is kept; that of the others is held. C",)
    assert [figure.count for figure in figures_of_sentences("page", prose(TEXT))] == [4, 11]


def test_figures_of_code_with_known_counts():
    module = module_of(CODE)
    identifiers, functions = figures_of_names("room", {"m.py": module})
    assert sorted(identifiers.places) == ["each in m.py", "known in m.py", "own in m.py", "told in m.py"]
    assert (identifiers.size, functions.size) == (10, 4)
    assert functions.places == ("_marked in m.py",)
    words = prose(module.docstrings)
    counts = {figure.name: figure.count for figure in figures_of_phrases("room", words, of_docstrings=True)}
    assert {name: count for name, count in counts.items() if count} == {"tell, say": 1, "semicolon": 1}


def test_a_count_above_the_table_is_reported_with_its_words():
    figure = Figure("a.md", "keep", 3, 0.5, 1500, ("is kept", "keeps it", "to keep"))
    assert excesses([figure], {("a.md", "keep"): 3}) == excesses([figure._replace(count=1)], {}) == []
    for table in ({}, {("a.md", "keep"): 2}, {("b.md", "keep"): 3}):
        (line,) = excesses([figure], table)
        assert line.startswith("a.md: keep 3, not more than ") and line.endswith("is kept, keeps it, to keep")


def test_a_total_is_the_sum_of_its_parts():
    parts = [[Figure("a", "keep", 1, 0.5, 900)], [Figure("b", "keep", 2, 0.5, 1600)]]
    (figure,) = total("all", parts)
    assert (figure.count, figure.size, figure.limit) == (3, 2500, 2)


def write_table():
    """Lower the rows of the table to today's counts. Without a table, write all of them."""
    table = permitted() if TABLE.exists() else None
    figures = figures_of_today()
    with TABLE.open("w", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(("text", "figure", "count"))
        for figure in figures:
            most = figure.count if table is None else table.get((figure.text, figure.name), 0)
            if min(figure.count, most) > figure.limit:
                rows.writerow((figure.text, figure.name, min(figure.count, most)))


if __name__ == "__main__":
    write_table()
