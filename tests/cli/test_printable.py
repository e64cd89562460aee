"""Names and titles may hold codes that would drive a terminal: they are never printed."""

import gc
import io
import re
import sys

import pytest
from fixtures.samples import STRUCTURES, load
from rich.table import Table

import protochain as pc
from protochain.batches.batch_structures import BatchProgress
from protochain.cli import main, terminal
from protochain.cli.printable import Printable, printable, printer

CODES = "\x1b]0;owned\x07\x1b[2J\r\x9b31m\u202e\x7f"
"""A title for the terminal, an erased screen, a line written over, a C1 code, writing to the left, DEL."""
NAME = f"[b]{CODES}.cif"
VACUUM = ("--solvent", "vacuum", "--threads", 1)


def odd(text):
    """Characters of an output that are not to be seen."""
    return {each for each in text if not each.isprintable() and each != "\n"}


@pytest.fixture(scope="module", autouse=True)
def usual_collection():
    """Commands of this file collect garbage after a million objects, and the worker of the tests must not."""
    yield
    assert gc.get_threshold() == (700, 10, 10), "the next files of this worker would collect no garbage"


@pytest.fixture
def source(tmp_path, monkeypatch):
    """A structure with codes in its file's name, its title, the name of its molecule and that of a chain."""
    monkeypatch.chdir(tmp_path)
    title = CODES.replace("\r", "")
    text = pc.structure.write.as_text(load("ala10.pdb"), ".cif").replace(
        "_entity.id A", f"_struct.title '{title}'\n_entity.id A\n_entity.pdbx_description '{title}'"
    )
    path = tmp_path / NAME
    path.write_text(text)
    return path


COMMANDS = [
    ("info",), ("rmsd", STRUCTURES / "ala10.pdb"), ("minimise", *VACUUM, "-o", "-"),
    ("relax", *VACUUM, "--max-iterations", 2), ("simulate", *VACUUM, "--no-relax", "--steps", 2, "-o", "run"),
    ("compare", *VACUUM, "--methods", "lbfgs", "--max-evaluations", 5, "-o", f"to{CODES}"),
    ("batch", "--dry-run"),
]  # fmt: skip
REFUSED = [
    ("rmsd", f"{CODES}.pdb"), ("info", "--chains", f"{CODES}"), (CODES,), ("info", f"--{CODES}"),
]  # fmt: skip


@pytest.mark.filterwarnings("ignore:Glyph:UserWarning")  # Of a plot's title.
@pytest.mark.parametrize("arguments", [*COMMANDS, *REFUSED])
def test_no_command_prints_a_control_character(arguments, source, monkeypatch, capsys):
    command, *others = arguments
    monkeypatch.setattr(sys, "argv", ["protochain", command, source.name, *map(str, others)])
    with pytest.raises(SystemExit) as ended:
        main()
    told = capsys.readouterr()
    assert told.out + told.err and not odd(told.out) and not odd(told.err)
    assert (ended.value.code == 2) == (arguments in REFUSED), told.err


@pytest.mark.parametrize("column", ["auth_asym_id", "label_comp_id", "label_atom_id"])
def test_names_with_control_characters_are_refused(column, source, monkeypatch, capsys):
    given = {"auth_asym_id": " A ", "label_comp_id": " ALA ", "label_atom_id": " CA "}[column]
    name = f" {given.strip()}\x1b[31m "
    text = source.read_text().replace(given, name)
    assert name in text
    source.write_text(text)
    monkeypatch.setattr(sys, "argv", ["protochain", "info", source.name])
    with pytest.raises(SystemExit) as ended:
        main()
    said = capsys.readouterr()
    assert ended.value.code == 2 and not said.out and not odd(said.err) and said.err.count("\n") == 1
    assert re.search(r"\.cif: line \d+: column \d+ holds a control character; correct it\n", said.err)


def test_titles_are_kept_without_control_characters(source, tmp_path):
    for suffix in (".pdb", ".cif"):
        pc.save(pc.load(source), tmp_path / f"out{suffix}")
        text = (tmp_path / f"out{suffix}").read_text()
        assert not odd(text) and "owned?" in text.lower()


def test_what_is_printable_is_printed_as_it_is():
    plain = "C\u03b1 \u00c5 \u2026 \t tab\nline \u4e2d"
    assert printable(plain) == plain
    assert printable(f"a{CODES}\ud800") == ("a\\x1b]0;owned\\x07\\x1b[2J\\r\\x9b31m\\u202e\\x7f\\ud800")
    written = io.StringIO()
    stream = Printable(written)
    assert stream.write("\x1b\n") == 2
    stream.writelines(["a", "\x07"])
    assert written.getvalue() == "\\x1b\na\\x07" and not stream.isatty()


class Terminal(io.StringIO):
    def isatty(self):
        return True


def test_tables_and_bars_have_their_own_codes_and_no_others(monkeypatch):
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.setenv("COLUMNS", "200")
    screen = Terminal()
    monkeypatch.setattr(sys, "stderr", Printable(screen))
    console = printer(stderr=True)
    table = Table("file", title=CODES)
    table.add_row(CODES)
    console.print(table)
    console.print(CODES, style="bold", highlight=False)
    with terminal.batch_progress() as watch:
        watch(BatchProgress(2, 1, 0, 0, 1.0, "", f"line {CODES}"))
        print(f"beside {CODES}", file=sys.stderr)
    with terminal.simulation_progress(f"[b]{CODES}[/x]", 2, 0.001) as watch:
        watch({"step": 1, "time_ps": 0.1, "temperature_k": 1.0}, None)
    shown = screen.getvalue()
    assert "\x1b[1m" in shown and shown.count("\\x1b]0;owned\\x07") >= 3
    # The bar's own are as they should be.
    assert "[b]" in shown and not re.search(r"\\x1b(?!\]0|\[2)", shown)
    assert (
        not {"\x07", "\x9b", "\u202e", "\x7f"} & {*shown} and "\x1b]0" not in shown and "\x1b[2J" not in shown
    )
