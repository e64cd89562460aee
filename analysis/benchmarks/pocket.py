"""Picture of README: the pocket of a ligand before and after `protochain relax`, with clashes and measures.

    python analysis/benchmarks/pocket.py STRUCTURE -o DIR

Relaxes the structure and writes relaxation.webp, drawn by the viewer of the pages in Chromium. Shown is the
ligand with the most clashes, with the residues near it. A disc lies between two atoms that clash (overlap by
0.4 angstrom or more), and is as wide as the overlap.
"""

import argparse
import io
import json
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import made
import numpy as np

import protochain as pc
from protochain.core.palette import COLOURS
from protochain.relaxation.record import before_and_after
from protochain.results.viewer import library, pockets
from protochain.structure.write import as_text
from protochain.validation import clashes

FLAGS = (
    "--no-sandbox", "--disable-dev-shm-usage", "--use-gl=angle", "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
)  # fmt: skip
PAGE = """<meta charset="utf-8"><style>
body {{ margin: 0; width: 1600px;
  font: 19px/1.3 "Liberation Sans", Arial, sans-serif; color: #262626;
  background: #fff; display: flex; }}
figure {{ margin: 0; width: 560px; position: relative; }}
.box {{ width: 560px; height: 510px; position: relative; }}
figcaption, caption {{ font-weight: bold; font-size: 22px; padding: 14px 0 6px 20px; text-align: left; }}
small {{ font-weight: normal; font-size: 18px; }} aside {{ width: 460px; padding-right: 20px; }}
table {{ border-collapse: collapse; width: 100%; }} caption {{ padding-left: 8px; }}
td, th {{ padding: 8px; border-bottom: 1px solid #d6d6d6; text-align: right; white-space: nowrap; }}
td:first-child {{ text-align: left; white-space: normal; }}
i {{ display: inline-block; width: .8em; height: .8em;
  border-radius: 50%; vertical-align: -.05em; }}
p {{ margin: 10px 8px; font-size: 17px; }}
</style>{figures}<aside><table><caption>protochain relax</caption>
<tr><th></th><th>before</th><th>after</th></tr>{rows}</table>
<p><i style="background:{ligand}"></i> ligand {name} &emsp; <i style="background:#8b97a3"></i> pocket &emsp;
<i style="background:{clash}"></i> clash</p></aside><script>{library}</script>"""
DRAW = """([id, text, pocket, discs, labels, ligand, clash, at]) => {
  const viewer = $3Dmol.createViewer(id, { backgroundColor: "white", antialias: true });
  const model = viewer.addModel(text, "pdb");
  const map = (C) => ({ ...$3Dmol.elementColors.defaultColors, C });
  const carbons = (colour) => ({ colorscheme: { prop: "elem", map: map(colour) } });
  model.setStyle({}, {});
  model.setStyle({ or: pocket.near }, { stick: { ...carbons("#8b97a3"), radius: 0.1 } });
  model.setStyle({ or: pocket.ligand }, { stick: { ...carbons(ligand), radius: 0.2 } });
  for (const [start, end, radius] of discs)
    viewer.addCylinder({ start, end, radius, color: clash, fromCap: 1, toCap: 1 });
  for (const [words, position] of labels)
    viewer.addLabel(words, { position, fontSize: 15, fontColor: "#262626", backgroundColor: "white",
      backgroundOpacity: 0.6, borderThickness: 0, inFront: true, padding: 1 });
  if (at) viewer.setView(at);
  else { viewer.zoomTo({ or: [...pocket.ligand, ...pocket.near] }); viewer.zoom(1.1); }
  viewer.render();
  return viewer.getView();
}"""


def discs(start: pc.Structure, x: np.ndarray, shown: np.ndarray) -> tuple[list[Any], list[int]]:
    """Discs of the clashes of the shown atoms with others, and the residues of these clashes."""
    found = clashes(start, x)
    pairs = found.pairs[shown[found.pairs].all(axis=1)]
    overlaps = found.overlap_angstrom[shown[found.pairs].all(axis=1)]
    drawn = []
    for (i, j), overlap in zip(pairs, overlaps, strict=True):
        middle, across = 5.0 * (x[i] + x[j]), x[j] - x[i]
        half = 0.04 * across / np.linalg.norm(across)
        ends = ({"x": p[0], "y": p[1], "z": p[2]} for p in (middle - half, middle + half))
        drawn.append([*ends, 0.4 + 0.7 * float(overlap)])
    return drawn, np.unique(start.atom_residue[pairs]).tolist()


def draw(
    start: pc.Structure, ends: Sequence[np.ndarray], rows: Sequence[Sequence[str]], page: Any, target: Path
) -> None:
    """Write one picture of the pocket at both ends, and of the rows of measures."""
    keys = np.array([f"{c}:{n}" for c, n in zip(start.residue_chain, start.residue_number, strict=True)])
    pocket, shown, worst = None, np.zeros(start.n_atoms, bool), -1
    for each in pockets(start, np.empty((0, 2), dtype=np.int64), *ends):
        of = [np.isin(keys, [f"{s['chain']}:{s['resi']}" for s in each[part]]) for part in ("ligand", "near")]
        atoms = (of[0] | of[1])[start.atom_residue]
        count = len(discs(start, ends[0], atoms)[0])
        if count > worst:
            pocket, shown, worst, is_ligand = each, atoms, count, of[0]
    drawn = [discs(start, x, shown) for x in ends]
    named = [r for r in drawn[0][1] if not is_ligand[r]]
    figures = "".join(
        f"<figure><figcaption>{state} <small>{len(each[0])} clashes in the pocket</small></figcaption>"
        f'<div class="box" id="{state}"></div></figure>'
        for state, each in zip(("before", "after"), drawn, strict=True)
    )
    cells = "".join(f"<tr>{''.join(f'<td>{cell}</td>' for cell in row)}</tr>" for row in rows)
    ligand, clash = COLOURS[0], COLOURS[1]
    page.set_content(
        PAGE.format(
            figures=figures, rows=cells, ligand=ligand, clash=clash, library=library(), name=pocket["name"]
        )
    )
    view = None
    for state, x, (flat, _) in zip(("before", "after"), ends, drawn, strict=True):
        labels = [
            [str(start.residue(r)), dict(zip("xyz", (10.0 * x[at]).tolist(), strict=True))]
            for at in start.alpha_carbons
            if (r := int(start.atom_residue[at])) in named
        ]
        text = as_text(start.with_positions(x), ".pdb", hydrogens=True)
        words = json.loads(
            json.dumps([state, text, pocket, flat, labels, ligand, clash, view], default=float)
        )
        view = page.evaluate(DRAW, words)
    page.wait_for_timeout(2000)
    from PIL import Image

    picture = Image.open(io.BytesIO(page.screenshot(full_page=True))).convert("RGB")
    picture.save(target, quality=88, method=6)


def parser() -> argparse.ArgumentParser:
    options = made.parser(__doc__ or "")
    options.add_argument("structure", type=Path, metavar="STRUCTURE")
    return options


def main() -> None:
    from playwright.sync_api import sync_playwright

    options = parser().parse_args()
    relaxation = pc.relax(options.structure)
    ends = (relaxation.start.positions, relaxation.x)
    chromium = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    options.output.mkdir(parents=True, exist_ok=True)
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=chromium, args=FLAGS)
        page = browser.new_page(viewport={"width": 1600, "height": 570})
        page.set_default_timeout(600_000)  # Software rendering on a busy machine takes minutes.
        target = options.output / "relaxation.webp"
        draw(relaxation.start, ends, before_and_after(relaxation.record()), page, target)
        browser.close()


if __name__ == "__main__":
    main()
