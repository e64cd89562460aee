"""Picture of README: the pocket of a ligand before and after `protochain relax`, with the table of the page.

    python analysis/benchmarks/pocket.py STRUCTURE -o DIR

Writes relaxation.png from the page of the run (``--report``), by Chromium.
"""

import argparse
import base64
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import made

FLAGS = (
    "--no-sandbox", "--disable-dev-shm-usage", "--use-gl=angle", "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
)  # fmt: skip
LAYOUT = """<meta charset="utf-8"><style>
body {{ margin: 0 20px; width: 1560px; font: 20px sans-serif; background: white; color: black; }}
figure {{ display: inline-block; margin: 0; width: 780px; }}
figcaption {{ font-weight: bold; padding: 8px 0; }}
img {{ width: 780px; display: block; }} table {{ border-collapse: collapse; margin: 0 auto 20px; }}
th, td {{ padding: 4px 24px; border-bottom: 1px solid #ccc; text-align: right; }}
th:first-child, td:first-child {{ text-align: left; }} caption {{ display: none; }}
</style>{views}{table}"""


def draw(page: Any, file: Path, target: Path) -> None:
    """Write one picture of both states of the pocket, and of the first table of a page."""
    page.goto(file.as_uri())
    page.wait_for_selector("#pocket-viewer canvas")
    box = "document.querySelector('#pocket-viewer').style.cssText = 'width: 780px; height: 560px'"
    page.evaluate(f"{box}; dispatchEvent(new Event('resize'))")
    views = []
    for state, shown in (("before", {0}), ("after", {1, 2})):
        for index in range(3):
            page.set_checked(f"#pocket-shown input[value='{index}']", index in shown)
        page.wait_for_timeout(500)
        picture = base64.b64encode(page.locator("#pocket-viewer").screenshot()).decode()
        views.append(
            f'<figure><figcaption>{state}</figcaption><img src="data:image/png;base64,{picture}"></figure>'
        )
    table = page.locator("table").first.evaluate("table => table.outerHTML")
    page.set_content(LAYOUT.format(views="".join(views), table=table))
    page.screenshot(path=target, full_page=True)


def parser() -> argparse.ArgumentParser:
    options = made.parser(__doc__ or "")
    options.add_argument("structure", type=Path, metavar="STRUCTURE")
    return options


def main() -> None:
    from playwright.sync_api import sync_playwright

    options = parser().parse_args()
    chromium = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    with tempfile.TemporaryDirectory() as scratch, sync_playwright() as driver:
        file = Path(scratch) / "page.html"
        words = ["relax", str(options.structure.resolve()), "-o", "relaxed.pdb", "--report", str(file)]
        subprocess.run([sys.executable, "-m", "protochain", *words], cwd=scratch, check=True)
        browser = driver.chromium.launch(executable_path=chromium, args=FLAGS)
        options.output.mkdir(parents=True, exist_ok=True)
        page = browser.new_page(viewport={"width": 1600, "height": 900})
        page.set_default_timeout(600_000)  # Software rendering on a busy machine takes minutes.
        draw(page, file, options.output / "relaxation.png")
        browser.close()


if __name__ == "__main__":
    main()
