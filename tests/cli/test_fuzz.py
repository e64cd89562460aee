"""Damaged files and odd options: work that is whole, or a refusal in one line that names the file."""

import os
import signal
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import protochain as pc
from bench.files import judge
from bench.files.damage import BESIDE, FILES, FILES_BY_WEIGHT, OPTIONS, Case, beside
from protochain.core.processors import processors

ANY_MACHINE = settings(
    max_examples=60,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)


def taken_or_refused(path, data):
    """Check a file's reading, and the preparation of what was read."""
    path.write_bytes(data)
    try:
        s = pc.load(path)
    except pc.ProtochainError as error:
        assert str(path) in str(error) and "\n" not in str(error), str(error)
    else:
        assert np.isfinite(s.positions).all() and s.n_residues >= 2
        assert len(s.atom_name) == s.n_atoms == len(s.b_factor)


def says(*lines):
    print(*lines, sep="\n", file=sys.stderr)


def refuses(*lines):
    says(*lines)
    sys.exit(2)


def writes(name, text="ATOM", status=0):
    Path(name).write_text(text)
    sys.exit(status)


def computes_for_ever():
    while True:
        pass


def works():
    says("in/ala10.pdb: atoms renamed")
    pc.save(pc.load("in/ala10.pdb"), "out.pdb")
    print('{"n_atoms": 103}')


REFUSAL = "protochain: in/ala10.pdb: no atoms found"
PLANTED = {
    "none, it works": (works, []),
    "none, it refuses": (lambda: refuses("in/ala10.pdb: atoms renamed", REFUSAL), []),
    "a traceback": (lambda: 1 / 0, ["status 70", "traceback"]),
    "no memory": (lambda: refuses("protochain: in/ala10.pdb: MemoryError"), ["memory"]),
    # Not SIGUSR1: compilers of OpenCL that an earlier test loaded catch it.
    "a signal": (lambda: os.kill(os.getpid(), signal.SIGALRM), [f"signal {signal.SIGALRM:d}"]),
    "no end": (computes_for_ever, ["time"]),
    "an odd status": (lambda: sys.exit(5), ["status 5"]),
    "two refusals": (lambda: refuses(REFUSAL, REFUSAL), ["2 lines of refusal"]),
    "no word": (lambda: refuses(), ["0 lines of refusal"]),
    "a line of its own": (lambda: refuses("Dask says", REFUSAL), ["other lines"]),
    "no name": (lambda: refuses("protochain: no atoms found"), ["file not named"]),
    "a long line": (lambda: refuses(REFUSAL + "x" * 2000), ["long line"]),
    "a warning": (lambda: (print("{}"), says("a.py:1: RuntimeWarning: divide by zero")), ["warning"]),
    "a letter that moves the cursor": (lambda: refuses(f"{REFUSAL} \x1b[31m"), ["control characters"]),
    "NaN": (lambda: print('{"a": [NaN]}'), ["invalid JSON"]),
    "no JSON": (lambda: print("written"), ["invalid JSON"]),
    "half a file": (lambda: (Path("out.pdb").write_text("AT"), refuses(REFUSAL)), ["left: out.pdb"]),
    "a temporary file": (lambda: (print("{}"), writes("tmpabc")), ["temporary file left: tmpabc"]),
    "an input changed": (
        lambda: (print("{}"), writes(BESIDE[0])),
        ["input changed: in/ala10.pdb", "not read again: in/ala10.pdb"],
    ),
    "an input gone": (lambda: (Path(BESIDE[0]).unlink(), refuses(REFUSAL)), ["input changed: in/ala10.pdb"]),
    "a file that is none": (lambda: (print("{}"), writes("out.pdb")), ["not read again: out.pdb"]),
    "fewer atoms than it says": (
        lambda: (pc.save(pc.load(BESIDE[0]), "out.cif"), print('{"n_atoms": 104}')),
        ["not read again: out.cif"],
    ),
}  # fmt: skip


@pytest.mark.parametrize(("call", "expected"), PLANTED.values(), ids=PLANTED)
def test_the_judge_notices_each_fault_and_no_other(call, expected, tmp_path):
    case = Case("planted", 0, ("minimise", BESIDE[0], "-o", "out.pdb", "--json"), beside(), BESIDE[:1])
    seconds = 1 if call is computes_for_ever else judge.SECONDS
    end = judge.ran(case, tmp_path, lambda words: call(), seconds)
    found = [*judge.faults(case, end), *judge.unread(case, end, tmp_path)]
    assert [fault for fault in found if not any(fault.startswith(each) for each in expected)] == []
    assert len(found) == len(expected)


def test_cases_are_shared_out_by_weight():
    cases = judge.chosen({"a": 1.0, "b": 2.0, "c": 0.5}, 100)
    assert len(cases) == len(set(cases)) == 100
    assert [sum(kind == each for kind, _ in cases) for each in "abc"] == [29, 57, 14]


def test_damaged_files_and_odd_options():
    """One of each kind that needs no processes of its own."""
    kinds = [kind for kind in (*FILES, *OPTIONS) if kind not in ("batches, to go on with", "compare")]
    ended = list(judge.outcomes([(kind, 1000) for kind in kinds], jobs=1))
    assert [each for each in ended if each.faults] == []
    assert len({each.status for each in ended} & {0, 2, 3}) == 3


@pytest.mark.slow
def test_many_damaged_files_and_odd_options():
    """Cases that no table counts: `analysis/bench fuzz` begins at 0."""
    cases = judge.chosen(FILES_BY_WEIGHT, 600) + judge.chosen(OPTIONS, 200)
    ended = judge.outcomes([(kind, 5000 + seed) for kind, seed in cases], jobs=processors())
    # In one each atom has another residue's name: what its bonds kept has none in the file that is written.
    known = {("PDB, residues renamed", 5005): ("not read again: out.cif: ['ValueError: 89 atoms of 96']",)}
    faulty = {(each.kind, each.seed): each.faults for each in ended if each.faults}
    assert faulty == known


record = st.builds(
    lambda *parts: "".join(parts),
    st.sampled_from(
        ["ATOM  ", "HETATM", "TER   ", "MODEL ", "ENDMDL", "SSBOND", "LINK  ", "atom  ", "ANISOU"]
    ),
    st.integers(-99, 99999).map(lambda n: f"{n:5d}"),
    st.sampled_from([" N  ", " CA ", " C  ", " O  ", " CB ", "HA  ", "1HB ", " SG ", "ZN  "]).map(
        lambda n: f" {n}"
    ),
    st.sampled_from([" ", "A", "B"]),
    st.sampled_from(["ALA", "GLY", "CYS", "HIS", "PRO", "MSE", "HOH", "ACE", "NME"]),
    st.sampled_from([" A", " B", "  "]),
    st.integers(-9, 12).map(lambda n: f"{n:4d}"),
    st.sampled_from([" ", "A"]),
    st.just("   "),
    st.lists(st.floats(-50, 50).map(lambda v: f"{v:8.3f}"), min_size=3, max_size=3).map("".join),
    st.sampled_from(["  1.00 10.00           N  ", "  0.00", "", "  1.00 10.00      SEG  XX1+"]),
)


@ANY_MACHINE
@given(lines=st.lists(record, max_size=60))
def test_made_up_records(lines, tmp_path):
    taken_or_refused(tmp_path / "made-up.pdb", "\n".join([*lines, "END"]).encode())


@ANY_MACHINE
@given(
    data=st.one_of(
        st.binary(max_size=500), st.text(max_size=500).map(lambda text: text.encode("utf-8", "replace"))
    )
)
def test_made_up_bytes(data, tmp_path):
    taken_or_refused(tmp_path / "made-up.cif", data)
