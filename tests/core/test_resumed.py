"""Runs of every command go on with the same settings and the same input only."""

import contextlib
import importlib
import json
import re
from dataclasses import fields, replace
from functools import cache

import numpy as np
import pytest
from fixtures.frames import saved
from fixtures.samples import STRUCTURES

import protochain as pc
from protochain.batches import Processes, frame_files, mutation_scan
from protochain.batches.frame_tasks import EnergyFrames, RelaxFrames, RmsdFrames, ScoreFrames, ValidateFrames
from protochain.batches.jobs import BatchSettings, failure
from protochain.core.checkpoints import write_checkpoint
from protochain.dynamics.simulate_settings import SimulationSettings
from protochain.minimisers.minimise_settings import MinimiseSettings
from protochain.relaxation import RelaxSettings
from protochain.searching import search_chain
from protochain.searching.search_settings import SearchSettings

SETUP = pc.Setup(threads=1)
SYSTEM, START = "another system", "another start"
CHAIN = ("hinges", "root", "move", "hydrogen_mass")
ENERGY = ("forcefield", "solvent", "salt", "terms", "cutoff", "accuracy", "engine")
OTHER = {
    "hinges": "phi psi", "root": "fixed", "move": "resid 1:2", "hydrogen_mass": 3.0, "rigid_protein": True,
    "forcefield": "amber99sb", "solvent": "gbn2", "salt": 0.1, "terms": "nonbonded", "calculator": "xtb",
    "cutoff": 2.0, "accuracy": 0.01, "engine": "openmm", "device": "cpu", "trust_forcefield": True,
    "model": 2, "assembly": "1", "altloc": "B", "keep": ("none",), "disulfide": (("A:1", "A:2"),), "ph": 5.0,
    "strict": True, "chains": ("A",), "ligands": (("LIG", "CCO"),), "ligand_charges": "mmff94",
    "standard_residues": True, "cap": "all", "rebuild_side_chains": "all", "sequence": "AGA",
    "preset": "crystal", "protocol": "alphafold", "tolerance": 0.5, "stiffness": 7.0,
    "max_iterations": 7, "max_outer_iterations": 1, "exclude": "resid 1", "keep_hydrogens": False,
    "repack": True, "posebusters": True, "free_ligands": True, "score_only": True,
    "repack_region": "resid 1", "interface": "A:B", "mirror": True,
    "restraints": "distance A:1:CA A:3:CA 0 4 100", "seed": 7, "max_rmsd": 2.0, "curvature": False,
    "method": "hopping", "methods": ("lbfgs",), "temperatures": (310.0, 600.0), "n_walkers": 3,
    "n_replicas": 3, "pilot": 9, "temperature": 310.0, "time_step": 0.002, "thermostat": "none",
    "friction": 2.0, "integrator": "midpoint", "fixman": True, "trajectory_length": 5,
    "every": 2, "pull": "A:1:N-A:3:C", "hinge_springs": "phi 40 0.5", "superpose": False,
    "max_evaluations": 9, "judge": "reference", "n_starts": 2, "spread": 0.4,
}  # fmt: skip
"""Another value of every setting of any command."""
FREE = {
    "minimise": ("max_evaluations", "judge"), "search": (), "simulate": ("loops",),
    "frames": ("threads",), "scan": ("threads",), "batch": ("threads", "setup", "relaxing"),
}  # fmt: skip
"""Settings that another part of a run may have."""
WITH = {"spread": {"n_starts": 2}, "n_starts": {"spread": 0.2}}
"""Further settings without which one is refused."""
KINDS = {
    "minimise": (MinimiseSettings,), "search": (SearchSettings,), "simulate": (SimulationSettings,),
    "frames": (RelaxSettings, pc.Setup), "scan": (RelaxSettings, pc.Setup),
    "batch": (BatchSettings, RelaxSettings, pc.Setup),
}  # fmt: skip
"""Commands with checkpoints, and the classes of their settings."""


@cache
def peptide(sequence="GAG"):
    return pc.from_sequence(sequence)


@cache
def ready(structure, chain=(), energy=()):
    return pc.build_chain(structure, **dict(chain)), pc.energy(structure, threads=1, **dict(energy))


def split(settings):
    """Chain and energy of the settings, and the other settings."""
    structure = settings.pop("structure", peptide())
    parts = ([(n, settings.pop(n)) for n in names if n in settings] for names in (CHAIN, ENERGY))
    return *ready(structure, *map(tuple, parts)), settings


def minimise(folder, resume, **settings):
    file = folder / "run.npz"
    chain, energy, settings = split({"method": "lbfgs"} | settings)
    pc.minimise(chain, energy, max_evaluations=3, **{"resume" if resume else "checkpoint": file}, **settings)
    return file


def search(folder, resume, **settings):
    chain, energy, settings = split({"method": "csa", "n_walkers": 1} | settings)
    pc.search(chain, energy, evaluations=1, output=folder / "s", resume=resume, **settings)
    return folder / "s" / "pieces" / "walker-0" / "000000.npz"


def simulate(folder, resume, **settings):
    chain, energy, settings = split({"every": 1} | settings)
    pc.simulate(chain, energy, n_steps=1, output=folder / "m", resume=resume, **settings)
    return folder / "m" / "checkpoint.npz"


def of_relaxing(settings):
    relaxing, setup = (
        {field.name: settings[field.name] for field in fields(of) if field.name in settings}
        for of in (RelaxSettings, pc.Setup)
    )
    return RelaxSettings(**relaxing), pc.Setup(threads=1, **setup)


def frames(folder, resume, **settings):
    structure = settings.pop("structure", peptide())
    x = structure.positions + np.random.default_rng(0).normal(0.0, 0.01, (3, structure.n_atoms, 3))
    path = folder / "x.dcd"
    if not resume:
        saved(structure, x, path)
    task = settings.pop("task", None) or RelaxFrames(*of_relaxing(settings))
    ensemble, chosen = pc.batches.frames.ensemble_of(structure, path, None, SETUP)
    table = folder / "t.csv"
    assert frame_files.run_frames(ensemble, chosen, task, table, resume=resume).interrupted
    return table.with_suffix(".checkpoint.npz")


def scan(folder, resume, **settings):
    structure = settings.pop("structure", peptide())
    where = settings.pop("sites", "A:2"), settings.pop("into", "V")
    table = folder / "t.csv"
    mutation_scan.run_scan(
        structure, *where, *of_relaxing(settings), table, Processes(1), resume, lambda *_: None
    )
    return table.with_suffix(".checkpoint.npz")


def batch(folder, resume, **settings):
    usual = {"methods": ("lbfgs", "relax"), "workers": 1}
    pc.batch([STRUCTURES / "ala10.pdb"], folder / "b", resume=resume, **usual | settings)
    return folder / "b" / "settings.json"


RUNS = {run.__name__: run for run in (minimise, search, simulate, frames, scan, batch)}


@pytest.fixture(autouse=True)
def without_work(monkeypatch):
    """Runs over frames and of mutants are stopped before the first row. Rows of batches are refusals."""

    def stopped(*_):
        raise KeyboardInterrupt

    def work(workers, todo, tables, *_):
        for job in todo:
            tables.append([failure(job, method, "refused", "why") for method in job.settings.methods])
        return False

    api = importlib.import_module("protochain.batches.batch_structures")
    monkeypatch.setattr(api, "_work", work)
    monkeypatch.setattr(api, "_finish", lambda *_: None)
    monkeypatch.setattr(api, "open_workers", lambda processes: contextlib.nullcontext())
    monkeypatch.setattr(frame_files, "over_frames", stopped)
    monkeypatch.setattr(mutation_scan, "rows_of", stopped)
    monkeypatch.setattr(search_chain, "SECONDS", 0.0)


def refusal(kind, folder, **settings):
    try:
        RUNS[kind](folder, True, **settings)
    except pc.ProtochainError as error:
        return str(error)
    return "accepted"


SAID = {
    **dict.fromkeys(ENERGY, SYSTEM), "accuracy": "accuracy", "engine": "engine", "restraints": "restraint",
    "rigid_protein": "move", "method": "", "spread": "n_starts",
}  # fmt: skip
"""Words of a refusal, if they are not the name of the setting. A method has other names in some files."""


@pytest.mark.parametrize("kind", KINDS)
def test_a_run_goes_on_with_the_same_settings_only(kind, tmp_path):
    """Each setting of a command is changed. A new one needs another value above, or a place in ``FREE``."""
    whole = pc.Setup in KINDS[kind]
    names = {field.name for of in KINDS[kind] for field in fields(of)} - {*FREE[kind]}
    names |= set() if whole else {*CHAIN, *ENERGY}
    RUNS[kind](tmp_path, False)
    accepted = {}
    for name in names:
        said = name if whole and name in ENERGY else SAID.get(name, name)
        text = refusal(kind, tmp_path, **{name: OTHER[name]} | WITH.get(name, {}))
        if not re.search(f"(results|written by a run) with.*{said}", text):
            accepted[name] = text
    assert not accepted


@cache
def moved(step):
    """The peptide mirrored, or with one atom off by the last digit of a file."""
    x = peptide().positions.copy()
    x[3, 0] += step
    return peptide().with_positions(x if step else x[:, [1, 0, 2]])


def stored(file):
    """Settings of a checkpoint, and a function that replaces them."""
    if file.suffix == ".json":
        text = json.loads(file.read_text())
        return text["settings"], lambda new: file.write_text(json.dumps(text | {"settings": new}))
    with np.load(file) as contents:
        arrays = dict(contents)
    text = json.loads(str(arrays.pop("text")))
    return text["settings"], lambda new: write_checkpoint(file, arrays, text["values"], new)


@pytest.mark.parametrize("kind", KINDS)
def test_settings_of_a_checkpoint_are_compared_one_by_one(kind, tmp_path):
    """Each is dropped, changed, and one is added, as other versions have other settings."""
    settings, store = stored(RUNS[kind](tmp_path, False))
    changes = [(name, {key: settings[key] for key in settings if key != name}) for name in settings]
    changes += [(name, {**settings, name: "another"}) for name in settings]
    accepted = []
    for name, changed in [*changes, ("further", settings | {"further": None})]:
        store(changed)
        text = refusal(kind, tmp_path)
        said = {"system": SYSTEM, "start": START, **dict.fromkeys([*settings][:1], "")}.get(name, name)
        if text == "accepted" or said not in text:
            accepted.append((name, text))
    assert not accepted


@pytest.mark.parametrize("kind", ["minimise", "search", "simulate", "frames", "scan"])
def test_a_run_goes_on_with_the_same_input_only(kind, tmp_path):
    """Not with one atom off by the last digit of a file, with a mirror image, or with other atoms."""
    RUNS[kind](tmp_path, False)
    for words, other in ((START, moved(1e-4)), (START, moved(0.0)), ("", peptide("AGG"))):
        text = refusal(kind, tmp_path, structure=other)
        assert "written by a run with" in text and words in text


TASKS = {
    "validate": lambda reference, align: ValidateFrames(SETUP, reference),
    "score": lambda reference, align: ScoreFrames(SETUP, "A:B", align != "name CA", reference),
    "rmsd": lambda reference, align: RmsdFrames(reference, align, align),
    "energy": lambda reference, align: EnergyFrames(replace(SETUP, forcefield=str(align))),
}


@pytest.mark.parametrize("task", TASKS)
def test_frames_go_on_with_the_same_frames_reference_and_options_only(task, tmp_path):
    """Other frames have as many bytes, and another reference has the same name."""
    own = tmp_path / "own.xml"
    own.write_text("<ForceField/>")
    option = own if task == "energy" else "name CA"
    frames(tmp_path, False, task=TASKS[task](peptide(), option))
    if task == "energy":
        own.write_text("<ForceField> </ForceField>")
        assert "content of the force field" in refusal("frames", tmp_path, task=TASKS[task](None, own))
        own.write_text("<ForceField/>")
    else:
        assert "reference" in refusal("frames", tmp_path, task=TASKS[task](moved(1e-4), option))
        if task != "validate":
            assert refusal("frames", tmp_path, task=TASKS[task](peptide(), "all")) != "accepted"
    x = (tmp_path / "x.dcd").read_bytes()
    (tmp_path / "x.dcd").write_bytes(x[:-9] + bytes([x[-9] ^ 1]) + x[-8:])
    assert "content of frames" in refusal("frames", tmp_path, task=TASKS[task](peptide(), option))
