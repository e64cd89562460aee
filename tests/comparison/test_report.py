"""The report in a browser: it draws, sorts, says nothing on the console, and asks nobody for anything."""

import dataclasses
import io
import itertools

import looks
import matplotlib.image
import numpy as np
import pandas as pd
import pytest
from fixtures.drawings import faults
from fixtures.samples import chain, energy
from fixtures.waiting import until

import protochain as pc
from protochain.core.figure import Figure
from protochain.results.page import table_data, templates
from protochain.validation.clashes import clashes

EVIL = "<img src=x onerror=alert(1)></script><script>alert(2)</script>"


@pytest.fixture(scope="module")
def page_file(tmp_path_factory):
    comparison = pc.compare(
        chain("1l2y.pdb"), ("lbfgs", "kcm", "openmm"), energy("1l2y.pdb"), max_evaluations=30
    )
    origin = {"input": EVIL}
    return dataclasses.replace(comparison, origin=origin).report(tmp_path_factory.mktemp("page"))


def opened(browser, file, width=500, scheme="light"):
    """A page, what it says and what it asks for; small, as nothing but a processor draws it."""
    page = browser.new_page(viewport={"width": width, "height": 500}, color_scheme=scheme)
    said, asked = [], []
    page.on("console", lambda message: said.append(message.text))
    page.on("pageerror", lambda error: said.append(str(error)))
    page.on("dialog", lambda dialog: said.append(dialog.message))
    page.on("request", lambda request: asked.append(request.url))
    page.goto(file.as_uri())
    return page, said, asked


def picture(page, place):
    """Pixels of a part of a page, when what was asked for has been drawn: a frame later."""
    page.evaluate("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
    return matplotlib.image.imread(io.BytesIO(page.locator(place).screenshot()))


@pytest.mark.parametrize(("width", "scheme"), [(1200, "light"), (390, "dark")])
def test_the_page_works_from_a_file(browser, page_file, width, scheme):
    page, said, asked = opened(browser, page_file, width, scheme)
    page.wait_for_selector("#viewer[data-models='4'] canvas")
    assert said == []
    assert [url for url in asked if not url.startswith(("data:", "blob:"))] == [page_file.as_uri()]
    # Nothing is wider than the screen but what scrolls by itself.
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    drawn = picture(page, "#viewer")[5:-5, 5:-5, :3]
    assert np.mean(np.abs(drawn - drawn[0, 0]).max(axis=-1) > 0.1) > 0.01
    page.locator("#shown input").first.uncheck()
    page.select_option("#style", "stick")

    def column(k):
        rows = page.locator("table").first.locator("tbody tr")
        return [rows.nth(i).locator("td").nth(k).inner_text() for i in range(rows.count())]

    assert column(0) == ["lbfgs", "kcm", "openmm"]
    heading = page.locator("table").first.locator("th").nth(3)
    heading.locator("button").focus()
    page.keyboard.press("Enter")
    ends = [float(value) for value in column(3)]
    assert heading.get_attribute("aria-sort") == "ascending" and ends == sorted(ends)
    page.keyboard.press("Enter")
    assert [float(value) for value in column(3)] == sorted(ends, reverse=True)
    # A table is saved as it is sorted. Its headings stay when it scrolls, by keys too where it is cut.
    with page.expect_download() as saved:
        page.get_by_role("button", name="Save as CSV").first.click()
    assert [str(value) for value in pd.read_csv(saved.value.path(), dtype=str).iloc[:, 3]] == column(3)
    assert page.locator("table").count() == page.locator("button", has_text="Save as CSV").count()
    page.wait_for_function("document.querySelector('.scroll[role=region]').hasAttribute('tabindex')")
    is_cut = page.locator(".scroll:has(> table)").first.evaluate("e => e.scrollWidth > e.clientWidth + 1")
    first = page.locator(".scroll:has(> table)").first
    assert first.get_attribute("tabindex") == ("0" if is_cut else "-1") and is_cut == (width < 500)
    assert is_cut == ("wide" in first.get_attribute("class"))
    assert heading.evaluate("e => getComputedStyle(e).position") == "sticky"
    assert said == []


def test_residues_are_coloured_by_what_is_chosen(browser, page_file, tmp_path):
    """Each choice draws other colours, of every atom."""
    page, said, _ = opened(browser, page_file)
    viewer = page.locator("#viewer")
    page.wait_for_selector("#viewer[data-models='4'] canvas")
    choices = page.locator("#colouring option").all_inner_texts()
    assert choices[:4] == [
        "each structure its own", "displacement, angstrom", "energy, kJ/mol", "change of energy, kJ/mol",
    ]  # fmt: skip
    assert {"bonds, kJ/mol", "Lennard-Jones, kJ/mol", "surface, kJ/mol"} <= {*choices}
    assert not page.locator("#scale").is_visible()
    seen = []
    for name in (choices[0], "energy, kJ/mol", "Coulomb, kJ/mol", "displacement, angstrom"):
        page.select_option("#colouring", label=name)
        seen.append(picture(page, "#viewer"))
        assert viewer.get_attribute("data-unknown") == "0"
    assert all(not np.array_equal(*pair) for pair in itertools.combinations(seen, 2))
    assert page.locator("#scale").is_visible() and page.locator("#scale .low").inner_text() == "0.00"
    assert said == []


def test_the_page_of_interfaces_shows_both_sides_and_is_sorted(browser, tmp_path):
    from fixtures.command_line import run
    from fixtures.samples import STRUCTURES

    page_file = tmp_path / "page.html"
    given = [STRUCTURES / "3i40.pdb", "--interface", "A:B", "--interface", "A:resid 20:30 and chainID B"]
    run("score", *given, "--report", page_file, "--solvent", "vacuum", "--rank", "contacts")
    page, said, _ = opened(browser, page_file)
    page.wait_for_selector("#viewer[data-shown] canvas")
    shown = [int(page.locator("#viewer").get_attribute("data-shown"))]
    page.select_option("#interface", "1")
    shown.append(int(page.locator("#viewer").get_attribute("data-shown")))
    heavy = [
        int(sum((s.atom_element != "H")[np.isin(s.atom_residue, np.flatnonzero(its.shares != 0.0))]))
        for s in [pc.load(STRUCTURES / "3i40.pdb")]
        for its in [pc.score_interface(s, "A", "B", solvent="vacuum")]
    ]
    assert 0 < shown[1] < shown[0] <= heavy[0]
    drawn = picture(page, "#viewer")[5:-5, 5:-5, :3]
    assert np.mean(np.abs(drawn - drawn[0, 0]).max(axis=-1) > 0.1) > 0.01
    for side in ("1", "2"):
        page.locator(f'#shown input[value="{side}"]').uncheck()
    page.select_option("#style", "stick")
    assert page.evaluate("document.documentElement.scrollWidth") <= 500 and said == []


def test_the_page_of_a_relaxation_shows_ligands_in_their_pockets(browser, tmp_path):
    Chem = pytest.importorskip("rdkit.Chem")
    AllChem = pytest.importorskip("rdkit.Chem.AllChem")
    from fixtures.command_line import run
    from fixtures.samples import STRUCTURES

    protein, made = STRUCTURES / "1l2y.pdb", Chem.AddHs(Chem.MolFromSmiles("CC(=O)[O-]"))
    assert AllChem.EmbedMolecule(made, randomSeed=7) == 0
    x, there = made.GetConformer().GetPositions(), 10.0 * pc.load(protein).positions
    x += [there[:, 0].max() + 3.0 - x[:, 0].min(), *(there.mean(0) - x.mean(0))[1:]]
    made.GetConformer().SetPositions(x)
    Chem.MolToMolFile(made, str(tmp_path / "pose.sdf"))
    page_file = tmp_path / "page.html"
    run(
        "relax",
        protein,
        "--ligands",
        tmp_path / "pose.sdf",
        "-o",
        tmp_path / "out.pdb",
        "--report",
        page_file,
    )
    page, said, _ = opened(browser, page_file)
    # Four heavy atoms, before and after; the viewer leaves hydrogens out.
    page.wait_for_selector("#pocket-viewer[data-shown='8'] canvas")
    assert "LIG" in page.locator("#pocket option").first.inner_text()
    drawn = picture(page, "#pocket-viewer")[5:-5, 5:-5, :3]
    assert np.mean(np.abs(drawn - drawn[0, 0]).max(axis=-1) > 0.1) > 0.003
    page.locator("#pocket-shown input").first.uncheck()
    # The ligand is in focus, and the slider selects whose clashes are discs.
    viewer = page.locator("#viewer")
    assert viewer.get_attribute("data-at") == "B:1"
    start = pc.load(protein, ligands=tmp_path / "pose.sdf")
    page.locator("#between").fill("0")
    assert viewer.get_attribute("data-discs") == f"{len(clashes(start).pairs)}"
    page.locator("#discs").uncheck()
    assert viewer.get_attribute("data-discs") == "0"
    page.locator("#between").fill("1")
    # A name goes to its residue, in the first viewer that has it.
    name = page.locator("button.residue").first
    name.click()
    assert page.locator("#viewer").get_attribute("data-at") == name.get_attribute("data-residue")
    first = picture(page, "#viewer")
    page.locator("#between").fill("0")
    assert not np.array_equal(first, picture(page, "#viewer"))
    page.get_by_text("Spin").first.click()
    page.get_by_text("Reset").first.click()
    with page.expect_download() as saved:
        page.get_by_text("Save picture").first.click()
    assert matplotlib.image.imread(saved.value.path()).std() > 0.01
    assert said == []


def test_the_page_of_a_simulation_plays_its_frames(browser, tmp_path, monkeypatch):
    from fixtures.command_line import run
    from fixtures.samples import STRUCTURES

    monkeypatch.chdir(tmp_path)
    run("simulate", STRUCTURES / "ala10.pdb", "-o", "out", "--steps", "200", "--every", "20")
    page, said, _ = opened(browser, tmp_path / "out" / "report.html")
    page.wait_for_selector("#viewer[data-frame='0'] canvas")
    first = picture(page, "#viewer")
    page.locator("#frame").fill("10")
    page.wait_for_selector("#viewer[data-frame='10']")
    assert (
        not np.array_equal(first, picture(page, "#viewer")) and page.locator("#time").inner_text() == "1 ps"
    )
    page.locator("#play").click()
    until(lambda: page.locator("#viewer").get_attribute("data-frame") != "10")
    assert said == []


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    """What the commands of looks.py read beside the package's structures."""
    folder = tmp_path_factory.mktemp("inputs")
    looks.prepared(folder)
    return folder


LONG = "compare", "ligand", "predicted"
"""Pages that other tests open, or that take minutes."""
QUICK = "energy", "score", "modes", "batch"
"""Pages of each kind of layout that the fast tests look at."""


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=() if name in QUICK else pytest.mark.slow)
        for name in looks.PAGES
        if name not in LONG
    ],
)
def test_a_page_is_sound_at_both_widths_light_and_dark(browser, name, inputs, tmp_path, monkeypatch):
    """Of the page, by AUDIT; of its figures, no text over an edge or another, and units."""
    from fixtures.command_line import run

    wrong, save = [], Figure.savefig

    def looked_at(figure, *args, **options):
        wrong.extend(faults(figure))
        save(figure, *args, **options)

    monkeypatch.setattr(Figure, "savefig", looked_at)
    monkeypatch.chdir(tmp_path)
    assert run(*looks.words_of(name, inputs)) in (None, 0, 3)
    files = looks.pages_of(name, tmp_path, inputs)
    assert files and wrong == []
    assert [line for file in files for line in looks.looked_at(browser, file)] == []


def test_the_page_of_a_mechanism_is_sound(browser, inputs):
    (file,) = looks.pages_of("mechanism", inputs / "mechanism", inputs)
    assert list(looks.looked_at(browser, file)) == []


def test_the_audit_sees_what_is_wrong(browser, tmp_path):
    """Each fault of a page without any is told."""
    below = '<p style="margin-top: -2.5rem">below</p>'
    blank = '<canvas width="90" height="90" aria-label="blank"></canvas>'
    faulty = {
        "overlaps": f"<p>above</p>{below}", "empty picture": blank, "not one main": "<main>more</main>",
        "empty panel": '<section style="height: 6rem"></section>',
        "two of id": '<p id="a">x</p><p id="a">y</p>',
        "scrolls to the side": '<div style="width: 2000px">wide</div>',
        "contrast": '<p style="color: #999; background: #ccc">pale</p>',
        "cut": '<div style="overflow: hidden; width: 3rem; white-space: nowrap">too long</div>',
        "image without words": '<img src="data:,">', "nameless": "<button></button>",
        "table without headings": "<table><tr><td>1</td></tr></table>",
    }  # fmt: skip
    page = browser.new_page(viewport={"width": 390, "height": 400})
    for fault, html in [("", "<p>well</p>"), *faulty.items()]:
        page.set_content(f'<html lang="en"><title>t</title><main><h1>h</h1>{html}</main></html>')
        found = page.evaluate(looks.AUDIT)
        assert bool(found) == bool(fault) and all(fault in line for line in found[:1]), (fault, found)
    cell = '<table><tr><th style="min-width: 900px">h</th></tr></table>'
    table = f'<div class="scroll" style="overflow: auto">{cell}</div>'
    page.set_content(f'<html lang="en"><title>t</title><main><h1>h</h1>{table}</main></html>')
    assert page.evaluate(looks.AUDIT) == [] and "loses columns" in page.evaluate(looks.AUDIT, True)[0]


def test_axe_sees_what_is_wrong(browser):
    pytest.importorskip("axe_playwright_python")
    page = browser.new_page(viewport={"width": 390, "height": 400})
    page.set_content('<html lang="en"><title>t</title><main><h1 role="list">h</h1></main></html>')
    assert any(line.startswith("axe: ") for line in looks.audited(page, axe=looks.axe_source()))


def many_rows(n):
    """Page of a batch's table of n rows, with one that is bad and one name that is markup."""
    values = np.linspace(10_000.0, 20_000.0, n)
    table = pd.DataFrame({
        "structure": [EVIL, *(f"s{k}" for k in range(1, n))],
        "method": np.where(np.arange(n) % 2, "kcm", "lbfgs"),
        "status": ["error", *["converged"] * (n - 1)], "seconds": values, "seed": 0,
        "message": ["it has no atoms", *["well"] * (n - 1)],
    })  # fmt: skip
    data = table_data(table, ("structure", "status", "method", "seconds"), [*["page.html"] * n], "method")
    table = templates().from_string(
        '{% extends "page.html" %}{% from "tables.html" import explored %}{% block title %}t{% endblock %}'
        '{% block body %}{{ explored(data, "rows") }}{% endblock %}'
    )
    return table.render(data=data), values


def test_a_table_of_ten_thousand_rows_is_searched_filtered_and_sorted(browser, tmp_path):
    text, values = many_rows(10_000)
    (tmp_path / "page.html").write_text(text)
    page, said, _ = opened(browser, tmp_path / "page.html", 390)
    page.wait_for_selector(".explore[data-rows='10000']")
    rows = page.locator("tbody tr")
    # Few of them are drawn at once, whatever there are: 10,000 rows are there as soon as a hundred.
    # The reason of a row without a result is below it, as its column is not shown.
    assert page.locator("tr.reason").all_inner_texts() == ["it has no atoms"]
    assert rows.count() == 101 and rows.first.locator("td").first.inner_text() == EVIL
    heading = page.locator("thead th", has_text="seconds").locator("button")
    heading.click()
    heading.click()
    assert page.locator("tr.reason").count() == 0  # It has the least seconds.
    drawn = [float(each) for each in page.locator("tbody tr td:nth-child(4)").all_inner_texts()]
    assert drawn == pytest.approx(values[::-1][:100], abs=0.1)
    page.select_option("label:has-text('status') select", "=error")
    assert rows.count() == 2 and "1 of 1 rows" in page.locator("output").inner_text()
    page.select_option("label:has-text('status') select", "")
    page.locator("input[type=search]").fill("s999")
    assert rows.count() == 11
    with page.expect_download() as saved:
        page.get_by_text("Save rows as CSV").click()
    kept = pd.read_csv(saved.value.path())
    assert len(kept) == 11 and [*kept] == ["structure", "method", "status", "seconds", "seed", "message"]
    assert page.locator(".histograms svg polyline").count() == 2
    ends = [float(each) for each in page.locator(".histograms svg text").all_text_contents()[:2]]
    assert ends == pytest.approx([kept["seconds"].min(), kept["seconds"].max()], rel=6e-3)
    assert (
        page.locator(".histograms svg").first.get_attribute("aria-label").startswith("Histogram of seconds")
    )
    assert said == []


def test_the_page_of_modes_moves(browser, tmp_path):
    from fixtures.command_line import run
    from fixtures.samples import STRUCTURES

    assert run("modes", STRUCTURES / "ala10.pdb", "-o", tmp_path / "out", "--modes", "3") == 0
    page, said, _ = opened(browser, tmp_path / "out" / "report.html")
    page.wait_for_selector("#modes-viewer[data-mode='1'] canvas")
    first = picture(page, "#modes-viewer")
    assert np.mean(np.abs(first - first[5, 5]).max(axis=-1) > 0.1) > 0.002
    until(lambda: not np.array_equal(first, picture(page, "#modes-viewer")))
    page.select_option("#mode", "3")
    page.wait_for_selector("#modes-viewer[data-mode='3']")
    assert said == []
