"""Runs at the same time, outputs that are no plain files, files of strangers: the cases of reliability5."""

import errno
import fcntl
import os
import runpy
import signal
import subprocess
import sys
import threading
from pathlib import Path
from types import SimpleNamespace

import mdtraj
import pandas as pd
import pytest
from fixtures.samples import ROOT, STRUCTURES, chain, energy

import protochain as pc
from protochain.batches.naming import Earlier, NameRequest, assign_names
from protochain.batches.table import COLUMNS
from protochain.batches.table import _whole_lines as whole_lines
from protochain.core import interrupts, storage
from protochain.core.errors import MechanicsError, ProtochainError, WriteError, WriteWarning
from protochain.core.interrupts import held_interrupts, interrupt_on_signals
from protochain.core.storage import check_writable, claim_folder, claimed_files, temporary_stem, write_text
from protochain.mechanisms import Mechanism
from protochain.results.run_folder import csv_text

SAMPLE = STRUCTURES / "ala10.pdb"
MANIFEST = ROOT.parent / "shared" / "cases" / "reliability5" / "MANIFEST.tsv"
CASES = {
    "device_output.sh": "test_outputs_that_are_pipes_or_devices_are_refused_before_any_work",
    "simulate_resume_while_running.sh": "test_a_folder_of_a_running_simulation_is_refused",
    "validate_same_csv.sh": "test_a_table_that_another_run_writes_is_refused",
    "resume_deletes_files.sh": "test_resuming_a_batch_leaves_files_of_the_user_and_adds_no_rows",
    "long_name.sh": "test_names_of_up_to_255_bytes_are_written_and_longer_ones_refused",
    "not_utf8_resume.sh": "test_resuming_a_batch_leaves_files_of_the_user_and_adds_no_rows",
    "sighup.sh": "test_signals_that_end_a_run_give_the_best_so_far",
    "chmod_refused.sh": "test_files_are_written_although_permissions_cannot_be_changed",
    "mjcf.py": "test_mjcf_without_bound_is_refused",
    "pymol_plugin.py": "test_plugins_report_a_command_that_fails_in_one_line",
}


@pytest.fixture
def another_process(monkeypatch):
    """Locks of this process count as those of another one."""

    def other():
        monkeypatch.setattr(storage, "_LOCKS", set())

    return other


def test_every_case_of_the_manifest_has_a_test():
    if not MANIFEST.exists():
        pytest.skip("the shared cases are not here")
    names = {line.split("\t")[0] for line in MANIFEST.read_text().splitlines()[1:]}
    assert {name for name in names if name.endswith((".sh", ".py"))} == set(CASES)
    assert set(CASES.values()) <= set(globals())


# --- Runs at the same time


def test_a_folder_of_a_running_simulation_is_refused(tmp_path):
    c, e, refusals = chain("ala10.pdb"), energy("ala10.pdb"), []
    settings = {"n_steps": 60, "every": 2, "checkpoint_every": 5, "seed": 1, "output": tmp_path / "run"}

    def resume():
        try:
            pc.simulate(c, e, resume=True, **settings)
        except ProtochainError as error:
            refusals.append(str(error))

    def watch(row, x):
        if row["step"] == 40:
            thread = threading.Thread(target=resume)
            thread.start()
            thread.join()

    pc.simulate(c, e, watch=watch, **settings)
    assert refusals == [f"{tmp_path}/run: another simulation is writing to this folder; choose another"]
    topology = mdtraj.Topology.from_openmm(c.structure.topology)
    frames = mdtraj.load(str(tmp_path / "run/trajectory.dcd"), top=topology)
    assert frames.n_frames == len(pd.read_csv(tmp_path / "run/log.csv")) == 31
    assert not [path.name for path in (tmp_path / "run").iterdir() if path.name.startswith(".")]


@pytest.mark.parametrize(
    ("command", "output"),
    [
        ("simulate {} --steps 5 -o run", "run"), ("modes {} -o run", "run"),
        ("search GAG --evaluations 10 -o run", "run"),
        ("minimise {} -o m.pdb --trajectory t.dcd", "t.dcd"),
        ("relax {} --trajectory {} -o r.dcd", "r.dcd"),
        ("mutate {} --scan A:1 -o t.csv", "t.csv"),
    ],
)  # fmt: skip
def test_commands_refuse_outputs_of_other_runs(command, output, protochain, another_process):
    with claim_folder(Path(output), "run") if output == "run" else claimed_files(Path(output)):
        another_process()
        done = protochain(*command.replace("{}", str(SAMPLE)).split())
    assert done.returncode == 2 and f"{output}: another " in done.stderr and "is writing" in done.stderr
    assert not [path for path in Path().iterdir() if not path.is_dir()]


def test_a_table_that_another_run_writes_is_refused(protochain, another_process):
    Path("t.csv").write_text("rows of the other run\n")
    with claimed_files(Path("t.csv")):
        another_process()
        done = protochain("validate", SAMPLE, "--frames", "all", "--csv", "t.csv", "--workers", 1)
    assert (
        done.returncode == 2 and "t.csv: another run is writing this file; give another name" in done.stderr
    )
    assert Path("t.csv").read_text() == "rows of the other run\n"


def test_a_lock_ends_with_its_process_and_is_shared_inside_it(tmp_path):
    """Another process gets the folder as soon as this one has left it, and not before."""
    program = (
        f"from protochain.core.storage import *\nwith claim_folder(Path({str(tmp_path)!r}), 'run'): pass"
    )

    def other():
        return subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)

    with claim_folder(tmp_path, "run"):
        with claim_folder(tmp_path, "run"):
            pass
        assert "another run is writing" in other().stderr
    assert other().returncode == 0 and not list(tmp_path.iterdir())


@pytest.mark.parametrize("number", [errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP])
def test_where_there_are_no_locks_runs_go_on_and_report_it(number, tmp_path, monkeypatch):
    def no_locks(file, operation):
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(fcntl, "flock", no_locks)
    with (
        pytest.warns(WriteWarning, match="this file system has no locks"),
        claim_folder(tmp_path / "a", "run"),
    ):
        (tmp_path / "a" / "result").write_text("")
    with pytest.warns(WriteWarning, match="no locks"), claimed_files(tmp_path / "t.csv"):
        pass
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["a", "result"]


# --- Names of files


def test_resuming_a_batch_leaves_files_of_the_user_and_adds_no_rows(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("in").mkdir()
    for name in ("ala10.pdb", os.fsdecode(b"\xff.pdb")):
        (Path("in") / name).write_bytes(SAMPLE.read_bytes())
    settings = {"max_evaluations": 2, "workers": 1}
    pc.batch("in", "out", "lbfgs", **settings)
    (Path("out/.protochain-mine.part")).mkdir()
    own = [".notes.20260101.txt", ".a.abcdefgh.pdb", ".protochain-mine.part/x"]
    left = [f"{temporary_stem()}.part.png", f"pages/{temporary_stem()}.part"]
    for name in (*own, *left):
        (Path("out") / name).write_text("x")
    pc.batch("in", "out", "lbfgs", resume=True, **settings)
    assert len(pd.read_csv("out/summary.csv")) == 2
    assert [name for name in (*own, *left) if (Path("out") / name).exists()] == own


@pytest.mark.parametrize("name", ["../../evil", "a/../../evil", "/tmp/evil", "a\0b"])
@pytest.mark.parametrize("column", ["structure", "output"])
def test_rows_that_lead_out_of_the_folder_are_no_rows(name, column, tmp_path):
    row = {**dict.fromkeys(COLUMNS, ""), "structure": "a", "method": "kcm", "output": "a.kcm.pdb"}
    table = tmp_path / "summary.csv"
    table.write_text(csv_text(COLUMNS, [row, row | {column: name}], header=True))
    assert [(each["structure"], each["output"]) for each in whole_lines(table)] == [("a", "a.kcm.pdb")]


def test_a_name_that_is_not_utf8_is_found_in_the_table_again(tmp_path):
    path = tmp_path / os.fsdecode(b"a\xff.pdb")
    wanted = NameRequest(path, tmp_path, None, "k", ("kcm",))
    (name,) = assign_names([wanted])
    assert name.encode() == b"a\\udcff"
    row = Earlier(name, *wanted.source, "k", f"{name}.kcm.pdb")
    assert assign_names([wanted], [row]) == [name]


@pytest.mark.parametrize("ending", [".pdb", ".cif", ".pdb.gz"])
def test_names_of_up_to_255_bytes_are_written_and_longer_ones_refused(ending, tmp_path, protochain):
    structure = pc.load(SAMPLE)
    for length in (244, 251, 255):
        path = tmp_path / ("a" * (length - len(ending)) + ending)
        check_writable(path)
        pc.save(structure, path)
        assert pc.load(path).n_atoms == structure.n_atoms
    for name in ("a" * (256 - len(ending)) + ending, "é" * 127 + ending):
        done = protochain("minimise", SAMPLE, "-o", name)
        assert (
            done.returncode == 2 and "File name too long" in done.stderr and "free space" not in done.stderr
        )
    done = protochain("minimise", SAMPLE, "-o", "m.pdb", "--trajectory", "a" * 250 + ".dcd")
    assert done.returncode == 2 and "File name too long" in done.stderr and not Path("m.pdb").exists()


# --- Outputs that are no plain files, and systems that refuse


@pytest.mark.parametrize(
    "command",
    [
        "minimise {} -o m.pdb --trace NAME", "minimise {} -o m.pdb --checkpoint NAME",
        "relax {} -o m.pdb --report NAME.html", "validate {} --csv NAME", "energy {} -o NAME",
        "rmsd {} {} -o NAME", "validate {} --frames all --csv NAME", "batch {} -o .",
    ],
)  # fmt: skip
def test_outputs_that_are_pipes_or_devices_are_refused_before_any_work(command, protochain):
    for name in ("pipe", "pipe.html", "summary.csv"):
        os.mkfifo(name)
    Path("device").symlink_to("/dev/null")
    Path("device.html").symlink_to("/dev/null")
    before = sorted(Path().iterdir())
    for name in ("pipe", "device"):
        done = protochain(*command.replace("{}", str(SAMPLE)).replace("NAME", name).split())
        assert done.returncode == 2 and "is not a regular file" in done.stderr, done.stderr
    assert sorted(Path().iterdir()) == before and Path("pipe").is_fifo()
    with pytest.raises(ProtochainError, match="is not a regular file"):
        write_text(Path("device"), "text")
    assert Path("device").is_symlink()


def test_files_are_written_although_permissions_cannot_be_changed(tmp_path, monkeypatch):
    def refused(*given, **named):
        raise PermissionError(errno.EPERM, os.strerror(errno.EPERM))

    for name in ("chmod", "fchmod", "lchmod"):
        monkeypatch.setattr(os, name, refused, raising=False)
    pc.save(pc.load(SAMPLE), tmp_path / "r.pdb")
    assert pc.load(tmp_path / "r.pdb").n_residues == 10


@pytest.mark.parametrize(
    ("number", "remedy"),
    [
        (errno.ENOSPC, "free space"), (errno.EDQUOT, "free space"), (errno.EPERM, "permissions"),
        (errno.EACCES, "permissions"), (errno.EROFS, "writable"), (errno.ENAMETOOLONG, "shorter name"),
        (errno.EIO, "drive"), (errno.EXDEV, "path"),
    ],
)  # fmt: skip
def test_the_remedy_is_that_of_the_reason(number, remedy, tmp_path, monkeypatch):
    def refused(path, target):
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(Path, "replace", refused)
    with pytest.raises(WriteError) as error:
        write_text(tmp_path / "a.txt", "a")
    assert os.strerror(number) in str(error.value) and remedy in str(error.value)
    assert ("free space" in str(error.value)) == (remedy == "free space") and not list(tmp_path.iterdir())


# --- Signals, and the environment


@pytest.fixture
def as_command(monkeypatch):
    """Signals as the command line handles them."""
    before = {number: signal.signal(number, signal.SIG_DFL) for number in interrupts._SIGNALS}
    interrupt_on_signals()
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.parametrize("number", interrupts._SIGNALS[1:])
def test_signals_that_end_a_run_give_the_best_so_far(number, as_command):
    def watch(row, x):
        if row["iteration"] == 3:
            signal.raise_signal(number)

    solution = pc.minimise(chain("ala10.pdb"), energy("ala10.pdb"), "kcm", tolerance=1e-9, watch=watch)
    assert solution.status == pc.Status.INTERRUPTED and solution.is_usable
    with held_interrupts() as signals:
        signal.raise_signal(number)
    # The system repeats this one every second, while the result is written.
    assert signals == ([] if number == signal.SIGXCPU else [number])


def test_a_run_that_nohup_started_ignores_the_lost_connection():
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        interrupt_on_signals()
        with held_interrupts() as signals:
            signal.raise_signal(signal.SIGHUP)
        assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN and not signals
    finally:
        signal.signal(signal.SIGHUP, before)


def test_settings_of_numba_in_the_current_folder_are_not_read(tmp_path):
    """Settings that cannot be parsed would end the import, and a folder of compiled code would be run."""
    (tmp_path / ".numba_config.yaml").write_text("{ not: [yaml\n")
    program = (
        "import sys, warnings; warnings.simplefilter('error'); import protochain as pc; "
        "import protochain.energies.native.engine; from numba import config; import yaml; "
        "print(repr(config.CACHE_DIR), yaml.safe_load('a: 1'))"
    )
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "NUMBA_CACHE_DIR": ""}
    done = subprocess.run(
        [sys.executable, "-P", "-c", program], cwd=tmp_path, env=environment, capture_output=True, text=True
    )
    assert done.stdout == "'' {'a': 1}\n", done.stderr


def test_settings_of_other_programs_that_make_no_sense_end_no_command(tmp_path):
    """Numexpr, which pandas imports, reads the one, and matplotlib the other; numba a file."""
    (tmp_path / ".numba_config.yaml").write_text("{ not: [yaml\n")
    program = "import sys; from protochain.cli import main; main()"
    settings = {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "abc", "MPLBACKEND": "none"}
    command = ["minimise", str(SAMPLE), "-o", "m.pdb", "--max-evaluations", "3", "--report", "r.html"]
    done = subprocess.run(
        [sys.executable, "-P", "-c", program, *command],
        cwd=tmp_path, env={**os.environ, **settings}, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode in (0, 3) and "Traceback" not in done.stderr, done.stderr
    assert pc.load(tmp_path / "m.pdb").n_residues == 10 and (tmp_path / "r.html").exists()


# --- Files of robots, and plugins

GEOM = '<worldbody><body><joint/><geom size="1"/></body></worldbody>'
BODY = '<body><joint/><geom size="1"/></body>'
MANY = '<replicate count="{}">{}</replicate>'


@pytest.mark.parametrize(
    "text",
    [
        f'<asset><hfield name="h" nrow="40000" ncol="40000" size="1 1 1 1"/></asset>{GEOM}',
        f'<asset><texture name="t" builtin="flat" width="90000" height="90000"/></asset>{GEOM}',
        f'<size nuser_body="1000000000"/>{GEOM}',
        f"<worldbody>{MANY.format(10**9, BODY)}</worldbody>",
        f"<worldbody>{MANY.format(900, MANY.format(900, BODY))}</worldbody>",
        '<worldbody><flexcomp name="f" type="grid" count="5000 5000 1" mass="1"/></worldbody>',
    ],
)
def test_mjcf_without_bound_is_refused(text):
    pytest.importorskip("mujoco")
    with pytest.raises(MechanicsError, match="more than"):
        Mechanism.from_mjcf(f"<mujoco>{text}</mujoco>")
    few = Mechanism.from_mjcf(f"<mujoco><worldbody>{MANY.format(3, BODY)}</worldbody></mujoco>")
    assert len(few.build().q) == 3


@pytest.mark.parametrize("error", [RuntimeError("Caught an unknown exception!"), MemoryError("none left")])
def test_errors_of_the_extension_are_errors_of_mechanics(error, monkeypatch):
    mujoco = pytest.importorskip("mujoco")

    def fails(text):
        raise error

    monkeypatch.setattr(mujoco, "MjModel", SimpleNamespace(from_xml_string=fails))
    with pytest.raises(MechanicsError, match="MuJoCo cannot read it"):
        Mechanism.from_mjcf(f"<mujoco>{GEOM}</mujoco>")


MESH = '{}<asset><mesh name="m" file="{}"/></asset><worldbody><geom type="mesh" mesh="m"/></worldbody>'


@pytest.mark.parametrize(
    ("text", "why"),
    [
        (MESH.format("", "pipe.stl"), "not a regular file"),
        (MESH.format("", "/dev/zero"), "not a regular file"),
        (MESH.format('<compiler meshdir="below"/>', "other.stl"), "not a regular file"),
        (MESH.format('<compiler assetdir="below" strippath="true"/>', "no/other.stl"), "not a regular file"),
        ('<include file="pipe.stl"/>', "not a regular file"),
        ('<include file="../outside.xml"/>', "outside its folder"),
        ('<include file="link.xml"/>', "outside its folder"),
        ('<asset><model name="m" file="../outside.xml"/></asset>', "outside its folder"),
        ('<include file="below/many.xml"/>', "more than"),
    ],
)
def test_files_that_an_mjcf_names_are_plain_files_and_models_lie_in_its_folder(text, why, tmp_path):
    pytest.importorskip("mujoco")
    folder = tmp_path / "model"
    (folder / "below").mkdir(parents=True)
    for name in ("pipe.stl", "below/other.stl"):
        os.mkfifo(folder / name)
    (tmp_path / "outside.xml").write_text(f"<mujoco>{GEOM}</mujoco>")
    (folder / "link.xml").symlink_to(tmp_path / "outside.xml")
    (folder / "below" / "good.xml").write_text(f"<mujocoinclude>{GEOM}</mujocoinclude>")
    many = f"<worldbody>{MANY.format(9_999_999, BODY)}</worldbody>"
    (folder / "below" / "many.xml").write_text(f"<mujocoinclude>{many}</mujocoinclude>")
    model = folder / "model.xml"
    model.write_text(f"<mujoco>{text}</mujoco>")
    with pytest.raises(MechanicsError, match=why):
        Mechanism.from_mjcf(model)
    model.write_text('<mujoco><include file="below/good.xml"/></mujoco>')
    assert len(Mechanism.from_mjcf(model).build().q) == 1


class Refused(Exception):
    """The error of PyMOL and of ChimeraX."""


FAILURES = (
    "sh -c 'kill -9 $$'", "sh -c 'exit 1'", "sh -c 'exit 0'", "sh -c 'echo no JSON'", "/nonexistent/command",
    "/etc/passwd", "sh -c 'unbalanced", "sh -c 'printf \"\\377\" >&2; exit 1'",
)  # fmt: skip
"""Commands that are killed, silent, without a result, missing, not to be run, no words, or not UTF-8."""


@pytest.mark.parametrize("failure", FAILURES)
def test_plugins_report_a_command_that_fails_in_one_line(failure, monkeypatch):
    monkeypatch.setenv("PROTOCHAIN", failure)
    cmd = SimpleNamespace(
        extend=lambda *_: None, auto_arg=[{"align": 0}], get_object_list=lambda selection: ["obj"],
        save=lambda path, *_: Path(path).write_text("x"), load=lambda *_: None,
    )  # fmt: skip
    monkeypatch.setitem(sys.modules, "pymol", SimpleNamespace(CmdException=Refused, cmd=cmd))
    pymol = runpy.run_path(ROOT / "analysis/plugins/protochain_pymol.py")["protochain_relax"]
    commands = SimpleNamespace(
        CmdDesc=lambda **_: None, StringArg=None, register=lambda *_, **__: None, run=lambda *_, **__: None
    )
    for name, module in {
        "chimerax.atomic": SimpleNamespace(AtomicStructureArg=None),
        "chimerax.core.commands": commands,
        "chimerax.core.errors": SimpleNamespace(UserError=Refused),
    }.items():
        monkeypatch.setitem(sys.modules, name, module)
    session = SimpleNamespace(logger=None)
    chimerax = runpy.run_path(ROOT / "analysis/plugins/protochain_chimerax.py", {"session": session})["relax"]
    for call in (lambda: pymol("all", _self=cmd), lambda: chimerax(session, SimpleNamespace(id_string="1"))):
        with pytest.raises(Refused) as refused:
            call()
        assert str(refused.value) and "\n" not in str(refused.value)
