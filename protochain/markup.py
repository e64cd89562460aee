"""How values show themselves in a notebook."""

from collections.abc import Mapping
from html import escape


def facts(title: str, rows: Mapping[str, object]) -> str:
    """Return a small HTML table.

    Parameters
    ----------
    title : str
    rows : mapping of str to object
        What to say and its value.

    Returns
    -------
    str
        Names from files are escaped.
    """
    cells = "".join(
        f"<tr><th>{escape(name)}</th><td>{escape(str(value))}</td></tr>" for name, value in rows.items()
    )
    return f"<table><caption>{escape(title)}</caption>{cells}</table>"
