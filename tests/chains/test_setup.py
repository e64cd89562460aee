"""One setup for every run and one copy of every default, with which signatures and commands agree."""

import ast
import inspect
import math

import numpy as np
import pytest
import typer.main
from fixtures.refusals import expect_refusal
from fixtures.samples import ROOT, STRUCTURES, load

import protochain as pc
from protochain.batches import BatchSettings, Processes
from protochain.cli import app
from protochain.core import defaults
from protochain.energies.requested import cached_energy

COMMANDS = typer.main.get_command(app).commands
SAMPLE = STRUCTURES / "ala10.pdb"
CALLS = {"minimise": pc.minimise, "compare": pc.compare, "simulate": pc.simulate}
OTHERWISE = {
    ("compare", "methods"): ",".join(defaults.COMPARED),
    ("simulate", "time_step"): None,
    ("simulate", "superpose"): False,
    ("simulate", "hinge_springs"): None,
    ("simulate", "restraints"): None,
    ("minimise", "max_rmsd"): None,
    ("minimise", "restraints"): None,
}
"""Defaults that commands have as none, or which an option turns off."""


def given(command):
    return {option.name: option.default for option in COMMANDS[command].params}


def defaults_of(call):
    parameters = inspect.signature(call).parameters.values()
    return {each.name: each.default for each in parameters if each.default is not inspect.Parameter.empty}


@pytest.mark.parametrize("command", CALLS)
def test_commands_and_calls_have_the_same_defaults(command):
    own = given(command)
    shared = {name: value for name, value in defaults_of(CALLS[command]).items() if name in own}
    assert len(shared) > 3
    for name, value in shared.items():
        assert own[name] == OTHERWISE.get((command, name), value), name


@pytest.mark.parametrize("command", ["minimise", "compare", "simulate", "info", "batch"])
def test_options_have_the_defaults_of_the_setup(command):
    own, setup = given(command), vars(pc.Setup())
    shared = {*own} & {*setup} - {"batch": {"threads"}, "info": {"device"}}.get(command, set())
    assert {"hinges", "forcefield", "model", "altloc", "keep", "ph", "strict"} <= shared
    for name in shared:
        assert own[name] in (setup[name], None), name


@pytest.mark.parametrize(
    ("field", "former", "commands"),
    [
        ("restraints", "restrain", "minimise simulate search relax batch"),
        ("chains", "chain", "minimise compare simulate search relax batch validate score energy info mutate"),
        ("ligands", "ligand", "minimise compare simulate relax batch validate score energy info mutate"),
    ],
)
def test_an_option_has_the_name_of_its_argument_first_and_then_the_former_one(field, former, commands):
    for command in commands.split():
        (option,) = [option for option in COMMANDS[command].params if option.name == field]
        assert option.opts[:2] == [f"--{field}", f"--{former}"], command
        assert option.opts[2:] == ["--ligand-poses"] * (field == "ligands"), command


def test_calls_have_the_defaults_of_the_setup():
    setup = vars(pc.Setup())
    for call in (pc.load, pc.build_chain, pc.energy):
        shared = {name: value for name, value in defaults_of(call).items() if name in setup}
        shared.pop("forcefield" if call is pc.load else "", None)
        assert shared == {name: setup[name] for name in shared} and shared
    batch = given("batch")
    for value in (BatchSettings(), Processes()):
        own = {name: default for name, default in vars(value).items() if name in batch}
        otherwise = {"methods", "max_rmsd", "spread", "curvature", "restraints"}
        own |= {name: batch[name] for name in own.keys() & otherwise}
        assert own == {name: batch[name] for name in own} and len(own) > 3


def test_no_signature_repeats_a_default():
    once = {defaults.FORCEFIELD, defaults.SOLVENT, defaults.HINGES, defaults.METHOD}
    repeated = []
    for path in (ROOT / "protochain").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            values = node.defaults + node.kw_defaults if isinstance(node, ast.arguments) else []
            values += [node.value] if isinstance(node, ast.AnnAssign) else []
            if once & {value.value for value in values if isinstance(value, ast.Constant)}:
                repeated.append(f"{path}:{node.lineno if isinstance(node, ast.AnnAssign) else ''}")
    assert repeated == []


def test_a_setup_prepares_as_the_separate_calls_do():
    setup = pc.Setup(
        hinges="phi psi", root="free", solvent="vacuum", threads=1, ph=4.0, disulfide="none", move="resid 2:9"
    )
    structure, chain, energy = setup.prepare(STRUCTURES / "4pti.pdb")
    alone = pc.load(STRUCTURES / "4pti.pdb", ph=4.0, disulfide="none")
    assert np.array_equal(structure.positions, alone.positions)
    cut = pc.build_chain(alone, "phi psi", "free", move="resid 2:9")
    assert np.array_equal(chain.q0, cut.q0) and (chain.root, chain.move) == ("free", "resid 2:9")
    assert np.array_equal(chain.moving, cut.moving) and not chain.moving.all()
    assert energy.fingerprint == pc.energy(alone, solvent="vacuum").fingerprint and energy.threads == 1
    once, again = (pc.Setup().prepare(load("ala10.pdb"), build_energy=cached_energy) for _ in range(2))
    assert once.structure is load("ala10.pdb") and once.energy is again.energy
    atoms = pc.to_mdanalysis(load("ala10.pdb")).atoms
    assert pc.Setup().prepare(atoms, "frame 0").structure.name == "frame 0"


def test_a_setup_reads_the_words_of_the_command_line():
    setup = pc.Setup(model="3", keep="water, ions", disulfide="A:5-A:55, A:-1-A:30B")
    assert setup == pc.Setup(model=3, keep=["water", "ions"], disulfide=[("A:5", "A:55"), "A:-1-A:30B"])
    assert pc.Setup(model="") == pc.Setup() and hash(setup)
    for wrong, why in (
        ({"model": "first"}, "give its number, or all"), ({"disulfide": "5-55"}, "as A:3-A:40"),
    ):  # fmt: skip
        with pytest.raises(pc.ProtochainError, match=why):
            pc.Setup(**wrong)
    with expect_refusal("model"):
        pc.Setup(model="all").prepare(SAMPLE)


@pytest.mark.parametrize(
    ("options", "spread"), [((), defaults.SPREAD), (("--spread", "30"), math.radians(30.0))]
)
def test_starts_differ_by_the_same_angle_from_the_command_line(options, spread, monkeypatch, tmp_path):
    assert defaults_of(pc.explore)["spread"] == defaults.SPREAD
    taken = {}

    def explore(chain, energy, **settings):
        taken.update(settings)
        raise pc.ProtochainError("enough")

    monkeypatch.setattr("protochain.minimisers.explore", explore)
    command = ["minimise", str(SAMPLE), "--starts", "2", "-o", str(tmp_path / "a.pdb"), *options]
    with pytest.raises(pc.ProtochainError, match="enough"):
        app(command, standalone_mode=False)
    assert taken["spread"] == spread and taken["n_starts"] == 2
    (shown,) = [option.help for option in COMMANDS["minimise"].params if option.name == "spread"]
    assert f"[default: {math.degrees(defaults.SPREAD):.1f}]" in shown
