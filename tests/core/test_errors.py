"""What messages say: arguments in Python, options in commands, units, and what was changed."""

import pickle
import sys

import numpy as np
import pytest
from distributed import LocalCluster
from fixtures.samples import STRUCTURES, chain, energy

import protochain as pc
from protochain.batches import cluster
from protochain.batches.jobs import BatchSettings, find_jobs
from protochain.cli import main, message_of
from protochain.core.errors import Angle, Argument, ProtochainError, WriteError

SAMPLE = STRUCTURES / "ala10.pdb"


def said(monkeypatch, capsys, *arguments):
    """Status and last line of a command."""
    monkeypatch.setattr(sys, "argv", ["protochain", *map(str, arguments)])
    with pytest.raises(SystemExit) as ended:
        main()
    return ended.value.code, capsys.readouterr().err.splitlines()[-1]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("minimise", SAMPLE, "--max-evaluations", 0), "--max-evaluations 0: give at least 1"),
        (("minimise", SAMPLE, "--restraints", "-1"), "--restraints -1: give strengths in kJ/mol/nm^2"),
        (("minimise", SAMPLE, "--restraints", "strong"), "--restraints 'strong': no such file; give"),
        (("minimise", SAMPLE, "--starts", 3, "--restraints", 10), ": --restraints and --max-rmsd refer to"),
        (("minimise", SAMPLE, "--starts", 3, "--spread", "-30"), "--spread -30 degrees: give an angle"),
        (("batch", SAMPLE, "--starts", 3, "--spread", 0), "--spread 0 degrees: give an angle above 0"),
        (("simulate", SAMPLE, "--steps", 0), "--steps 0: "),
        (("simulate", SAMPLE, "--resume"), "remove --resume"),
        (("simulate", SAMPLE, "--time-step", "0.002"), "0.002 fs: give femtoseconds: 2 are 0.002 ps"),
        (("simulate", SAMPLE, "--time-step", "2000"), "--time-step 2000 fs: "),
        (("simulate", SAMPLE, "--time-step", "0"), "--time-step 0 fs: give a number above 0"),
    ],
)  # fmt: skip
def test_commands_hear_of_their_options(arguments, words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    status, line = said(monkeypatch, capsys, *arguments)
    assert status == 2 and words in line and "_" not in line


def test_only_arguments_are_told_as_options():
    """Not words and names of files that look like them, nor arguments that no command has."""
    error = pc.ProtochainError(
        "max_rmsd.pdb: restraints: ", Argument("time_step"), " 3; give ", Argument("resume", True), ", ",
        Argument("keep", "all"), ", ", Argument("restraints"), " or ", Argument("path"), " ", Angle(np.pi),
    )  # fmt: skip
    assert str(error) == (
        'max_rmsd.pdb: restraints: time_step 3; give resume=True, keep="all", restraints or path 3.14159 rad'
    )
    assert message_of(error) == (
        "max_rmsd.pdb: restraints: --time-step 3; give --resume, --keep all, --restraints or path 180 degrees"
    )
    assert message_of(pickle.loads(pickle.dumps(error))) == message_of(error)


def test_every_error_is_told_from_its_parts():
    """One with words of its own beside them would be another on the command line."""
    kinds = [ProtochainError]
    for each in kinds:
        kinds += each.__subclasses__()
        assert each is ProtochainError or not {"__str__", "told"} & vars(each).keys(), each


def test_an_error_that_says_where_keeps_the_arguments_of_what_it_says(tmp_path):
    (tmp_path / "m.csv").write_text("path,spread\na.pdb,0\n")
    with pytest.raises(pc.ProtochainError) as raised:
        find_jobs([], BatchSettings(n_starts=2), tmp_path / "m.csv")
    where = f"{tmp_path}/m.csv: line 2: "
    assert str(raised.value) == f"{where}spread 0 rad: give an angle above 0"
    assert message_of(raised.value) == f"{where}--spread 0 degrees: give an angle above 0"


def test_a_file_that_is_not_written_says_how_to_go_on_in_the_words_of_the_caller():
    error = WriteError("x", "full").with_saved("nothing", "continue with ", Argument("resume", True))
    assert (
        str(error)
        == "x: not written (full); saved: nothing; free space there, then continue with resume=True"
    )
    assert message_of(pickle.loads(pickle.dumps(error))) == str(error).replace("resume=True", "--resume")


def test_what_is_left_out_is_told_with_the_words_of_whoever_asks(monkeypatch, capsys):
    assert (
        pc.load(STRUCTURES / "1ubq.pdb")
        .changes[0]
        .endswith('left out: the solvent is implicit; keep="all" keeps everything')
    )
    monkeypatch.setattr(sys, "argv", ["protochain", "info", str(STRUCTURES / "1ubq.pdb")])
    with pytest.raises(SystemExit):
        main()
    told = capsys.readouterr()
    assert "--keep all keeps everything" in told.out + told.err and "keep=" not in told.out + told.err


@pytest.mark.parametrize(
    ("arguments", "command"),
    [
        (("minimise", SAMPLE, "--metod", "kcm"), "protochain minimise --help"),
        (("minimise",), "protochain minimise --help"),
        (("simulate", SAMPLE, "--steps", "many"), "protochain simulate --help"),
        (("frobnicate",), "protochain --help"),
    ],
)
def test_errors_of_usage_name_the_help_of_the_command(arguments, command, monkeypatch, capsys):
    status, line = said(monkeypatch, capsys, *arguments)
    assert status == 2 and line.endswith(f"See {command}.")


def test_a_cluster_without_workers_says_so_and_goes_on_when_one_comes(monkeypatch, caplog):
    monkeypatch.setattr(cluster, "_PATIENCE", 0.2)
    emit = caplog.handler.emit

    def warned(record):
        emit(record)
        if record.name.startswith("protochain"):
            scheduler.scale(1)

    with LocalCluster(n_workers=0, processes=False, dashboard_address=None) as scheduler:
        address = scheduler.scheduler_address
        monkeypatch.setattr(caplog.handler, "emit", warned)
        with cluster.open_workers(cluster.Processes(scheduler=address)) as workers:
            assert workers.count() > 0
    (line,) = [record.getMessage() for record in caplog.records if record.name.startswith("protochain")]
    assert line.startswith(f"scheduler {address}: no workers after 0.2 s") and "dask worker" in line


@pytest.mark.parametrize("name", ["1ejg.pdb", "ala10.pdb"])
def test_an_alternate_location_that_no_atom_has_is_refused(name):
    words = "its atoms have A, B" if name == "1ejg.pdb" else "no atom of it has one"
    with pytest.raises(pc.ProtochainError, match=rf"{name}: .*'Z'.*{words}"):
        pc.load(STRUCTURES / name, altloc="Z")


def test_what_is_no_checkpoint_is_said_to_be_none(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.npz").write_text("nothing of use\n")
    np.save(tmp_path / "b.npy", np.zeros(3))
    np.savez(tmp_path / "c.npz", x=np.zeros(3))
    pc.simulate(chain("ala10.pdb"), energy("ala10.pdb"), n_steps=2, output=tmp_path / "run")
    (tmp_path / "empty.npz").touch()
    for name in (SAMPLE, "a.npz", "b.npy", "c.npz", "empty.npz", "run/checkpoint.npz", "run"):
        status, line = said(monkeypatch, capsys, "minimise", SAMPLE, "-o", "o.pdb", "--resume", name)
        assert status == 2 and line == (
            f"protochain: {name}: is not a checkpoint of a minimisation; give a file that an earlier run "
            "wrote as its checkpoint"
        )
    with pytest.raises(pc.ProtochainError, match="not a checkpoint of a minimisation"):
        pc.minimise(chain("ala10.pdb"), energy("ala10.pdb"), resume=SAMPLE)
    (tmp_path / "run" / "checkpoint.npz").write_text("nothing of use\n")
    status, line = said(monkeypatch, capsys, "simulate", SAMPLE, "-o", "run", "--resume")
    assert status == 2 and "run/checkpoint.npz: is not a checkpoint of a simulation; start again" in line
