"""Pages: self-contained HTML from the templates of the package, which work offline."""

from functools import cache
from pathlib import Path
from typing import Any

from jinja2 import ChoiceLoader, Environment, PackageLoader

from protochain.core.storage import write_text
from protochain.results.columns import heading


def render(template: str, /, **variables: Any) -> str:
    """Fill a template of the package; what comes from files is escaped."""
    return templates().get_template(template).render(**variables)


def write_page(path: Path, template: str, /, **variables: Any) -> None:
    """Write a page, filled from a template."""
    write_text(path, render(template, **variables))


def write_scan(path: Path, title: str, text: str, figure: Any, table: Any) -> None:
    """Write the page of a scan: what it is, its figure, and all its points."""
    from protochain.results.figures import data_url
    from protochain.results.provenance import of_run

    run = of_run("openmm", "gemmi", "numpy", "scipy", "numba", "pandas")
    write_page(path, "scan.html", title=title, text=text, figure=data_url(figure), table=table, run=run)


@cache
def templates(*packages: str) -> Environment:
    """Templates of this package, and before them those of others."""
    loaders = [PackageLoader(name) for name in (*packages, "protochain.results")]
    pages = Environment(loader=ChoiceLoader(loaders), autoescape=True)
    pages.filters["heading"] = heading
    return pages
