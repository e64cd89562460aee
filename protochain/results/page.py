"""Pages: self-contained HTML from the templates of the package, which work offline."""

from functools import cache
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader

from protochain.core.storage import write_text
from protochain.results.columns import heading


def render(template: str, /, **variables: Any) -> str:
    """Fill a template of the package; what comes from files is escaped."""
    return _templates().get_template(template).render(**variables)


def write_page(path: Path, template: str, /, **variables: Any) -> None:
    """Write a page, filled from a template."""
    write_text(path, render(template, **variables))


@cache
def _templates() -> Environment:
    pages = Environment(loader=PackageLoader("protochain.results"), autoescape=True)
    pages.filters["heading"] = heading
    return pages
