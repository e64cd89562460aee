"""How many files of the package a call enters: with fewer, it can be read from top to bottom."""

import sys
from collections import Counter
from pathlib import Path

import pytest
from fixtures.samples import STRUCTURES

import protochain as pc

PACKAGE = str(Path(pc.__file__).parent)


def entered(call):
    """Files of the package whose functions a call enters, and its returns from one of them to another."""
    files, returns = Counter(), 0

    def look(frame, event, _):
        nonlocal returns
        name, caller = frame.f_code.co_filename, frame.f_back
        if not name.startswith(PACKAGE) or event not in ("call", "return"):
            return
        files[name] += event == "call"
        before = caller.f_code.co_filename if caller else name
        returns += event == "return" and before != name and before.startswith(PACKAGE)

    sys.setprofile(look)
    try:
        call()
    finally:
        sys.setprofile(None)
    return len(files), returns


@pytest.mark.parametrize(
    ("call", "most_files", "most_returns"),
    [
        # Of 38 files and 3259 returns, on 29 November 2026.
        (lambda path: pc.load(path), 30, 1400),
        # Of 97 files and 4125 returns.
        (lambda path: pc.relax(path, threads=1), 87, 2400),
    ],
    ids=["load", "relax"],
)
def test_a_call_enters_few_files(call, most_files, most_returns):
    path = STRUCTURES / "1l2y.pdb"
    call(path)  # What is cached, as templates and kernels, is made by the first call.
    files, returns = entered(lambda: call(path))
    assert (files <= most_files, returns <= most_returns) == (True, True), (files, returns)
