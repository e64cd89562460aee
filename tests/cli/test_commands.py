"""The command line without its work: options, messages, exit statuses, and what a command asks for."""

import json
import re
import shlex
import signal
import sys
from importlib import metadata
from pathlib import Path

import pytest
import typer
from fixtures.command_line import refusal, run
from fixtures.refusals import expect_refusal
from fixtures.samples import STRUCTURES

from protochain.chains.setup import Setup
from protochain.cli import app, main, options
from protochain.core.errors import Argument, ProtochainError, WriteError


def test_every_option_has_a_help_and_a_name_of_its_own():
    """Defaults and fields are of the settings: tests/test_setup.py; what they do, tests/records."""
    commands = typer.main.get_command(app).commands
    assert [name for name, each in commands.items() if each.hidden] == ["minimize"]
    assert not app.pretty_exceptions_enable
    for name, command in commands.items():
        flags = [flag for each in command.params for flag in (*each.opts, *each.secondary_opts)]
        assert len({*flags}) == len(flags), name
        assert all(each.help and len(each.help) > 6 for each in command.params), name
        # A flag that cannot be turned off is off.
        assert not any(each.default is True and not each.secondary_opts for each in command.params), name


@pytest.mark.parametrize(
    ("raised", "status", "said"),
    [
        (ProtochainError("two\nlines"), 2, "protochain: two lines\n"),
        (
            ProtochainError(Argument("n_steps"), " 0: ", Argument("force", True)),
            2,
            "protochain: --steps 0: --force\n",
        ),
        (
            WriteError("a", "full", "b", Argument("resume", True)),
            1,
            "protochain: a: not written (full); saved: b; free space there, then --resume\n",
        ),
        (typer.BadParameter("odd"), 2, "protochain: Invalid value: odd. See protochain --help.\n"),
        (FileNotFoundError(2, "gone", "a.pdb"), 1, "protochain: a.pdb: gone\n"),
        (OSError("strange"), 1, "protochain: strange\n"),
        (KeyboardInterrupt(), 130, "protochain: interrupted before there was a result\n"),
        (130, 130, ""),
        (3, 3, ""),
        (None, 0, ""),
    ],
)
def test_every_end_has_a_status_and_at_most_a_line(raised, status, said, monkeypatch, capsys):
    seen = []

    def ends(standalone_mode):
        seen.append((standalone_mode, signal.getsignal(signal.SIGTERM), list(sys.argv)))
        if isinstance(raised, BaseException):
            raise raised
        return raised

    monkeypatch.setattr("protochain.cli.app", ends)
    monkeypatch.setattr(sys, "argv", ["protochain", "info"])
    before = signal.getsignal(signal.SIGTERM)
    try:
        with pytest.raises(SystemExit) as ended:
            main()
        assert seen == [(False, signal.default_int_handler, ["protochain", "info"])]
        sys.argv = ["protochain"]
        with pytest.raises(SystemExit):
            main()
    finally:
        signal.signal(signal.SIGTERM, before)
    assert ended.value.code == status and seen[1][2] == ["protochain", "--help"]
    assert capsys.readouterr().err == 2 * said


def test_the_version_is_that_of_the_package(capsys):
    assert run("--version") == 0 and run("--version", "info") == 0
    assert capsys.readouterr().out == 2 * f"protochain {metadata.version('protochain')}\n"


def test_options_make_a_setup():
    setup = lambda **given: options._build_settings(Setup, given)  # noqa: E731
    assert setup() == setup(keep=None, disulfide=[], ph=7.0) == Setup()
    assert setup(no_disulfide=True).disulfide == ("none",) and Setup().disulfide is None
    chosen = setup(
        disulfide=["A:-3-A:40, :5B-B:-1", "A:7-A:8"], keep="water,ZN", threads=2, altloc="", chains="A, b"
    )
    bonds = ("A:-3", "A:40"), (":5B", "B:-1"), ("A:7", "A:8")
    assert (chosen.disulfide, chosen.keep, chosen.threads) == (bonds, ("water", "ZN"), 2)
    assert chosen.chains == ("A", "b") and Setup().keep == ("near",)
    only = setup(no_disulfide=True, disulfide=["A:3-A:40"]).disulfide
    assert only == ("none", ("A:3", "A:40")) == setup(disulfide=["none", "A:3-A:40"]).disulfide
    with expect_refusal("disulfide", "disulfide", match='disulfide="none"'):
        Setup(disulfide=())


@pytest.mark.parametrize(
    ("source", "stem", "suffix"),
    [
        ("in/a.b.pdb", "a.b", ".pdb"), ("a.CIF", "a", ".cif"), ("a.mmcif.GZ", "a", ".cif"),
        ("a.ent.gz", "a", ".pdb"),
        ("x.cif.xz", "x", ".cif"), ("model.v2.pdb.bz2", "model.v2", ".pdb"), ("x.pdbx", "x", ".cif"),
        ("-", "stdin", ".pdb"), ("a", "a", ".pdb"), ("a.gz", "a", ".pdb"),
    ],
)  # fmt: skip
def test_outputs_are_named_after_the_input(source, stem, suffix):
    assert options.named_after(Path(source)) == (stem, suffix)


def test_outputs_are_neither_the_input_nor_one_another(tmp_path):
    source, other = tmp_path / "in.pdb", tmp_path / "out.pdb"
    check = options.check_outputs
    check([source], [source], force=False)
    source.write_text("")
    check([source], [other, tmp_path / "b"], force=False)
    check([source], [source], force=True)
    other.write_text("")
    check([source], [other], force=False)
    (tmp_path / "link.pdb").symlink_to(source)
    for outputs, force, why in (
        ([source], False, f"{source}: is the input. Give another name, or --force to replace it"),
        ([tmp_path / "link.pdb"], None, f"{tmp_path}/link.pdb: is the input. Give another name"),
        ([other, other], True, f"{other}: is given for two outputs. Give each a separate name"),
        ([source / "x"], True, f"{source}/x: in.pdb is not a folder; give another name"),
    ):
        with pytest.raises(ProtochainError) as refused:
            check([tmp_path / "c", source], outputs, force=force)
        assert str(refused.value) == why


READ = {
    "minimise": {"source": "{0}", "resume": "--resume {0}", "forcefield": "--forcefield amber14,{0}"},
    "relax": {"inputs": "{0}", "manifest": "--manifest {0}", "forcefield": "--forcefield amber14,{0}"},
    "compare": {"source": "{0}", "reference": "--reference {0}", "forcefield": "--forcefield amber14,{0}"},
    "batch": {"inputs": "{0}", "manifest": "--manifest {0}", "forcefield": "--forcefield amber14,{0}"},
    "simulate": {"source": "{0}", "forcefield": "--forcefield amber14,{0}"},
    "search": {"source": "{0}", "forcefield": "--forcefield amber14,{0}"},
    "mutate": {"source": "{0} --scan A:1", "forcefield": "--scan A:1 --forcefield amber14,{0}"},
    "scan": {"source": "{0} phi@A:3=-60", "forcefield": "phi@A:3=-60 --forcefield amber14,{0}"},
    "modes": {"source": "{0}", "to": "--to {0}", "forcefield": "--forcefield amber14,{0}"},
    "validate": {"inputs": "{0}", "reference": "--reference {0}"},
    "score": {
        "inputs": "{0}",
        "forcefield": "--forcefield amber14,{0}",
        "reference": "--reference {0}",
    },
    "ensemble": {"source": "{0}", "forcefield": "--forcefield amber14,{0}"},
    "energy": {"source": "{0}", "forcefield": "--forcefield amber14,{0}"},
    "rmsd": {"reference": "{0} b.pdb", "models": "b.pdb {0}"},
    "info": {"source": "{0}", "forcefield": "--forcefield amber14,{0}"},
}
"""Options and arguments that name what a command reads, and how they are given."""

RESTRAINTS = "--restraint-csv {0} --restraints 'distance A:1:CA A:5:CA 5 6'"
PROTEINS = f"--protein-out {{0}} --ligand-poses {STRUCTURES / '1MEH_MOA.sdf'}"
WRITTEN = {
    "minimise": {
        "output": ("-o {0}", "a.pdb"), "checkpoint": ("--checkpoint {0}", "a.npz"),
        "trace": ("--trace {0}", "a.csv"), "trajectory": ("--trajectory {0}", "a.dcd"),
        "report": ("--report {0}", "a.html"), "restraint_csv": (RESTRAINTS, "a.csv"),
    },
    "relax": {
        "output": ("-o {0}", "a.pdb"), "report": ("--report {0}", "a.html"),
        "restraint_csv": (RESTRAINTS, "a.csv"), "protein_out": (PROTEINS, "a.pdb"),
    },
    "compare": {"output": ("--force -o d", "d/in.kcm.pdb", "d/in.start.cif", "d/summary.csv")},
    "batch": {"output": ("-o d", "d/summary.csv", "d/traces.csv", "d/report.html")},
    "simulate": {"output": ("--force -o d", "d/last.pdb", "d/log.csv", "d/trajectory.dcd")},
    "search": {"output": ("--force -o d", "d/summary.json", "d/report.html")},
    "mutate": {"output": ("-o {0}", "a.csv"), "report": ("--report {0}", "a.html")},
    "scan": {"output": ("-o {0}", "a.csv"), "report": ("--report {0}", "a.html")},
    "modes": {"output": ("-o d", "d/modes.csv", "d/minimum.pdb", "d/mode-1.dcd", "d/report.html")},
    "validate": {
        "csv": ("--csv {0}", "a.csv"), "residues": ("--residues {0}", "a.csv"),
        "changes": ("--changes {0}", "a.csv"), "report": ("--report {0}", "a.html"),
    },
    "score": {
        "csv": ("--csv {0}", "a.csv"), "residues": ("--residues {0}", "a.csv"),
        "report": ("--report {0}", "a.html"),
    },
    "ensemble": {
        "output": ("-o {0}", "a.pdb"), "csv": ("--csv {0}", "a.csv"), "residues": ("--residues {0}", "a.csv"),
    },
    "energy": {"output": ("-o {0}", "a.csv"), "report": ("--report {0}", "a.html")},
    "rmsd": {"output": ("-o {0}", "a.csv")},
    "build": {"output": ("-o {0}", "a.pdb")},
}  # fmt: skip
"""Options that name what a command writes, how they are given, and files that come of it."""


def test_all_that_is_read_and_written_is_known():
    """Options are told by their help: a new one must be added above, where it is tried."""
    for name, command in typer.main.get_command(app).commands.items():
        named = {
            p.name
            for p in command.params
            if (p.help or "").startswith(("File", "CSV", "DCD", "Page", "Folder", "PDB", "Structure"))
        }
        named |= {
            p.name
            for p in command.params
            if p.name in ("output", "forcefield", "inputs", "source", "models", "reference")
        }
        if not command.hidden:
            known = READ.get(name, {}).keys() | WRITTEN.get(name, {}).keys()
            assert named - known <= {"sequence"}, name


@pytest.mark.parametrize(
    ("command", "read", "written", "file"),
    [
        (command, read, written, file)
        for command in WRITTEN
        for read in READ.get(command, ())
        for written, (_, *files) in WRITTEN[command].items()
        for file in files
        # Ends are named after the input.
        if (command, read) != ("compare", "source") or Path(file).stem in ("summary", "report")
        # Of a manifest, the output is a folder: tests/cli/test_relax_command.py.
        if (command, read) != ("relax", "manifest")
    ],
)
def test_no_output_of_any_command_is_an_input(command, read, written, file, tmp_path, monkeypatch):
    """A reference, a manifest, a checkpoint or a force field was replaced without a word."""
    monkeypatch.chdir(tmp_path)
    for name in ("in.pdb", "b.pdb", file):
        Path(name).parent.mkdir(exist_ok=True)
        Path(name).write_text("path\nin.pdb\n")
    Path("link").symlink_to(file)
    for given in (file, "link"):
        asked = READ[command][read].format(given)
        # All have a structure beside the input that is in danger.
        lacks = not {"source", "inputs", "models", "reference"} & {read} or (command, read) in (
            ("compare", "reference"), ("validate", "reference"), ("score", "reference"),
        )  # fmt: skip
        said = refusal(
            command,
            *(["in.pdb"] * lacks),
            *asked.split(),
            *shlex.split(WRITTEN[command][written][0].format(file)),
        )
        assert (
            "is the input" in said or "is inside the output folder" in said or "contains a batch" in said
        ), said
        assert Path(file).read_text() == "path\nin.pdb\n"


@pytest.mark.parametrize("command", ["validate", "score", "energy", "rmsd"])
def test_files_that_are_written_are_named(command, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    asked = [STRUCTURES / "3i40.pdb"] * (2 if command == "rmsd" else 1)
    asked += ["--reference", asked[0]] * (command == "validate")
    asked += ["--solvent", "vacuum"] * (command in ("score", "energy"))
    files = []
    for name, (option, *ends) in WRITTEN[command].items():
        files.append(f"{name}{Path(ends[0]).suffix}")
        asked += option.format(files[-1]).split()
    for as_json in (False, True):
        assert run(command, *asked, *["--json"] * as_json) in (None, 0)
        said = capsys.readouterr().out
        named = json.loads(said)["files"] if as_json else re.findall("^written: (.*)$", said, re.MULTILINE)
        assert named == files and {*files} == {each.name for each in tmp_path.iterdir()}
        for file in files:
            Path(file).unlink()
