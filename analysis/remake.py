"""Notebooks, run in full and stored with what they show.

    python analysis/remake.py [NAME ...] [-o DIR] [--list]

Each runs in a process of its own, some tens of seconds. It is written only if it reaches its end, in place or
to DIR. ``python analysis/bench all --only notebooks scenes`` also writes their rows in made.csv. Pictures are
stored in few colours. An interactive view is too large, so that only its name is stored. A stamp has a digest
of the notebook's code and of the files of a scene, without comments and docstrings. It also has the values of
the checks of a scene, with which a slow test compares those of today.
--list names the notebooks, and which have other outputs than their code asks for.
"""

import argparse
import ast
import base64
import hashlib
import io
import json
import os
import sys
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).resolve().parent
PATHS = {
    path.stem: path for kind in ("notebooks", "scenes") for path in sorted((FOLDER / kind).glob("*.ipynb"))
}
SCENES = FOLDER / "bench" / "scenes"
SECONDS = 600
"""For a cell."""
COLOURS = 64
MOST = 50_000
"""Bytes of a table; more is a view."""
ASKS = """\
import json
found = next(each for each in list(globals().values()) if type(each).__name__ == "Scene")
print(json.dumps([[check.name, check.value, check.bound, check.kind] for check in found.checks]))
"""
STAMP = "protochain"
"""Key of the stamp, in the metadata of a notebook."""


def sources(name: str) -> list[Path]:
    """Files of a scene; none of a notebook that is about no scene."""
    return sorted([*SCENES.glob(f"{name}.py"), *(SCENES / name).glob("*.py")])


def code_of(text: str) -> str:
    """Code without comments, layout and docstrings: what makes outputs."""
    tree = ast.parse("\n".join(line for line in text.splitlines() if not line.startswith("%")))
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        first = body[0] if isinstance(body, list) and body else None
        if isinstance(first, ast.Expr) and isinstance(getattr(first.value, "value", None), str):
            node.body = body[1:]  # type: ignore[attr-defined]  # of modules, classes and functions
    return ast.dump(tree)


def digest(notebook: dict[str, Any], name: str) -> str:
    """Of the code of a notebook and of its scene's own files, as a stamp has it."""
    cells = ["".join(cell["source"]) for cell in notebook["cells"] if cell["cell_type"] == "code"]
    texts = [*cells, *(path.read_text(encoding="utf-8") for path in sources(name))]
    return hashlib.sha256("\n".join(map(code_of, texts)).encode()).hexdigest()[:16]


def is_current(notebook: dict[str, Any], name: str) -> bool:
    """Whether the outputs are of the notebook's code and its scene's files."""
    return notebook["metadata"].get(STAMP, {}).get("code") == digest(notebook, name)


def plain(output: dict[str, Any]) -> dict[str, Any] | None:
    """An output as it is stored; None of what is said on the side, as that kernels are compiled."""
    if output["output_type"] == "stream":
        return output if output["name"] == "stdout" else None
    data = {
        kind: its
        for kind, its in output.get("data", {}).items()
        if len("".join(its)) <= MOST or "image" in kind
    }
    if "image/png" in data:
        from PIL import Image

        picture = Image.open(io.BytesIO(base64.b64decode(data["image/png"]))).convert("RGB")
        small = io.BytesIO()
        picture.quantize(COLOURS).save(small, "PNG", optimize=True)
        data = {"image/png": base64.b64encode(small.getvalue()).decode(), "text/plain": data["text/plain"]}
    return {**output, "data": data, "metadata": {}}


def remade(name: str) -> dict[str, Any]:
    """A notebook, run to its end, with outputs and stamp."""
    import nbclient
    import nbformat

    book = nbformat.read(PATHS[name], as_version=4)
    # What the last cell leaves behind, told by a cell that is not stored.
    if sources(name):
        book.cells.append(nbformat.v4.new_code_cell(ASKS))
    place = {"metadata": {"path": str(PATHS[name].parent)}}
    nbclient.NotebookClient(book, timeout=SECONDS, kernel_name="python3", resources=place).execute()
    done = json.loads(nbformat.writes(book))
    before = json.loads(PATHS[name].read_text(encoding="utf-8"))
    checks = []
    if len(done["cells"]) > len(before["cells"]):
        checks = json.loads("".join(done["cells"].pop()["outputs"][0]["text"]))
    count = 0
    for cell, ran in zip(before["cells"], done["cells"], strict=True):
        if cell["cell_type"] == "code":
            count += 1
            cell["execution_count"] = count
            cell["outputs"] = [kept for output in ran["outputs"] if (kept := plain(output))]
            for output in cell["outputs"]:
                if "execution_count" in output:
                    output["execution_count"] = count
    before["metadata"][STAMP] = {"code": digest(before, name), "checks": checks}
    return before


def written(notebook: dict[str, Any]) -> str:
    """Text of a notebook, as all are stored."""
    return json.dumps(notebook, indent=1, ensure_ascii=False) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help="by default all")
    parser.add_argument("-o", "--output", type=Path, metavar="DIR", help="folder [default: in place]")
    parser.add_argument("--list", action="store_true", help="say which are current, and stop")
    options = parser.parse_args()
    unknown = sorted(set(options.names) - PATHS.keys())
    if unknown:
        sys.exit(f"there is no notebook {unknown[0]}; there are {', '.join(PATHS)}")
    os.environ.pop("MPLBACKEND", None)  # another than a notebook's own draws nothing there
    failed = []
    for name in options.names or PATHS:
        path = PATHS[name]
        if options.list:
            notebook = json.loads(path.read_text(encoding="utf-8"))
            print(f"{name:<32} {'current' if is_current(notebook, name) else 'to be made again'}")
            continue
        try:
            text = written(remade(name))
        except Exception as error:  # whatever it is, the others go on
            failed.append(name)
            print(f"{name:<32} failed, and stays as it is: {error}", file=sys.stderr, flush=True)
            continue
        if options.output:
            options.output.mkdir(parents=True, exist_ok=True)
            path = options.output / path.name
        path.write_text(text, encoding="utf-8")
        print(f"{name:<32} {len(text) / 1e3:.0f} kB", flush=True)
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
