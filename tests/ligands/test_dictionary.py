"""One component of the Chemical Component Dictionary against biotite's own reading of all of them."""

import warnings
from importlib.metadata import version

import numpy as np
import pytest

from protochain.ligands import dictionary

biotite = pytest.importorskip("biotite.structure.info")

# With and without bonds, charges, ideal coordinates (HEM lacks some).
NAMES = ("ATP", "HEM", "ZN", "HOH", "MSE")


@pytest.mark.parametrize("name", NAMES)
def test_a_component_is_that_of_biotite(name):
    found = dictionary.component(name)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        theirs = biotite.residue(name)
    assert len(found) == len(theirs) > 0
    for kind in ("res_name", "atom_name", "element", "charge", "coord"):
        np.testing.assert_array_equal(getattr(found, kind), getattr(theirs, kind))
    np.testing.assert_array_equal(found.bonds.as_array(), theirs.bonds.as_array())


@pytest.mark.parametrize("name", ["", "NO SUCH", pytest.param("3UQ", id="without coordinates")])
def test_what_is_not_there_is_not_found(name):
    """And its error keeps nothing of the dictionary in memory."""
    if name == "3UQ" and not version("biotite").startswith("1."):
        pytest.skip("the dictionary of biotite 2 has coordinates of 3UQ")
    with pytest.raises(KeyError) as refused:
        dictionary.component(name)
    assert refused.traceback[-1].locals.keys() == {"name", "atoms"}
    assert dictionary.leaving(name) == dictionary.heavy_atoms(name) == frozenset()


def test_where_the_dictionary_lies_elsewhere_biotite_is_asked(monkeypatch, tmp_path, request):
    dictionary._decode.cache_clear()
    request.addfinalizer(dictionary._decode.cache_clear)
    monkeypatch.setattr(biotite, "__file__", str(tmp_path / "__init__.py"))
    asked = []
    monkeypatch.setattr(biotite, "residue", lambda name: asked.append(name) or "theirs")
    assert dictionary.component("ATP") == "theirs"
    assert asked == ["ATP"]
