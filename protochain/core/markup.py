"""HTML of values in notebooks, numbers with a singular or plural noun, and shortened lists and texts."""

from collections.abc import Mapping, Sequence
from html import escape


def plural(n: int, noun: str, several: str = "") -> str:
    """Return a number and its noun: ``1 round``, ``2 rounds``, or an irregular plural."""
    return f"{n} {noun if n == 1 else several or noun + 's'}"


def excerpt(text: str) -> str:
    """Return text of a file for a message, cut to 100 letters."""
    return text if len(text) <= 100 else f"{text[:100]}..."


def abridge(places: Sequence[str], shown: int = 6) -> str:
    """The first of some places, and how many more there are."""
    remainder = f" and {len(places) - shown} more" if len(places) > shown else ""
    return ", ".join(places[:shown]) + remainder


def facts(title: str, rows: Mapping[str, object]) -> str:
    """Return a small HTML table of names and values, escaped: floats of four digits, a dash for None."""
    texts = {
        name: f"{value:.4g}" if isinstance(value, float) else "-" if value is None else str(value)
        for name, value in rows.items()
    }
    cells = "".join(
        f"<tr><th>{escape(name)}</th><td>{escape(text)}</td></tr>" for name, text in texts.items()
    )
    return f"<table><caption>{escape(title)}</caption>{cells}</table>"
