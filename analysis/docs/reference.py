"""The reference of all public names, from their docstrings, as pages to read offline.

    python analysis/docs/reference.py [-o DIR]

pdoc looks at what a module holds, and protochain imports its names when they are first used: here all of them
are, before pdoc looks.
"""

import argparse
from pathlib import Path

import pdoc

import protochain

PACKAGES = (
    "analysis",
    "batches",
    "dynamics",
    "energies",
    "lab",
    "ligands",
    "mechanisms",
    "minimisers",
    "mechanics",
    "relaxation",
    "results",
    "scenes",
    "structure",
    "validation",
)
SHADOWED = (
    "mechanics.multibody.random_tree",
    "validation.clashes",
    "validation.likeness",
    "validation.strain",
    "validation.violations",
)
"""Modules that share their name with a function of the package; the page is about the function."""
PAGES = (
    "protochain",
    *(f"protochain.{name}" for name in PACKAGES),
    *(f"!protochain.{name}" for name in SHADOWED),
)


def build(folder: Path) -> None:
    """Write ``index.html`` and a page a module."""
    for name in protochain.__all__:
        setattr(protochain, name, getattr(protochain, name))
    pdoc.render.configure(docformat="numpy", show_source=False)
    pdoc.pdoc(*PAGES, output_directory=folder)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, default=Path("reference"))
    folder = parser.parse_args().output
    build(folder)
    print(folder / "index.html")


if __name__ == "__main__":
    main()
