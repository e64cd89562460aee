"""Code of the pages: each block runs as it stands, after those before it, or is marked a sketch."""

import gzip
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import gemmi
import numpy as np
import pytest
from fixtures.frames import models, saved, shaken
from fixtures.samples import ROOT, STRUCTURES, load
from fixtures.texts import fenced
from rdkit import Chem
from rdkit.Chem import AllChem

import protochain as pc

PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "analysis").rglob("*.md"))]
LANGUAGES = {"python", "sh"}
COMMAND = re.compile(r"^(?:protochain|pip|python3?|pytest|find|export|dask|for|import|from) ", re.MULTILINE)
SYNOPSIS = ROOT / "analysis" / "docs" / "commands.md"
"""Has its own tests, in test_docs.py."""
QUICK = {"README.md-python", "analysis/docs/ten-minutes.md-python"}
"""Scripts that the fast tests run: what readers type first."""


def scripts():
    """Blocks of a page in a language, joined: as a reader types them one after the other in a folder.

    Sections with a slow block are left to the slow tests, which run the whole page.
    """
    for page in PAGES:
        for language in sorted(LANGUAGES):
            its = [each for each in fenced(page) if each.language == language and each.mark != "sketch"]
            slow = {each.heading for each in its if each.mark == "slow"}
            quick = [each for each in its if each.heading not in slow]
            name = f"{page.relative_to(ROOT)}-{language}"
            if quick:
                marks = () if name in QUICK else pytest.mark.slow
                yield pytest.param(language, "\n".join(each.text for each in quick), id=name, marks=marks)
            if slow:
                text = "\n".join(each.text for each in its)
                yield pytest.param(language, text, id=f"{name}-slow", marks=pytest.mark.slow)


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    """The files that the commands of pages name, small ones."""
    folder = tmp_path_factory.mktemp("inputs")
    (folder / "structures").symlink_to(STRUCTURES)
    (folder / "analysis").symlink_to(ROOT / "analysis")
    mini, short, insulin = load("1l2y.pdb"), load("ala10.pdb"), load("3i40.pdb")
    for name in ("model", "model1", "relaxed", "native", "top", "protein"):
        pc.save(mini, folder / f"{name}.pdb")
    for name in ("complex", "design"):
        pc.save(insulin, folder / f"{name}.pdb")
    pc.save(mini, folder / "model2.cif")
    saved(mini, shaken(mini, 2), folder / "samples.xtc")
    saved(insulin, shaken(insulin, 2), folder / "run.xtc")
    for name in ("ensemble", "nmr"):
        models(short, shaken(short, 2), folder / f"{name}.pdb")
    boltz = folder / "predictions" / "boltz_results_a" / "predictions" / "a"
    for its in (boltz, *(folder / name for name in ("models", "more", "designs"))):
        its.mkdir(parents=True)
    pc.save(short, boltz / "a_model_0.cif")
    pc.save(short, folder / "predictions" / "a_unrelaxed_rank_001.pdb")
    pc.save(short, folder / "models" / "a.pdb")
    pc.save(insulin, folder / "designs" / "a.pdb")
    for packed in (folder / "model.cif.gz", folder / "more" / "b.cif.gz"):
        packed.write_bytes(gzip.compress((boltz / "a_model_0.cif").read_bytes()))
    (folder / "work.csv").write_text("path\nmodels/a.pdb\n")
    atoms = (folder / "models" / "a.pdb").read_text().splitlines()
    bare = [line for line in atoms if line[:4] != "ATOM" or line[12:16].strip() in ("N", "CA", "C", "O")]
    (folder / "backbone.pdb").write_text("\n".join(bare))
    of = []
    for k, chain in enumerate("HLA"):
        for line in atoms:
            if line[:4] == "ATOM":
                of.append(f"{line[:21]}{chain}{line[22:30]}{float(line[30:38]) + 9 * k:8.3f}{line[38:]}")
        of.append("TER")
    (folder / "antibody.pdb").write_text("\n".join([*of, "END\n"]))
    pc.save(pc.load(folder / "antibody.pdb"), folder / "antibody.cif")
    with_ligand(folder, "protein", "GOL", "OCC(O)CO", "complex.cif")
    with_ligand(folder, "complex", "GOL", "OCC(O)CO", "pocket.cif")
    with_ligand(folder, "protein", "LIG3", "CC(=O)NCCS", "model.cif")
    return folder


def with_ligand(folder, of, name, smiles, output):
    """Write a file of a protein with a ligand without hydrogens beside it, whose pose is in pose.sdf."""
    molecule = Chem.AddHs(Chem.MolFromSmiles(smiles))
    AllChem.EmbedMolecule(molecule, randomSeed=1)
    protein = gemmi.read_structure(str(folder / f"{of}.pdb"))
    x = molecule.GetConformer().GetPositions()
    residues = [residue for chain in protein[0] for residue in chain]
    far = max((atom.pos.tolist() for each in residues for atom in each), key=lambda place: place[0])
    x += np.array(far) - x[np.argmin(x[:, 0])] + [3.0, 0.0, 0.0]
    for k, place in enumerate(x):
        molecule.GetConformer().SetAtomPosition(k, place)
    heavy = Chem.RemoveHs(molecule)
    Chem.MolToMolFile(heavy, str(folder / "pose.sdf"))
    residue = gemmi.Residue()
    residue.name, residue.seqid, residue.het_flag = name, gemmi.SeqId("1"), "H"
    for atom, place in zip(heavy.GetAtoms(), heavy.GetConformer().GetPositions(), strict=True):
        its = gemmi.Atom()
        its.name, its.element = f"{atom.GetSymbol()}{atom.GetIdx() + 1}", gemmi.Element(atom.GetSymbol())
        its.pos = gemmi.Position(*place)
        residue.add_atom(its)
    chain = gemmi.Chain("L")
    chain.add_residue(residue)
    protein[0].add_chain(chain)
    protein.setup_entities()
    protein.make_mmcif_document().write_file(str(folder / output))


@pytest.mark.parametrize(("language", "script"), list(scripts()))
def test_it_runs_as_it_stands(language, script, inputs, tmp_path):
    """In a folder that has nothing of the checkout but its structures."""
    place = tmp_path / "place"
    shutil.copytree(inputs, place, symlinks=True)
    command = [sys.executable, "-"] if language == "python" else ["bash", "-e", "-o", "pipefail"]
    path = os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"]))
    done = subprocess.run(
        command, cwd=place, capture_output=True, text=True, input=script,
        env=os.environ | {"MPLBACKEND": "Agg", "PYTHONPATH": str(ROOT), "PATH": path},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_code_says_its_language(page):
    """Else it would not be run."""
    for block in fenced(page):
        if block.language not in LANGUAGES and page != SYNOPSIS:
            assert not COMMAND.search(block.text), block.text
