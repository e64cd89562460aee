"""The studies of ``python analysis/bench``, cut short: what they measure, and what they write."""

from unittest.mock import Mock

import numpy as np
import pandas as pd
import pytest
from scipy.linalg import eigh

import protochain as pc
from bench import provenance
from bench.__main__ import main
from bench.cases import Found
from bench.studies import stability
from bench.studies.precision import solvers as precise
from bench.studies.stability import cells, mechanics
from protochain.core.errors import Fault
from protochain.mechanics.multibody import HingeKind, mass_matrix, pose, random_tree


def test_the_grid_counts_what_it_found(tmp_path, monkeypatch):
    def fails(threads):
        raise RuntimeError("out of order")

    def refuses(threads):
        raise pc.ProtochainError("give another number", fault=Fault.SHAPE)

    def two_lines(threads):
        raise pc.ProtochainError("give\nanother", fault=Fault.SHAPE)

    table = (
        cells.Case("sums", "good", lambda threads: Found(1e-16, 1e-15, "by hand")),
        cells.Case("sums", "bad", lambda threads: Found(1e-14, 1e-15, "by hand")),
        cells.Case("sums", "NaN", lambda threads: Found(np.nan, 1e-15, "by hand")),
        cells.Case("sums", "raises", fails),
        cells.Case("sums", "two lines", two_lines, refusal=Fault.SHAPE),
        cells.Case("limits", "refuses", refuses, refusal=Fault.SHAPE),
        cells.Case("limits", "refuses unasked", refuses),
        cells.Case("limits", "refuses otherwise", refuses, refusal=Fault.STEP),
        cells.Case("limits", "answers", lambda threads: Found(0, 0, ""), refusal=Fault.SHAPE),
        cells.Case("threads", "a bit", lambda threads: Found(0.25 * threads, 1, "by hand")),
        cells.Case("threads", "NaN both", lambda threads: Found(0, np.nan, "by hand")),
        cells.Case("threads", "a word", lambda threads: Found(0, 1, "by hand", str(threads))),
        cells.case("threads", "has none", lambda: Found(0, 1, "by hand")),
        cells.Case("limits", "long", lambda threads: Found(0, 0, ""), cells.Part.FULL),
    )
    monkeypatch.setattr(mechanics, "CASES", table)
    run = cells.ordered(cells.run_cells(["mechanics"], cells.Part.QUICK, (1, 2)))
    verdicts = ["right", *["wrong"] * 4, "refused", *["wrong"] * 6, "right"]
    assert run["verdict"].tolist() == verdicts
    messages = run["message"].tolist()
    assert messages[3] == "RuntimeError: out of order" and messages[5] == "give another number"
    assert messages[6:8] == [
        "refused where an answer is expected: give another number",
        "refused, not for Fault.STEP: give another number",
    ]
    assert messages[8].startswith("an answer where a refusal is expected") and not messages[10]
    assert "2 threads: right, error 0.5," in messages[9] and messages[11].startswith("not the same by")
    assert run["threads"].tolist() == [*["1 2"] * 12, "1"]
    monkeypatch.setattr(cells, "ROWS", ("mechanics",))
    monkeypatch.setattr(stability, "processors", lambda: 1)
    asked = ["stability", "--quick", "--rows", "mechanics", "-o", str(tmp_path)]
    assert main(asked) == 1
    assert len(pd.read_csv(tmp_path / "cells.csv")) == 13
    text = (tmp_path / "report.html").read_text()
    assert text.count('<td class="wrong">') == 10 and text.count('<td class="refused">') == 1
    monkeypatch.undo()
    with pytest.raises(pc.ProtochainError, match="give no files"):
        next(stability.run(tmp_path, [tmp_path / "x.pdb"]))
    with pytest.raises(pc.ProtochainError, match="no row 'springy'; choose from mechanics, springs"):
        next(stability.run(tmp_path, rows=["springy"]))


def test_the_whole_grid_has_an_oracle_for_each_of_its_cells():
    named = [(row, each.name, each.parameters) for row in cells.ROWS for _, each in cells.cases_of(row)]
    assert len(named) >= 300 and len(set(named)) == len(named)


@pytest.mark.parametrize("row", cells.ROWS)
def test_the_smallest_part_of_the_grid_has_no_wrong_cell(row):
    found = list(cells.run_cells([row], cells.Part.TESTED, (1, 2)))
    assert not [cell for cell in found if cell.verdict == "wrong"]
    right = [cell for cell in found if cell.verdict == "right"]
    assert len(right) >= 2 and all(cell.source and cell.error <= cell.bound for cell in right)


def test_the_norm_and_the_error_are_those_of_the_dense_matrix():
    tree = random_tree(12, 3, 0.0, HingeKind.FREE)
    random = np.random.default_rng(0)
    frames, tau = pose(tree, random.uniform(-3, 3, tree.n_q)), random.normal(size=tree.n_v)
    mass = mass_matrix(tree, frames)
    norm = eigh(mass, eigvals_only=True)[-1]
    assert 0.9 * norm < precise.norm_of_mass(tree, frames) <= norm * (1 + 1e-12)
    x = np.linalg.solve(mass, tau) * (1 + 1e-6)
    expected = np.linalg.norm(mass @ x - tau) / (norm * np.linalg.norm(x) + np.linalg.norm(tau))
    measured = precise.backward_error(tree, frames, x, tau) * np.finfo(float).eps
    assert measured == pytest.approx(expected, rel=0.1)


def test_pages_say_how_they_were_made_without_git_too(monkeypatch):
    monkeypatch.setattr(provenance.subprocess, "run", Mock(side_effect=FileNotFoundError))
    assert provenance.made("1")["commit"] in ("unknown: git is not installed", "none: an installed package")
