"""Screenshots of every kind of page at two widths, light and dark, and what is wrong with them.

    python analysis/looks.py DIR [NAME...]

makes the pages in DIR by the commands below, leaves those there already as they are, and writes
``DIR/looks/NAME-WIDTH-SCHEME.png`` by Chromium. It ends with status 1 if a page fails the audit.
"""

import argparse
import os
import shlex
import subprocess
import sys
from collections.abc import Iterator
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
    "scan": "scan 1l2y.pdb 'phi A:7=-180:150:30' -o out.csv --report page.html",
    "simulate": "simulate ala10.pdb -o out --steps 2000 --every 50",
    "frames": "relax models.pdb --frames all --workers 1 -o frames.pdb --report page.html",
    "batch": "batch ala10.pdb 1l2y.pdb 3i40.pdb -o out --methods lbfgs,kcm --max-evaluations 40 --workers 1",
    "relaxed": "relax ala10.pdb 1l2y.pdb -o out --workers 1",
}  # fmt: skip
"""Commands that write pages; files without a folder are of ``structures/``, or made by ``prepared``."""
WIDTHS, SCHEMES = (1300, 390), ("light", "dark")

AUDIT = r"""() => {
  const found = new Set();
  const wide = document.documentElement.scrollWidth - innerWidth;
  if (wide > 0) found.add(`scrolls to the side by ${wide} px`);
  const luminance = ([r, g, b]) => [r, g, b].map((v) => v / 255)
    .map((v) => v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4)
    .reduce((sum, v, k) => sum + v * [0.2126, 0.7152, 0.0722][k], 0);
  const canvas = document.createElement("canvas").getContext("2d", { willReadFrequently: true });
  const rgba = (colour) => {
    canvas.clearRect(0, 0, 1, 1); canvas.fillStyle = colour; canvas.fillRect(0, 0, 1, 1);
    return [...canvas.getImageData(0, 0, 1, 1).data];
  };
  const ground = (element) => {
    for (let each = element; each; each = each.parentElement) {
      const colour = rgba(getComputedStyle(each).backgroundColor);
      if (colour[3] > 127) return colour;
    }
    return rgba("Canvas");
  };
  const words = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  for (let text = words.nextNode(); text; text = words.nextNode()) {
    const of = text.parentElement, style = getComputedStyle(of), said = text.textContent.trim().slice(0, 40);
    const silent = ["SCRIPT", "STYLE", "NOSCRIPT", "OPTION"].includes(of.tagName);
    if (!said || silent || !of.checkVisibility()) continue;
    const [a, b] = [luminance(rgba(style.color)), luminance(ground(of))].sort((x, y) => y - x);
    const least = parseFloat(style.fontSize) >= 24 ? 3 : 4.5, ratio = (a + 0.05) / (b + 0.05);
    if (ratio < least) found.add(`contrast ${ratio.toFixed(1)} of "${said}"`);
    for (let each = of; each !== document.documentElement; each = each.parentElement) {
      const cut = getComputedStyle(each).overflowX === "hidden" && each.scrollWidth > each.clientWidth + 1;
      if (cut && !each.closest("#viewer, .viewer")) found.add(`cut: "${said}"`);
    }
  }
  for (const each of document.querySelectorAll("img")) if (!each.alt) found.add("image without words");
  for (const each of document.querySelectorAll("input, select, button")) {
    const labels = [...(each.labels || [])].map((label) => label.textContent).join("");
    const name = each.getAttribute("aria-label") || each.textContent || labels;
    if (!name.trim()) found.add(`nameless ${each.tagName}`);
  }
  const ids = [...document.querySelectorAll("[id]")].map((each) => each.id);
  for (const id of ids.filter((each, k) => ids.indexOf(each) !== k)) found.add(`two of id ${id}`);
  if (!document.documentElement.lang) found.add("no language");
  if (!document.title.trim()) found.add("no title");
  if (document.querySelectorAll("h1").length !== 1) found.add("not one h1");
  for (const table of document.querySelectorAll("table")) {
    if (!table.querySelector("th")) found.add("table without headings");
    const over = table.getBoundingClientRect().width > innerWidth;
    if (over && !table.closest(".scroll")) found.add("table over the edge");
  }
  return [...found];
}"""
"""What a program can tell of a page: WCAG 2.1 contrast AA, names of controls and images, one heading, nothing
cut or over the edge."""


def prepared(folder: Path) -> None:
    """Write what commands read and the repository does not have: two models, and a pose of acetate."""
    import numpy as np

    import protochain as pc

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

    def path(word: str) -> str:
        beside = word.rpartition(".")[2] in ("pdb", "sdf") and word not in ("out.pdb", "frames.pdb")
        return (
            str(next(each / word for each in (STRUCTURES, inputs) if (each / word).exists()))
            if beside
            else word
        )

    return [path(word) for word in shlex.split(PAGES[name])]


def pages_of(name: str, folder: Path, inputs: Path) -> list[Path]:
    """Pages of a kind, made where they are not there yet."""
    if not list(folder.rglob("*.html")):
        folder.mkdir(parents=True, exist_ok=True)
        command = [sys.executable, "-m", "protochain", *words_of(name, inputs)]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
        if done.returncode not in (0, 3):
            raise SystemExit(f"{shlex.join(command)}: {done.stderr}")
    return sorted(folder.rglob("*.html"), key=lambda page: (len(page.parts), page))[:2]


def looked_at(browser: Any, file: Path, picture: Path | None = None) -> Iterator[str]:
    """Complaints about a page at both widths, light and dark; its screenshots, if there is a place."""
    for width in WIDTHS:
        page = browser.new_page(viewport={"width": width, "height": 800})
        said: list[str] = []
        page.on("console", lambda message, said=said: said.append(message.text))
        page.on("pageerror", lambda error, said=said: said.append(str(error)))
        page.goto(file.as_uri())
        for scheme in SCHEMES:
            page.emulate_media(color_scheme=scheme)
            yield from (f"{width} px, {scheme}: {each}" for each in [*page.evaluate(AUDIT), *said])
            if picture:
                page.wait_for_timeout(500)
                page.screenshot(path=f"{picture}-{width}-{scheme}.png", full_page=True)
        page.close()


def main(folder: Path, names: list[str]) -> int:
    """Make the pages, look at them, and print what is wrong."""
    import shutil

    from playwright.sync_api import sync_playwright

    os.environ.setdefault("OPENMM_DEFAULT_PLATFORM", "CPU")
    (folder / "looks").mkdir(parents=True, exist_ok=True)
    if not (folder / "models.pdb").exists():
        prepared(folder)
    chromium = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    flags = ["--no-sandbox", "--disable-dev-shm-usage", "--use-gl=angle", "--use-angle=swiftshader",
             "--enable-unsafe-swiftshader"]  # fmt: skip
    wrong = 0
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=chromium, args=flags)
        for name in names or PAGES:
            for k, file in enumerate(pages_of(name, folder / name, folder)):
                for line in looked_at(browser, file, folder / "looks" / f"{name}{k or ''}"):
                    wrong += 1
                    print(f"{name}: {file.name}: {line}")
    return min(wrong, 1)


if __name__ == "__main__":
    own = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    own.add_argument("folder", type=Path, metavar="DIR")
    own.add_argument("names", nargs="*", metavar="NAME", choices=[*PAGES, []], help=", ".join(PAGES))
    asked = own.parse_args()
    raise SystemExit(main(asked.folder.resolve(), asked.names))
