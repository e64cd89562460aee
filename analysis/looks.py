"""Screenshots of every kind of page at three widths, light, dark and printed, and an audit of each.

    python analysis/looks.py DIR [NAME...]
    python analysis/looks.py DIR --site SITE        also the pages of a built site
    python analysis/looks.py DIR --gallery FOLDER   small pictures of eight kinds of pages, as NAME-after.webp

makes the pages in DIR by the commands below, reuses those that are in DIR already, and writes
``DIR/looks/NAME-WIDTH-SCHEME.png`` by Chromium. It ends with status 1 if a page fails the audit. The audit
includes axe-core if the package axe-playwright-python is installed.
"""

import argparse
import os
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

STRUCTURES = Path(__file__).resolve().parents[1] / "structures"
PAGES = {
    "minimise": "minimise 1l2y.pdb -o out.pdb --max-evaluations 60 --report page.html",
    "compare": "compare 1l2y.pdb -o out --methods lbfgs,kcm,hybrid,cartesian --max-evaluations 100",
    "relax": "relax 1l2y.pdb -o out.pdb --report page.html",
    "ligand": "relax 1l2y.pdb --ligands pose.sdf -o out.pdb --report page.html",
    "energy": "energy 1l2y.pdb --report page.html",
    "score": "score 3i40.pdb --solvent vacuum --report page.html",
    "modes": "modes ala10.pdb -o out --modes 3",
    "search": "search AAAA -o out --evaluations 1500 --walkers 3 --workers 1",
    "tempering": "search AAA -o out --method tempering --evaluations 1500 --walkers 2 --workers 1",
    "scan": "scan 1l2y.pdb 'phi A:7=-180:150:30' -o out.csv --report page.html",
    "mutate": "mutate 5awl.pdb --scan A:2-9 --into AG -o scan.csv --report page.html",
    "simulate": "simulate ala10.pdb -o out --steps 2000 --every 50",
    "frames": "relax models.pdb --frames all --workers 1 -o frames.pdb --report page.html",
    "validate": "validate models.pdb --frames all --workers 1 --report page.html",
    "batch": "batch ala10.pdb 1l2y.pdb 3i40.pdb -o out --methods lbfgs,kcm --max-evaluations 40 --workers 1",
    "relaxed": "relax ala10.pdb 1l2y.pdb -o out --workers 1",
    "predicted": "relax 6bj9_model_0.cif.gz -o out.cif --report page.html",
}  # fmt: skip
"""Commands that write pages; files without a folder are of ``structures/``, or made by ``prepared``."""
GALLERY = "predicted", "minimise", "compare", "batch", "search", "simulate", "mutate", "score"
WIDTHS, SCHEMES = (1400, 768, 390), ("light", "dark")
PAPER = 718
"""Pixels between the margins of a printed page of A4."""
MOST_BYTES = 2_000_000
PATIENCE = 600_000
"""ms. A busy machine without a graphics card draws a large molecule in minutes."""
FLAGS = [
    "--no-sandbox", "--disable-dev-shm-usage", "--use-gl=angle", "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
]  # fmt: skip
"""Of Chromium without a display, a graphics card, or a user."""

AUDIT = (Path(__file__).parent / "looks.js").read_text(encoding="utf-8")
"""What a program can tell of a page: WCAG 2.1 contrast AA, names of controls and images, one heading, nothing
cut, over the edge, on other text or empty."""
DRAWN = "new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))"
"""Waits until a page is drawn: a frame later."""
AXE = """() => axe.run({ preload: false, resultTypes: ["violations"] }).then(({ violations }) => violations
  .filter(({ impact }) => ["serious", "critical"].includes(impact))
  .map(({ id, nodes }) => `axe: ${id}, ${nodes.length} times, as ${nodes[0].html.slice(0, 80)}`))"""


def prepared(folder: Path) -> None:
    """Write what commands read and the repository does not have: models, a pose, a mechanism's page."""
    import numpy as np

    import protochain as pc
    from protochain.mechanisms import Mechanism

    swing = Mechanism(gravity=(0, 0, -9.81))
    swing.body("bob", mass=1.0, com=(0, 0, -0.5), inertia=(1 / 12, 1 / 12, 0))
    swing.hinge("pin", parent="world", child="bob", axis=(0, 1, 0), q=0.5)
    (folder / "mechanism").mkdir(exist_ok=True)
    swing.build().simulate(until=2.0, time_step=0.02).view(folder / "mechanism" / "page.html")

    peptide = pc.load(STRUCTURES / "ala10.pdb")
    lines = []
    for model in range(8):
        x = peptide.positions + 0.004 * model * np.random.default_rng(model).normal(size=(peptide.n_atoms, 3))
        pc.save(peptide.with_positions(x), folder / "model.pdb")
        text = (folder / "model.pdb").read_text().splitlines()
        lines += [f"MODEL     {model + 1:4d}", *(each for each in text if each[:4] == "ATOM"), "ENDMDL"]
    (folder / "models.pdb").write_text("\n".join([*lines, "END", ""]))
    try:
        from rdkit import Chem
        from rdkit.Chem import AllChem
    except ImportError:
        return
    made = Chem.AddHs(Chem.MolFromSmiles("CC(=O)[O-]"))
    AllChem.EmbedMolecule(made, randomSeed=7)  # type: ignore[attr-defined]
    x = made.GetConformer().GetPositions()
    there = 10.0 * pc.load(STRUCTURES / "1l2y.pdb").positions
    x += [there[:, 0].max() + 3.0 - x[:, 0].min(), *(there.mean(0) - x.mean(0))[1:]]
    made.GetConformer().SetPositions(x)
    Chem.MolToMolFile(made, str(folder / "pose.sdf"))


def words_of(name: str, inputs: Path) -> list[str]:
    """Words of the command that makes a page, with the paths of its files."""
    words = shlex.split(PAGES[name])
    return [
        next((str(path) for path in (STRUCTURES / word, inputs / word) if path.is_file()), word)
        for word in words
    ]


def pages_of(name: str, folder: Path, inputs: Path) -> list[Path]:
    """Pages of a kind, made where they are not there yet."""
    if not list(folder.rglob("*.html")):
        folder.mkdir(parents=True, exist_ok=True)
        command = [sys.executable, "-m", "protochain", *words_of(name, inputs)]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
        if done.returncode not in (0, 3):
            raise SystemExit(f"{shlex.join(command)}: {done.stderr}")
    return sorted(folder.rglob("*.html"), key=lambda page: (len(page.parts), page))[:2]


def axe_source() -> str | None:
    """Source of axe-core, None if no package has it."""
    spec = find_spec("axe_playwright_python")
    place = spec and spec.submodule_search_locations
    return (Path(place[0]) / "axe.min.js").read_text(encoding="utf-8") if place else None


def audited(page: Any, printed: bool = False, axe: str | None = None) -> list[str]:
    """Complaints about an open page."""
    page.evaluate(DRAWN)
    lines: list[str] = page.evaluate(AUDIT, printed)
    if axe:
        page.evaluate(axe)
        lines += page.evaluate(AXE)
    return lines


def looked_at(
    browser: Any, file: Path, picture: Path | None = None, widths: Sequence[int] = WIDTHS
) -> Iterator[str]:
    """Complaints about a page at each width, light, dark and printed; its screenshots if there is a place."""
    axe = axe_source()
    if file.stat().st_size > MOST_BYTES:
        yield f"{file.stat().st_size} bytes"
    page = browser.new_page(viewport={"width": widths[0], "height": 900})
    page.set_default_timeout(PATIENCE)
    said: list[str] = []
    page.on("console", lambda message: said.append(message.text))
    page.on("pageerror", lambda error: said.append(str(error)))
    page.on("requestfailed", lambda request: said.append(f"asks for {request.url[:80]}"))
    page.goto(file.as_uri())
    for width in (*widths, PAPER):
        page.set_viewport_size({"width": width, "height": 900})
        for scheme in SCHEMES if width != PAPER else ("print",):
            if scheme == "print":  # Of a reader who likes dark pages; paper is light.
                page.emulate_media(media="print", color_scheme="dark")
            else:
                page.emulate_media(color_scheme=scheme)
            # Once with each scheme, once wide and once narrow: axe takes longer than all else.
            with_axe = axe if (width, scheme) in ((widths[0], "light"), (widths[-1], "dark")) else None
            complaints = audited(page, scheme == "print", with_axe)
            yield from (f"{width} px, {scheme}: {line}" for line in complaints)
            if picture:
                page.screenshot(path=f"{picture}-{width}-{scheme}.png", full_page=True)
    yield from said
    page.close()


def drawn(browser: Any, file: Path, picture: Path) -> None:
    """Write a small picture of a page for the gallery: its first screen, wide and narrow side by side."""
    import io

    from PIL import Image

    shots = []
    for width, height in ((1400, 1000), (390, 1000)):
        page = browser.new_page(viewport={"width": width, "height": height})
        page.set_default_timeout(PATIENCE)
        page.goto(file.as_uri())
        page.evaluate(DRAWN)
        shots.append(Image.open(io.BytesIO(page.screenshot())).convert("RGB"))
        page.close()
    sheet = Image.new("RGB", (sum(shot.width for shot in shots) + 40, 1000), "#8a949e")
    for shot, left in zip(shots, (0, shots[0].width + 40), strict=True):
        sheet.paste(shot, (left, 0))
    sheet.resize((1200, round(1000 * 1200 / sheet.width))).save(picture, quality=72, method=6)


def main(folder: Path, names: list[str], site: Path | None, gallery: Path | None, stage: str) -> int:
    """Make the pages, look at them, and print what is wrong."""
    from playwright.sync_api import sync_playwright

    os.environ.setdefault("OPENMM_DEFAULT_PLATFORM", "CPU")
    (folder / "looks").mkdir(parents=True, exist_ok=True)
    if not (folder / "models.pdb").exists():
        prepared(folder)
    chromium = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    wrong = 0
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=chromium, args=FLAGS)
        for name in names or (GALLERY if gallery else [*PAGES, "mechanism"]):
            for k, file in enumerate(pages_of(name, folder / name, folder)):
                if gallery:
                    if not k:
                        drawn(browser, file, gallery / f"{name}-{stage}.webp")
                    continue
                for line in looked_at(browser, file, folder / "looks" / f"{name}{k or ''}"):
                    wrong += 1
                    print(f"{name}: {file.name}: {line}", flush=True)
        for file in sorted(site.rglob("*.html")) if site else ():
            for line in looked_at(browser, file, widths=(1400, 390)):
                wrong += 1
                print(f"{file}: {line}", flush=True)
    return min(wrong, 1)


if __name__ == "__main__":
    own = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    own.add_argument("folder", type=Path, metavar="DIR")
    own.add_argument(
        "names", nargs="*", metavar="NAME", choices=[*PAGES, "mechanism", []], help=", ".join(PAGES)
    )
    own.add_argument("--site", type=Path, help="folder of a built site, whose pages are looked at, too")
    own.add_argument(
        "--gallery", type=Path, help="write pictures for the gallery in this folder, nothing else"
    )
    own.add_argument("--stage", default="after", help="end of the names of these pictures")
    asked = own.parse_args()
    raise SystemExit(main(asked.folder.resolve(), asked.names, asked.site, asked.gallery, asked.stage))
