"""Plugins for programs that show structures: what each does to its program, for which others stand in."""

import runpy
import shlex
import shutil
import sys
import tomllib
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest
import yaml
from fixtures.command_line import COMMAND
from fixtures.samples import ROOT

import protochain as pc

PLUGINS = ROOT / "analysis" / "plugins"
FILE = ROOT / "analysis" / "workflows" / "galaxy" / "test-data" / "model.pdb"


def module(name, **names):
    made = ModuleType(name)
    vars(made).update(names)
    return made


@pytest.fixture(autouse=True)
def program(monkeypatch):
    monkeypatch.setenv("PROTOCHAIN", shlex.join(COMMAND))


class Refused(Exception):
    """As PyMOL's and ChimeraX's own."""


class Pymol(dict):
    """What the plugin asks of PyMOL: objects by name."""

    def __init__(self):
        super().__init__(model=FILE.read_text())
        self.auto_arg, self.commands = [{"align": "selection"}], {}

    def get_object_list(self, selection):
        return [name for name in self if selection in (name, "all")]

    def save(self, path, selection, state):
        Path(path).write_text(self[selection])

    def load(self, path, name):
        self[name] = Path(path).read_text()

    def extend(self, name, function):
        self.commands[name] = function


def test_pymol_gets_the_relaxed_model_beside_the_other(monkeypatch, capsys, tmp_path):
    cmd = Pymol()
    monkeypatch.setitem(sys.modules, "pymol", module("pymol", cmd=cmd, CmdException=Refused))
    runpy.run_path(PLUGINS / "protochain_pymol.py")
    relax = cmd.commands["protochain_relax"]
    assert relax("model", options="--preset crystal")["preset"] == "crystal"
    assert "violations: 0 before, 0 after" in capsys.readouterr().out
    (tmp_path / "found.pdb").write_text(cmd["model_relaxed"])
    assert pc.load(tmp_path / "found.pdb").n_residues == 6
    with pytest.raises(Refused, match="selects nothing"):
        relax("nothing")
    cmd["empty"] = "END\n"
    with pytest.raises(Refused, match=r"model\.pdb"):
        relax("empty")


def test_chimerax_gets_the_relaxed_model_where_the_other_is(monkeypatch, tmp_path):
    commands, said, opened = {}, [], SimpleNamespace(position=None)

    def run(session, text, log):
        verb, path, *_ = shlex.split(text)
        if verb == "save":
            assert text.endswith("models #1.2")
            shutil.copy(FILE, path)
            return None
        shutil.copy(path, tmp_path / "found.pdb")
        return [opened]

    def register(name, described, function, logger):
        assert described.required == [("structure", "structure")]
        commands[name] = function

    core = {
        "chimerax.atomic": module("chimerax.atomic", AtomicStructureArg="structure"),
        "chimerax.core.commands": module(
            "chimerax.core.commands", CmdDesc=SimpleNamespace, StringArg="text", register=register, run=run
        ),
        "chimerax.core.errors": module("chimerax.core.errors", UserError=Refused),
    }
    for name, its in core.items():
        monkeypatch.setitem(sys.modules, name, its)
    session = SimpleNamespace(logger=SimpleNamespace(info=said.append))
    runpy.run_path(PLUGINS / "protochain_chimerax.py", {"session": session})
    structure = SimpleNamespace(id_string="1.2", name="model", position="here")
    assert commands["protochain relax"](session, structure) is opened
    assert opened.position == "here" and "violations: 0 before, 0 after" in said
    assert pc.load(tmp_path / "found.pdb").n_residues == 6
    with pytest.raises(Refused, match="nowhere"):
        commands["protochain relax"](session, structure, options="--preset nowhere")


def test_the_mdakit_says_what_the_project_says():
    said = yaml.safe_load((PLUGINS / "mdakit.yaml").read_text(encoding="utf-8"))
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert (said["project_name"], said["license"]) == (project["name"], project["license"])
    assert said["python_requires"] == project["requires-python"]
    assert f"MDAnalysis{said['mdanalysis_requires']}" in project["dependencies"]
