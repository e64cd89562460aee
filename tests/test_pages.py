"""Pages and the results they quote: tables made from the CSV, and commands that exist."""

import re
import subprocess
import sys

import pandas as pd
import pytest
from conftest import ROOT

FOLDER = ROOT / "analysis" / "benchmarks"
sys.path.insert(0, str(FOLDER))
import made  # noqa: E402
import pages  # noqa: E402

QUOTED = sorted(
    {
        quoted
        for page in [*pages.PAGES, *(ROOT / "analysis" / "docs").glob("*.md")]
        for quoted in re.findall(r"python\s+((?:analysis|tests)/[\w/]+\.py[^`)\n]*)", page.read_text())
    }
)


@pytest.mark.parametrize("page", pages.PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_tables_of_a_page_are_those_of_the_results(page):
    text = page.read_text()
    assert pages.rendered(text, pages.RESULTS) == text


def test_every_table_is_used():
    used = {name for page in pages.PAGES for _, name, _, _ in pages.MARKED.findall(page.read_text())}
    assert used == set(pages.TABLES)


def test_a_table_follows_its_results():
    text = "before\n<!-- table race-made -->\nstale\n<!-- end -->\nafter\n"
    new = pages.rendered(text, pages.RESULTS)
    assert new.startswith("before\n<!-- table race-made -->\n") and new.endswith("<!-- end -->\nafter\n")
    assert "stale" not in new and "race_gbsa.csv" in new
    with pytest.raises(KeyError):
        pages.rendered("<!-- table nothing -->\n<!-- end -->", pages.RESULTS)


def test_markdown_aligns_numbers_right():
    assert pages.markdown(("a", "b"), [("x", 1)]) == "| a | b |\n|---|--:|\n| x | 1 |\n"


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        (0.0, "never"),
        (float("nan"), "never"),
        (0.62, "0.62x"),
        (9.94, "9.9x"),
        (9.96, "10x"),
        (133.4, "133x"),
    ],
)
def test_ratios_are_quoted_with_two_digits(value, shown):
    assert pages.ratio(value) == shown


@pytest.mark.parametrize("quoted", QUOTED)
def test_commands_that_are_quoted_exist(quoted):
    name, *words = quoted.split()
    text = (ROOT / name).read_text()
    options = [word for word in words if re.fullmatch(r"--?[a-z][\w-]*", word)]
    assert [option for option in options if f'"{option}"' not in text] == []


def test_a_result_says_how_it_was_made(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "argv", [str(FOLDER / "race.py"), "-o", str(tmp_path), "--forces", "obc2"])
    for value in (1, 2):
        made.write(pd.DataFrame({"a": [value]}), tmp_path / "race.csv", ["some/folder/1l2y.pdb"], threads=2)
    made.write(pd.DataFrame({"b": [3]}), tmp_path / "other.csv")
    rows = pd.read_csv(tmp_path / "made.csv", dtype=str, keep_default_na=False).set_index("table")
    assert list(rows.index) == ["other.csv", "race.csv"]
    row = rows.loc["race.csv"]
    assert row["command"] == f"python analysis/benchmarks/race.py -o {tmp_path.name} --forces obc2"
    assert (row["inputs"], row["threads"]) == ("1l2y.pdb", "2")
    head = subprocess.run(["git", "rev-parse", "--short", "HEAD"], cwd=ROOT, capture_output=True, text=True)
    assert row["commit"] == made.COMMIT
    assert made.commit().removesuffix(" and changes") == (head.stdout.strip() or "none")
    assert pd.read_csv(tmp_path / "race.csv")["a"].tolist() == [2]
