"""Models that lack the first residues, and differ in one place: it is found by every comparison."""

import numpy as np
import pandas as pd
import pytest
from fixtures.command_line import run
from fixtures.samples import STRUCTURES, load

import protochain as pc
from protochain.validation.likeness import likeness

WHOLE, FIRST, MOVED = "1l2y.pdb", 5, 12
"""Trp-cage, the first residue of the model, and the residue whose atoms are 2 angstrom away."""


@pytest.fixture(scope="module")
def cropped(tmp_path_factory):
    """The model turned as a whole, without its first residues, and with one residue moved."""
    s = load(WHOLE)
    x = s.positions.copy()
    x[s.residue_number[s.atom_residue] == str(MOVED)] += [0.0, 0.2, 0.0]
    path = tmp_path_factory.mktemp("cropped") / "model.pdb"
    pc.save(s.with_positions(x @ np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1.0]])), path)
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join(k for k in lines if not (k.startswith("ATOM") and int(k[22:26]) < FIRST)))
    return path


def test_differences_name_the_residue_that_moved(cropped):
    for before, after in ((load(WHOLE), cropped), (cropped, load(WHOLE))):
        rows = pc.differences(before, after).residues
        assert rows["residue"].tolist() == [str(k) for k in range(FIRST, 21)]
        assert rows["ca_moved_angstrom"].idxmax() == MOVED - FIRST
        assert rows["name"].tolist() == load(WHOLE).residue_name[FIRST - 1 :].tolist()
        far = rows[(rows["residue"].astype(int) - MOVED).abs() > 1]
        assert far["torsions_degrees"].max() < 0.1 < rows["torsions_degrees"].max()


def test_likeness_of_residues_is_lowest_where_one_moved(cropped):
    s, model = load(WHOLE), pc.load(cropped)
    assert int(np.nanargmin(likeness(model, s).lddt)) == MOVED - FIRST
    whole = likeness(s, model)
    assert int(np.nanargmin(whole.lddt)) == MOVED - 1
    assert np.isnan(whole.lddt[: FIRST - 1]).all() and np.isfinite(whole.lddt[FIRST - 1 :]).all()


def test_rmsds_are_of_the_residues_of_both(cropped):
    s, model = load(WHOLE), pc.load(cropped)
    fixed = f"name CA and not resid {MOVED}"
    assert pc.rmsd(s, model, fixed) < 1e-3
    assert pc.rmsd(s, model, fixed, f"name CA and resid {MOVED}") == pytest.approx(2.0, abs=1e-3)


def test_modes_overlap_with_the_change_of_the_residues_of_both(cropped):
    """As with a model that has all residues, whose other residues are in place."""
    s = load(WHOLE)
    modes = pc.normal_modes(pc.build_chain(s, "phi psi"), pc.energy(s, solvent="vacuum", threads=1), k=4)
    model = pc.load(cropped)
    partial, change = modes._modes_and_change(model)
    assert partial.shape == (4, 3 * (21 - FIRST))
    assert np.linalg.norm(change.reshape(-1, 3), axis=1).argmax() == MOVED - FIRST
    one, all_modes = modes.overlap(model), modes.cumulative_overlap(model)
    # Displacements of modes are not orthogonal: the share that all span is of their projector.
    projector = partial.T @ np.linalg.pinv(partial.T)
    assert all_modes[-1] == pytest.approx(np.linalg.norm(projector @ change), abs=1e-9)
    assert all_modes[0] == pytest.approx(one[0]) and not np.isclose(all_modes[-1], np.linalg.norm(one))


def test_tables_of_residues_have_their_numbers(cropped, tmp_path):
    table = tmp_path / "r.csv"
    assert run("validate", cropped, "--reference", STRUCTURES / WHOLE, "--residues", table) == 0
    rows = pd.read_csv(table)
    assert rows["residue"].tolist() == [*range(FIRST, 21)]
    assert rows["lddt"].idxmin() == MOVED - FIRST
