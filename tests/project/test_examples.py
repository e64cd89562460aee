"""Examples of docstrings: each runs as it stands, where structures/ lies, and prints what it says."""

import doctest
import inspect

import numpy as np
import pytest
from fixtures.public_names import PUBLIC
from fixtures.samples import STRUCTURES

import protochain as pc

EXAMPLES = {
    name: found
    for name, value in {id(value): (name, value) for name, value in sorted(PUBLIC.items())}.values()
    if (found := doctest.DocTestParser().get_examples(inspect.getdoc(value) or ""))
}


def test_fifty_names_have_examples():
    assert len(EXAMPLES) >= 50


@pytest.mark.parametrize("name", EXAMPLES)
def test_it_runs_and_prints_what_it_says(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "structures").symlink_to(STRUCTURES)
    known = {"pc": pc, "np": np, name.rpartition(".")[2]: PUBLIC[name]}
    test = doctest.DocTest(EXAMPLES[name], known, name, None, 0, "")
    printed = []
    assert doctest.DocTestRunner().run(test, out=printed.append).failed == 0, "".join(printed)
