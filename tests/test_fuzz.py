"""Files that were damaged: each is a Structure or a StructureError that names the file, and soon."""

import random
import string
from time import perf_counter

import numpy as np
import pytest
from conftest import MORE_STRUCTURES, STRUCTURES
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import protochain as pc
from protochain.structure.read import read

SOURCES = ("1l2y.pdb", "1ejg.pdb", "3i40.pdb", "1ubq.cif", "ala10.pdb")
LONGEST_SECONDS = 10.0


def taken_or_refused(path, data):
    """Check a file's reading, and the preparation of what was read."""
    path.write_bytes(data)
    began = perf_counter()
    try:
        s = pc.load(path)
    except pc.ProtochainError as error:
        assert str(path) in str(error) and "\n" not in str(error), str(error)
    else:
        assert np.isfinite(s.positions).all() and s.n_residues >= 2
        assert len(s.atom_name) == s.n_atoms == len(s.b_factor)
    assert perf_counter() - began < LONGEST_SECONDS


def cut(lines, rng):
    text = "\n".join(lines)
    return text[: rng.randrange(len(text))].split("\n")


def shuffled(lines, rng):
    start = rng.randrange(len(lines))
    block = lines[start : start + rng.choice((5, 50, 5000))]
    rng.shuffle(block)
    return [*lines[:start], *block, *lines[start + len(block) :]]


def duplicated(lines, rng):
    start = rng.randrange(len(lines))
    block = lines[start : start + rng.choice((1, 20, 200))]
    place = rng.randrange(len(lines))
    return [*lines[:place], *block, *lines[place:]]


def dropped(lines, rng):
    return [line for line in lines if rng.random() > 0.05]


def wrong_numbers(lines, rng):
    def spoil(line):
        if rng.random() > 0.02 or len(line) < 30:
            return line
        start = rng.choice((6, 22, 30, 38, 46, 54, 60))
        return (
            line[:start]
            + rng.choice(("  nan   ", "1e30    ", "********", "-9999999", "12,34   "))
            + line[start + 8 :]
        )

    return [spoil(line) for line in lines]


def moved(lines, rng):
    """Atoms somewhere else, or all in one place."""

    def spoil(line):
        if line[:4] != "ATOM" or rng.random() > 0.03:
            return line
        x = (0.0, 0.0, 0.0) if rng.random() < 0.5 else [rng.uniform(-999, 999) for _ in range(3)]
        return f"{line[:30]}{x[0]:8.3f}{x[1]:8.3f}{x[2]:8.3f}{line[54:]}"

    return [spoil(line) for line in lines]


def characters(lines, rng):
    letters = string.printable + "\0\xff\u2028é"
    text = list("\n".join(lines))
    for _ in range(rng.choice((1, 20, 400))):
        text[rng.randrange(len(text))] = rng.choice(letters)
    return "".join(text).split("\n")


def huge_fields(lines, rng):
    lines = list(lines)
    lines[rng.randrange(len(lines))] += rng.choice(string.ascii_letters) * rng.choice((100, 100_000))
    return lines


def renamed(lines, rng):
    names = (
        "XYZ",
        "MSE",
        "HYP",
        "DAL",
        "ACE",
        "NME",
        "NH2",
        "HID",
        "DA ",
        "HOH",
        "ZN ",
        "   ",
        "SEP",
        "UNK",
        "GLY",
        "PRO",
    )
    old = {line[17:20] for line in lines if line[:4] == "ATOM"}
    if not old:
        return lines
    one, new = rng.choice(sorted(old)), rng.choice(names)
    return [
        line[:17] + new + line[20:] if line[17:20] == one and rng.random() < 0.3 else line for line in lines
    ]


def columns(lines, rng):
    by = rng.choice((-1, 1, 2))
    return [line[:12] + " " * by + line[12:] if by > 0 else line[:12] + line[13:] for line in lines]


DAMAGE = (cut, shuffled, duplicated, dropped, wrong_numbers, moved, characters, huge_fields, renamed, columns)


def damaged(seed):
    rng = random.Random(seed)
    name = rng.choice(SOURCES)
    lines = (STRUCTURES / name).read_text().splitlines()
    for damage in rng.sample(DAMAGE, rng.choice((1, 1, 2, 3))):
        lines = damage(lines, rng) or [""]
    return name, "\n".join(lines).encode("utf-8", "replace")


@pytest.mark.parametrize("seed", range(60))
def test_damaged_files(seed, tmp_path):
    name, data = damaged(seed)
    taken_or_refused(tmp_path / f"damaged-{name}", data)


@pytest.mark.slow
@pytest.mark.parametrize("block", range(40))
def test_many_damaged_files(block, tmp_path):
    for seed in range(1000 + 50 * block, 1050 + 50 * block):
        name, data = damaged(seed)
        taken_or_refused(tmp_path / f"damaged-{seed}-{name}", data)


@pytest.mark.slow
@pytest.mark.skipif(not MORE_STRUCTURES.exists(), reason="the larger collection is not here")
def test_real_entries_cut_anywhere_are_read_or_refused(tmp_path):
    rng = random.Random(0)
    for path in sorted(MORE_STRUCTURES.glob("*.[pc][di][bf]")):
        data = path.read_bytes()
        if len(data) < 300_000:
            for _ in range(4):
                target = tmp_path / path.name
                target.write_bytes(data[: rng.randrange(len(data))])
                try:
                    read(target)
                except pc.ProtochainError as error:
                    assert str(target) in str(error)


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


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(lines=st.lists(record, max_size=60))
def test_made_up_records(lines, tmp_path):
    taken_or_refused(tmp_path / "made-up.pdb", "\n".join([*lines, "END"]).encode())


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    data=st.one_of(
        st.binary(max_size=500), st.text(max_size=500).map(lambda text: text.encode("utf-8", "replace"))
    )
)
def test_made_up_bytes(data, tmp_path):
    taken_or_refused(tmp_path / "made-up.cif", data)
