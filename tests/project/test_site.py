"""The site: it is built without a warning, holds every public name, and is read on a phone."""

import ast
import re
import subprocess
import sys
from importlib import import_module

import looks
import pytest
from fixtures.public_names import PUBLIC
from fixtures.samples import ROOT

InventoryFile = pytest.importorskip("sphinx.util.inventory").InventoryFile


def test_a_package_of_the_reference_lists_its_names():
    """Without a build, so that the fast tests notice it: a package without them ends the build."""
    tree = ast.parse((ROOT / "analysis/site/conf.py").read_text())
    named = {ast.unparse(node.targets[0]): node.value for node in tree.body if isinstance(node, ast.Assign)}
    for package in ast.literal_eval(named["PACKAGES"]):
        assert import_module(f"protochain.{package}").__all__, package


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """Folder of the site: of warnings, such as a link to nothing, none passes."""
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "analysis/site/build.py", str(folder)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return folder


@pytest.mark.slow
def test_the_reference_holds_every_public_name(site):
    inventory = InventoryFile.loads((site / "objects.inv").read_bytes(), uri="")
    shown = {name for kind, entries in inventory.data.items() if kind.startswith("py:") for name in entries}
    # A name of two packages is on the page of the first.
    assert {name.rpartition(".")[2] for name in PUBLIC} <= {name.rpartition(".")[2] for name in shown}
    assert {name for name in PUBLIC if name.count(".") == 1} <= shown


@pytest.mark.slow
def test_pages_name_no_place_of_this_machine_and_no_markup(site):
    pages = list(site.rglob("*.html"))
    assert len(pages) > 50
    for page in pages:
        text = page.read_text(encoding="utf-8")
        assert str(ROOT) not in text, page
        assert ":func:" not in text and ":class:" not in text, page


@pytest.mark.slow
def test_no_page_is_wider_than_a_phone_and_all_are_dark_where_one_asks(site, browser):
    page = browser.new_page(viewport={"width": 390, "height": 300})
    for path in (site / "analysis").rglob("*.html"):
        page.goto(path.as_uri())
        assert page.evaluate("document.documentElement.scrollWidth") <= 390, path
        for scheme in ("light", "dark"):
            page.emulate_media(color_scheme=scheme)
            ground = page.evaluate("getComputedStyle(document.body).backgroundColor")
            darkest, *_, lightest = sorted(map(int, re.findall(r"\d+", ground)[:3]))
            assert lightest < 64 if scheme == "dark" else darkest > 192, path


@pytest.mark.slow
def test_pages_pass_the_audit(site, browser):
    """Nothing overlaps or is cut, contrast, roles, one heading and one main; axe-core if it is installed."""
    page, axe = (
        browser.new_page(viewport={"width": 390, "height": 900}, color_scheme="dark"),
        looks.axe_source(),
    )
    for path in site.rglob("*.html"):
        if 'http-equiv="refresh"' not in path.read_text(encoding="utf-8"):
            page.goto(path.as_uri())
            assert looks.audited(page, axe=axe) == [], path


@pytest.mark.slow
def test_options_do_not_break_at_their_hyphens(site):
    page = (site / "analysis/docs/commands.html").read_text(encoding="utf-8")
    assert '<span class="option">--help</span>' in page and "white-space: nowrap" in (
        site / "_static/site.css"
    ).read_text(encoding="utf-8")
