"""One style of all figures, whatever a user's settings are, and legends that lie on no data."""

import re

import matplotlib
import numpy as np
import pandas as pd
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.text import Text

from protochain.comparison.plots import plot_energy
from protochain.core.figure import INK, LIGHT_INK, Figure, image
from protochain.core.palette import COLOURS
from protochain.results.figures import data_url, outside, panels

TRACES = pd.DataFrame(
    [
        {"method": method, "evaluations": k, "seconds": 0.1 * k, "energy_kj_mol": low + 100.0 / k}
        for method, low in (("lbfgs", -10.0), ("kcm", 0.0), ("cartesian", -500.0))
        for k in range(1, 40)
    ]
)
GROUPS = {"torsions only": ["lbfgs", "kcm"], "all atoms free": ["cartesian"]}


@pytest.fixture(params=[1, 3], ids=["one panel", "three panels"])
def figure(request):
    drawn, axes = panels(None, request.param, (7, 3))
    for ax in axes:
        for name in ("lbfgs", "kcm-stiffness", "cartesian"):
            ax.plot([1, 2, 3], [1, len(name), 2], label=name)
        ax.set(title="finding", xlabel="seconds", ylabel="energy, kJ/mol")
    outside(axes)
    return drawn


def test_texts_have_eight_points_whatever_the_settings_of_the_user(figure):
    with matplotlib.rc_context({"font.size": 20.0, "axes.titlesize": 30.0, "xtick.labelsize": 25.0}):
        FigureCanvasAgg(figure).draw()
        assert matplotlib.rcParams["font.size"] == 20.0
    texts = [text for text in figure.findobj(Text) if text.get_text()]
    assert texts and {text.get_fontsize() for text in texts} == {8.0}
    assert {ax.lines[0].get_color() for ax in figure.axes} == {COLOURS[0]}


def test_a_legend_lies_on_no_data(figure):
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    (legend,) = [*figure.legends, *(ax.get_legend() for ax in figure.axes if ax.get_legend())]
    box = legend.get_window_extent(canvas.get_renderer())
    assert not any(box.overlaps(ax.get_window_extent()) for ax in figure.axes)
    assert figure.bbox.x1 + 1 > box.x1 and box.y0 > -1


def test_an_svg_has_no_ground_and_text_that_follows_a_dark_page(figure):
    svg = image(figure, "svg").decode()
    assert "prefers-color-scheme: dark" in svg and LIGHT_INK in svg and "#ffffff" not in svg
    drawn = svg.split("</style>", 1)[1]
    assert INK in drawn and not re.search(r"(?:fill|stroke): #0{6}", drawn)
    assert data_url(figure).startswith("data:image/svg+xml;base64,")


def test_a_large_drawing_is_a_png_in_a_page():
    drawn, (ax,) = panels(None, 1, (4, 3))
    for _ in range(40):
        ax.plot(np.random.default_rng(0).normal(size=500))
    assert data_url(drawn).startswith("data:image/png;base64,")


def test_energies_of_torsions_and_of_all_atoms_share_no_axis():
    axes = plot_energy(TRACES, GROUPS, "a").axes
    drawn = [{line.get_label() for line in ax.lines} for ax in axes]
    assert drawn == [{"lbfgs", "kcm"}] * 2 + [{"cartesian"}] * 2
    assert axes[0].get_title("left") == "a, torsions only: lbfgs ends lowest, at -7.4 kJ/mol"
    assert isinstance(axes[0].figure, Figure)
