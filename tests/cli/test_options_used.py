"""Each option of each command, on each path through it, changes what comes of it, or is refused by name."""

import csv
import io
import json
import re
import shutil
import sys
from concurrent.futures import Future
from contextlib import contextmanager, nullcontext, suppress
from types import SimpleNamespace

import numpy as np
import pytest
from fixtures.command_line import COMMANDS, run
from typer.core import TyperOption
from typer.exceptions import TyperException

import protochain as pc
from protochain.batches import cluster
from protochain.chains.setup import Setup
from protochain.cli import message_of
from protochain.cli.options import BAD_INPUT
from protochain.core.errors import ProtochainError
from protochain.core.settings import settings_of
from protochain.structure.formats.trajectory import TrajectoryFile

pytestmark = [pytest.mark.usefixtures("interruptible"), pytest.mark.slow]

QUICK = "--solvent vacuum --max-evaluations 3"
LIGAND = "--ligands LIG=CCO --ligand-charges gasteiger"
RELAX = f"--solvent vacuum --max-iterations 2 --max-outer-iterations 1 {LIGAND}"
MANY = ("relax several", "relax models", "relax manifest", "relax poses")
"""Whose results are a folder."""
PATHS = {
    "minimise": f"c.pdb {QUICK} {LIGAND}",
    "minimise models": f"m.pdb --model all {QUICK} {LIGAND}",
    "minimise starts": f"c.pdb --starts 2 --method lbfgs {QUICK} {LIGAND}",
    "minimise resume": f"c.pdb --resume state.npz {QUICK} {LIGAND}",
    "relax": f"c.pdb {RELAX}",
    "relax several": f"c.pdb d.pdb {RELAX}",
    "relax models": f"m.pdb --model all {RELAX}",
    "relax manifest": f"--manifest list.csv {RELAX}",
    "relax poses": "p.pdb --ligands poses.sdf --ligand-charges gasteiger --solvent vacuum --max-iterations 2",
    "relax frames": f"m.pdb --frames all {RELAX}",
    "relax trajectory": f"c.pdb --trajectory ligand.dcd {RELAX}",
    "batch": f"p.pdb d.pdb --methods lbfgs {QUICK}",
    "batch relax": f"c.pdb --methods relax --max-iterations 2 --solvent vacuum {LIGAND}",
    "batch starts": f"p.pdb --methods lbfgs --starts 2 {QUICK}",
    "compare": f"p.pdb --methods lbfgs,anneal {QUICK}",
    "simulate": "p.pdb --no-relax --steps 4 --every 2 --solvent vacuum",
    "simulate pulled": "p.pdb --no-relax --steps 4 --pull A:1:N-A:5:C --solvent vacuum",
    "modes": "p.pdb --no-relax --modes 2 --solvent vacuum",
    "validate": "c.pdb --ligands LIG=CCO",
    "validate several": "c.pdb d.pdb --ligands LIG=CCO",
    "validate frames": "m.pdb --frames all",
    "score": f"c.pdb --solvent vacuum {LIGAND}",
    "score several": "c.pdb d.pdb --solvent vacuum",
    "score frames": "m.pdb --frames all --interface B:A --solvent vacuum",
    "ensemble": "n.pdb --frames all --csv e.csv --residues r.csv",
    "energy": "c.pdb --solvent vacuum",
    "energy frames": "m.pdb --frames all --solvent vacuum",
    "mutate": "p.pdb A2G --solvent vacuum",
    "mutate scan": "p.pdb --scan A:2 --into G --solvent vacuum",
    "scan": "p.pdb psi@A:2=-40,40 --solvent vacuum --hinges phi,psi,chi",
    "rmsd": "p.pdb c.pdb",
    "rmsd frames": "p.pdb m.pdb --frames all",
    "info": "c.pdb",
    "info energy": "c.pdb --energy",
    "build": "GAV -o built.pdb",
    "search": "p.pdb --solvent vacuum --evaluations 200 --method tempering --walkers 1 --replicas 2",
    "search sequence": "GAV --solvent vacuum --evaluations 40 --method hopping",
}  # fmt: skip
"""Arguments of each path; the first word is the command."""

VALUES = {
    "output": "other.pdb", "method": "newton", "angle": "0.001", "trace": "t.csv", "trajectory": "t.dcd",
    "report": "page.html", "ligand_out": "l.sdf", "checkpoint": "end.npz", "resume": "state.npz",
    "restraint_csv": "rc.csv", "protein_out": "alone.pdb",
    "tolerance": "700", "restraints": "position A:2:CA 0", "max_rmsd": "0.5", "spread": "20",
    "manifest": "list.csv", "scheduler": "tcp://127.0.0.1:9", "frames": "0", "preset": "design",
    "protocol": "alphafold", "stiffness": "50", "exclude": "resid 2", "repack_region": "chainID A",
    "rebuild_side_chains": "resid 2", "sequence": "A=GGGGGG",
    "interface": "A:B", "methods": "lbfgs,newton", "reference": "d.pdb", "to": "q.pdb",
    "csv": "t.csv", "residues": "r.csv", "changes": "ch.csv", "rank": "energy_kj_mol", "by": "residue",
    "between": "A:1-A:5", "align": "name C", "measure": "name N", "temperatures": "310-500", "hours": "1e-9",
    "within": "1e-3", "after": "m.pdb", "figure": "f.pdf",
    "thermostat": "none", "integrator": "midpoint", "loops": "closed", "hydrogen_mass": "2",
    "hinge_springs": "phi 40", "temperature": "310", "time_step": "0.5", "friction": "3",
    "amplitude": "2", "evaluations": "400", "workers": "3", "time_limit": "77",
    "n_starts": "3", "scan": "A:3", "into": "V", "speed": "1", "judge": "reference",
}  # fmt: skip
"""What an option is given, by its name; flags and numbers not here get another than their default."""
OF_SETUP = {
    "hinges": "chi", "move": "resid 2", "forcefield": "amber99sb", "solvent": "obc2", "engine": "openmm",
    "device": "cuda", "calculator": "xtb",
    "terms": "nonbonded", "cutoff": "1", "accuracy": "exact", "threads": "1",
    "model": "2",
    "assembly": "1", "altloc": "B", "keep": "none", "disulfide": "A:3-A:5", "ph": "3", "chains": "A",
    "ligands": "LIG=CO", "ligand_charges": "mmff94",
}  # fmt: skip
LATER = {"resume", "curvature", "mirror", "max_outer_iterations", "checkpoint_every"}
"""Options that act on what there is not here: a folder, an end of a run, a chain that is a mirror image."""

WITHOUT_EFFECT = (("force", "minimise models"), ("verbose", "relax poses"), ("verbose", "score frames"))
"""The output m.1.pdb is no input. A single change is printed with and without ``--verbose``."""


def given(path, option):
    if "FRAMES" in (option.metavar or ""):
        return [option.opts[0], "ligand.dcd" if "LIG=CCO" in PATHS[path] else "x.dcd"]
    if option.is_flag:
        on = option.default in (False, None)
        return [
            option.opts[0] if on else option.secondary_opts[0] if option.secondary_opts else option.opts[0]
        ]
    value = {**OF_SETUP, **VALUES}.get(option.name)
    if value is None:
        assert option.default is not None, f"give a value of {option.opts[0]} in VALUES"
        value = 2 * option.default + 1
    return [option.opts[0], str(value)]


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Two chains and a ligand, alone and as models, with a trajectory, a manifest, poses and a checkpoint."""
    from rdkit import Chem
    from rdkit.Chem import AllChem
    from rdkit.Geometry import Point3D

    folder = tmp_path_factory.mktemp("made")

    def atoms(sequence, chain, up):
        peptide = pc.from_sequence(sequence)
        pc.save(peptide.with_positions(peptide.positions + np.array([0.0, 0.0, up])), folder / "p.pdb")
        lines = (folder / "p.pdb").read_text().splitlines()
        return [f"{line[:21]}{chain}{line[22:]}\n" for line in lines if line.startswith("ATOM")]

    far, other, one = atoms("GAV", "B", 1.02), atoms("GAV", "B", 1.0), atoms("GAVSDK", "A", 0.0)
    ethanol = Chem.AddHs(Chem.MolFromSmiles("CCO"))
    AllChem.EmbedMolecule(ethanol, randomSeed=1)
    at = ethanol.GetConformer()
    at.SetPositions(at.GetPositions() + np.array([3.0, 0.0, -8.0]))
    ligand = [
        f"HETATM  90{k}  {name:<3} LIG C   1    {''.join(f'{c:8.3f}' for c in at.GetPositions()[k])}"
        f"  1.00  0.00           {name[0]}\n"
        for k, name in enumerate(("C1", "C2", "O1"))
    ]
    model = "".join([*one, "TER\n", *other, "TER\n", *ligand])
    (folder / "c.pdb").write_text(f"{model}END\n")
    apart = "".join([*one, "TER\n", *far, "TER\n", *ligand])
    (folder / "d.pdb").write_text(f"{apart}END\n")
    (folder / "n.pdb").write_text(f"MODEL        1\n{model}ENDMDL\nMODEL        2\n{apart}ENDMDL\nEND\n")
    (folder / "m.pdb").write_text("".join(f"MODEL        {n}\n{model}ENDMDL\n" for n in (1, 2)) + "END\n")
    (folder / "e.pdb").write_text(f"REMARK\n{model}END\n")
    (folder / "list.csv").write_text("path\ne.pdb\n")
    with Chem.SDWriter(str(folder / "poses.sdf")) as poses:
        for _ in range(2):
            at.SetAtomPosition(0, Point3D(*(at.GetPositions()[0] + 0.02)))
            poses.write(ethanol)
    with pytest.MonkeyPatch.context() as there:
        there.chdir(folder)
        for name, ligands in (("x.dcd", ()), ("ligand.dcd", "LIG=CCO")):
            structure = pc.load("c.pdb", ligands=ligands)
            frames = TrajectoryFile(folder / name, structure)
            for _ in range(2):
                frames.append(structure.positions)
            frames.finish()
        run(
            "minimise",
            "c.pdb",
            *QUICK.split(),
            *LIGAND.split(),
            "--checkpoint",
            "state.npz",
            "-o",
            folder / "end.pdb",
        )
        run("minimise", "p.pdb", *QUICK.split(), "-o", folder / "q.pdb")
    (folder / "end.pdb").unlink()
    return folder


@pytest.fixture
def here(made, tmp_path, monkeypatch):
    """In a folder with those files; processes are calls, which show for how long and by how many."""
    arrived = []

    class Calls:
        def submit(self, call, job, threads, time_limit):
            arrived.append((threads, time_limit))
            done = Future()
            done.set_result([*job.run(threads)])
            return done

    @contextmanager
    def crew(count):
        arrived.append(count)
        yield Calls()

    monkeypatch.setattr(cluster, "crew", crew)
    monkeypatch.setattr(cluster, "started_early", lambda count, threads: nullcontext())
    return SimpleNamespace(arrived=arrived, made=made, folder=tmp_path / "here", chdir=monkeypatch.chdir)


TIMED = {"equal_cost.csv"}
CLOCK = re.compile(r"seconds|timings|per_day|^key$")


def plain(value):
    """Values without those of a clock."""
    if isinstance(value, dict):
        return {name: plain(its) for name, its in value.items() if not CLOCK.search(name)}
    return [*map(plain, value)] if isinstance(value, list) else value


def content(path):
    text = path.read_bytes().replace(str(path.parent).encode(), b"")
    if path.suffix == ".json":
        return plain(json.loads(text))
    if path.suffix == ".csv":
        return plain([*csv.DictReader(io.StringIO(text.decode()))])
    if path.suffix == ".dcd":
        return text[300:]  # The head has a date.
    return text if path.suffix in (".pdb", ".sdf") else None


def outcome(here, capsys, words, before=()):
    """What a command comes to, perhaps after another: status, what it prints, files, who does its jobs."""
    shutil.rmtree(here.folder, ignore_errors=True)
    shutil.copytree(here.made, here.folder)
    here.chdir(here.folder)
    if before:
        with suppress(SystemExit):
            run(*before)
        capsys.readouterr()
    here.arrived.clear()
    try:
        status = run(*words)
    except ProtochainError as error:
        return BAD_INPUT, message_of(error)
    except TyperException as error:
        return BAD_INPUT, error.format_message()
    except SystemExit as error:
        status = error.code
    said = [re.sub(r"\b[\d.]+ s\b", "", each.replace(str(here.folder), "")) for each in capsys.readouterr()]
    if said[0].startswith("{"):
        said[0] = plain(json.loads(said[0]))
    made = [
        each for each in sorted(here.folder.rglob("*"))
        if each.is_file() and not (here.made / each.name).exists() and not each.name.startswith(".")
    ]  # fmt: skip
    files = {
        each.relative_to(here.folder).as_posix(): content(each) for each in made if each.name not in TIMED
    }
    return status, said, files, [*here.arrived]


@pytest.fixture
def read(monkeypatch):
    """Names of the settings of preparation that are read, but for those who only check or copy them."""
    names, own = set(), Setup.__getattribute__
    fields = {name for name, _ in settings_of(Setup)}

    def get(self, name):
        by = sys._getframe(1).f_code.co_filename
        if name in fields and not by.endswith(("dataclasses.py", "checks.py", "settings.py", "copy.py")):
            names.add(name)
        return own(self, name)

    monkeypatch.setattr(Setup, "__getattribute__", get)
    return names


@pytest.mark.parametrize("path", PATHS)
def test_no_option_is_ignored(path, here, read, capsys):
    words = [path.split()[0], *PATHS[path].split()]
    usual = outcome(here, capsys, [*words, "--json"])
    used = {*read} | {its.word[0] for name, its in settings_of(Setup) if its.word and name in read}
    assert usual[0] in (None, 0, 3), usual
    assert outcome(here, capsys, [*words, "--json"]) == usual  # or no change would show an effect
    ignored = []
    for option in COMMANDS[words[0]].params:
        if not isinstance(option, TyperOption) or option.name in used or option.name in LATER:
            continue
        its, other = given(path, option), usual
        if " ".join(its) in PATHS[path]:
            continue
        if option.name == "as_json":
            found = outcome(here, capsys, words)
        elif option.name == "timings":  # With --json they are among the rest in any case.
            other, found = (outcome(here, capsys, [*words, *more]) for more in ((), its))
        elif (option.name, path) in WITHOUT_EFFECT:
            continue
        elif option.name == "force":  # In the place of its own input, or of a folder of results.
            is_folder = words[0] in ("simulate", "compare", "search", "batch") or path in MANY
            over = [*words, "--json"] if is_folder else [*words, "--json", "-o", words[1]]
            other, found = (
                outcome(here, capsys, each, over if is_folder else ()) for each in (over, [*over, *its])
            )
        else:
            found = outcome(here, capsys, [*words, "--json", *its])
        if found == other or (found[0] == BAD_INPUT and option.opts[0].lstrip("-") not in str(found[1])):
            ignored.append((its, found[1] if found != other else ""))
    assert not ignored
