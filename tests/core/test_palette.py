"""Colours of methods: distinct to the colour-blind, seen on white and on dark, the same on every page."""

import itertools

import numpy as np
import pytest

from protochain.core import defaults
from protochain.core.palette import COLOURS, looks
from protochain.minimisers.recipes import RECIPES

SEEN = {
    "by all": np.eye(3),
    "protan": [[0.152286, 1.052583, -0.204868],
        [0.114503, 0.786281, 0.099216],
        [-0.003882, -0.048116, 1.051998]],
    "deutan": [[0.367322, 0.860646, -0.227968],
        [0.280085, 0.672501, 0.047413],
        [-0.011820, 0.042940, 0.968881]],
    "tritan": [[1.255528, -0.076749, -0.178779],
        [-0.078411, 0.930809, 0.147602],
        [0.004733, 0.691367, 0.303900]],
}  # fmt: skip
"""Of linear RGB, from Machado, Oliveira, Fernandes, IEEE Trans. Vis. Comput. Graph. 15:1291 (2009)."""
XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])


def linear(colour):
    c = np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)]) / 255
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)


def lab(rgb):
    x, y, z = np.cbrt(XYZ @ np.clip(rgb, 0.0, 1.0) / XYZ.sum(axis=1))
    return np.array([116 * y - 16, 500 * (x - y), 200 * (y - z)])


@pytest.mark.parametrize("eyes", SEEN)
def test_no_two_colours_look_alike(eyes):
    seen = [lab(SEEN[eyes] @ linear(colour)) for colour in COLOURS]
    assert min(np.linalg.norm(a - b) for a, b in itertools.combinations(seen, 2)) > 10.0


def test_colours_stand_out_from_white_as_from_dark_ground():
    """WCAG 1.4.11: 3:1 on white; 2.5:1 on the dark ground of viewers."""
    for colour in COLOURS:
        luminance = XYZ[1] @ linear(colour)
        assert 1.05 / (luminance + 0.05) > 3.0 and (luminance + 0.05) / (0.011 + 0.05) > 2.5, colour


def test_a_method_looks_the_same_whatever_is_beside_it():
    alone = {name: looks([name])[name] for name in ("lbfgs", "kcm", "hybrid", "cartesian", "openmm")}
    together = looks(["mine", *reversed(alone), "yours"])
    assert {name: together[name] for name in alone} == alone
    assert len({look.colour for look in together.values()}) == len(together)


@pytest.mark.parametrize(
    "methods",
    [defaults.COMPARED, ("kcm-stiffness", "lbfgs"), *itertools.combinations(RECIPES, 2), tuple(RECIPES)[-7:]],
    ids="-".join,
)
def test_methods_of_a_page_have_different_colours(methods):
    assert len({look.colour for look in looks(methods).values()}) == len(methods)


def test_the_order_of_methods_does_not_change_their_colours():
    assert looks(reversed(defaults.COMPARED)) == looks(defaults.COMPARED)


def test_many_names_differ_in_colour_or_dashes():
    many = looks(map(str, range(25)))
    assert len({(look.colour, str(look.dash)) for look in many.values()}) == 25


def test_a_new_method_takes_no_colour_of_the_first_ones():
    """The first seven have the colours in order, on every page, alone and together."""
    first = ("lbfgs", "kcm", "openmm", "hybrid", "cartesian", "openmm-md", "newton")
    assert [looks([name])[name].colour for name in first] == [*COLOURS]
    second = ("fire", "md", "kcm-adaptive")
    assert [looks([name])[name].colour for name in second] == [*COLOURS[:3]]
