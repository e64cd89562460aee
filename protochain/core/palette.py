"""One look for each method in all figures and pages: colours safe for the colour-blind, lines, markers."""

from collections.abc import Iterable
from itertools import cycle, product
from typing import Any, NamedTuple

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#7444C8", "#5C6670", "#6E6A20")
"""Four of Okabe and Ito's, and three more, each 3:1 or better against white.

Seen by protanopes, deuteranopes and tritanopes no two are nearer than 10 in CIELAB.
"""
START = "#999999"
"""Colour of the start of a run."""
DASHES = ("solid", (0, (6, 2)), (0, (6, 2, 1.5, 2)), (0, (3, 1.5)))
MARKERS = "osD^vPX*<>"


class Look(NamedTuple):
    """How a method is drawn: colour, dashes as matplotlib and SVG have them, marker."""

    colour: str
    dash: Any
    marker: str

    def line(self, label: str) -> dict[str, Any]:
        """Keywords of ``Axes.plot``, with a few markers along the line."""
        return {
            "color": self.colour, "linestyle": self.dash, "label": label, "linewidth": 1.8,
            "marker": self.marker, "markevery": 0.2, "markersize": 4.5,
        }  # fmt: skip

    @property
    def svg(self) -> str:
        """Attributes of a line of an SVG."""
        dash = "" if self.dash == "solid" else f' stroke-dasharray="{" ".join(map(str, self.dash[1]))}"'
        return f'stroke="{self.colour}"{dash}'


_ALL = tuple(
    Look(COLOURS[k], dash, MARKERS[(k + 2 * turn) % len(MARKERS)])
    for (turn, dash), k in product(enumerate(DASHES), range(len(COLOURS)))
)
_KNOWN = (
    "lbfgs", "kcm", "openmm", "hybrid", "cartesian", "openmm-md", "newton", "fire", "md", "kcm-adaptive",
    "kcm-metric", "anneal", "quench", "kcm-transient", "kcm-stiffness", "kcm-armijo",
)  # fmt: skip
"""Known methods in order. Their number modulo that of the colours is the colour they prefer."""


def looks(names: Iterable[str]) -> dict[str, Look]:
    """Look of each name of a page or figure.

    As many names as there are colours have different colours. A known method has its preferred colour, if
    no known method before it has the same one.
    """
    names = tuple(dict.fromkeys(names))
    free, looks_of = list(_ALL), dict[str, Look]()
    known = [name for name in _KNOWN if name in names]
    for name in known:
        preferred = _ALL[_KNOWN.index(name) % len(COLOURS)]
        if preferred in free:
            free.remove(preferred)
            looks_of[name] = preferred
    remaining = cycle(free or _ALL)
    return {name: looks_of[name] if name in looks_of else next(remaining) for name in names}
