"""lDDT by its definition, atom by atom, and against biotite; names that may be exchanged; what is missing."""

import sys

import numpy as np
import pytest
from fixtures.molecules import shaken
from fixtures.refusals import expect_refusal
from fixtures.samples import load, shared
from fixtures.tolerances import RMSD_ANGSTROM
from scipy.spatial.transform import Rotation

import protochain as pc
from protochain.comparison.deviation import deviation
from protochain.core.arrays import means_by
from protochain.core.errors import Fault
from protochain.validation import LIKENESS, likeness
from protochain.validation.likeness import _TWINS

MODULE = sys.modules["protochain.validation.likeness"]
"""Its name in the package is that of the function."""


def slow_lddt(structure, reference, names=None):
    """By definition, for structures of the same atoms: mean over pairs, and by residue of the reference."""
    x, y = 10.0 * structure.positions, 10.0 * reference.positions
    chosen = [
        k
        for k in range(len(x))
        if reference.atom_element[k] != "H" and (not names or reference.atom_name[k] in names)
    ]
    of, kept = reference.atom_residue, []
    for n, i in enumerate(chosen):
        for j in chosen[n + 1 :]:
            was = np.linalg.norm(y[i] - y[j])
            if of[i] != of[j] and was < 15.0:
                off = abs(np.linalg.norm(x[i] - x[j]) - was)
                kept.append((of[i], of[j], np.mean([off <= limit for limit in (0.5, 1.0, 2.0, 4.0)])))
    by = [np.mean([k for a, b, k in kept if r in (a, b)]) for r in range(reference.n_residues)]
    return np.mean([k for *_, k in kept]), by


@pytest.mark.parametrize("size", [0.02, 0.1, 0.3])
def test_lddt_is_its_definition(size, monkeypatch):
    s = load("1l2y.pdb")
    monkeypatch.setattr(MODULE, "_TWINS", {})
    moved = shaken(s, size)
    found = likeness(moved, s)
    whole, by = slow_lddt(moved, s)
    assert 0.2 < whole < 0.99
    assert found.measures["lddt"] == pytest.approx(whole) and found.lddt == pytest.approx(by)
    assert found.measures["lddt_ca"] == pytest.approx(slow_lddt(moved, s, {"CA"})[0])
    assert list(found.measures) == list(LIKENESS)


def test_the_open_and_the_closed_enzyme_are_as_alike_as_biotite_says(monkeypatch):
    """biotite 1.6.0, of atoms of different residues, each atom once, names as they are."""
    closed, opened = pc.load(shared("1ake_A.pdb")), pc.load(shared("4ake_A_H.pdb"))
    alike = likeness(opened, closed).measures
    assert alike["lddt_ca"] == pytest.approx(0.7537218413, abs=1e-9)
    monkeypatch.setattr(MODULE, "_TWINS", {})
    as_named = likeness(opened, closed).measures
    assert as_named["lddt"] == pytest.approx(0.6962681743, abs=1e-9) and alike["lddt"] > as_named["lddt"]
    # Each is compared with distances of the reference.
    assert likeness(closed, opened).measures["lddt"] != pytest.approx(as_named["lddt"], abs=0.01)
    off = deviation(closed, opened)
    assert alike["ca_rmsd_to_reference_angstrom"] == pytest.approx(off.rmsd, abs=RMSD_ANGSTROM)
    assert alike["tm_score"] == off.tm_score and alike["matched_percent"] == 100.0


def test_a_copy_that_was_moved_is_the_same():
    s = load("1ubq.pdb")
    turn = Rotation.from_rotvec([0.3, -0.2, 0.9]).as_matrix()
    found = likeness(s.with_positions(s.positions @ turn.T + 2.0), s)
    assert found.measures["lddt"] == found.measures["lddt_ca"] == 1.0 and (found.lddt == 1.0).all()
    for key in ("ca_rmsd_to_reference_angstrom", "heavy_rmsd_to_reference_angstrom"):
        assert found.measures[key] == pytest.approx(0.0, abs=1e-6)


def exchanged(s, r):
    """Positions with the twins of a residue in each other's place."""
    x = s.positions.copy()
    at = {str(s.atom_name[k]): k for k in np.flatnonzero(s.atom_residue == r)}
    for a, b in _TWINS[str(s.residue_name[r])].items():
        x[[at[a], at[b]]] = x[[at[b], at[a]]]
    return x


def test_names_that_mean_nothing_may_be_exchanged_and_no_others():
    s = load("1ubq.pdb")
    kinds = {str(s.residue_name[r]): r for r in range(s.n_residues)}
    assert {*_TWINS} == {"ARG", "ASP", "GLU", "LEU", "PHE", "TYR", "VAL"} <= kinds.keys()
    for kind in _TWINS:
        found = likeness(s.with_positions(exchanged(s, kinds[kind])), s).measures
        assert found["lddt"] == 1.0 and found["heavy_rmsd_to_reference_angstrom"] < 1e-6, kind
    r = kinds["ASN"]
    x = s.positions.copy()
    pair = [int(np.flatnonzero((s.atom_residue == r) & (s.atom_name == name))[0]) for name in ("OD1", "ND2")]
    x[pair] = x[pair[::-1]]
    assert likeness(s.with_positions(x), s).measures["lddt"] < 1.0


def test_what_is_missing_keeps_no_distance(tmp_path):
    s = load("1l2y.pdb")
    pc.save(s, tmp_path / "whole.pdb")
    lines = (tmp_path / "whole.pdb").read_text().splitlines(keepends=True)

    def without(name, drop):
        (tmp_path / name).write_text(
            "".join(line for line in lines if not (line.startswith("ATOM") and drop(line)))
        )
        return pc.load(tmp_path / name)

    whole = pc.load(tmp_path / "whole.pdb")
    backbone = ("N", "CA", "C", "O", "CB")
    # A side chain, which preparation builds anew, and three residues.
    trp = without(
        "side.pdb",
        lambda line: line[17:20] == "TRP" and line[12:16].strip() not in backbone,
    )
    found = likeness(trp, whole)
    gone = (whole.residue_name == "TRP").argmax()
    assert found.measures["lddt"] < 0.9 and found.measures["lddt_ca"] == 1.0
    assert found.lddt[gone] < 0.6 and found.measures["heavy_rmsd_to_reference_angstrom"] < 1e-3
    # Of the reference, it does not count.
    assert likeness(whole, trp).measures["lddt"] == 1.0
    short = without("short.pdb", lambda line: int(line[22:26]) > 17)
    cut = likeness(short, whole)
    assert cut.measures["matched_percent"] == 85.0 and 0.5 < cut.measures["lddt"] < 0.95
    longer = likeness(whole, short)
    assert longer.measures["lddt"] > 0.99 and np.isnan(longer.lddt[17:]).all()


def test_a_reference_of_c_alphas_alone_is_enough():
    ubiquitin = pc.validate(load("1ubq.pdb"), reference=shared("ubiquitin_ca_only.pdb"))
    values = ubiquitin.measures
    assert values["lddt"] == values["lddt_ca"] > 0.5 and values["matched_percent"] > 90.0
    assert values["ca_rmsd_to_reference_angstrom"] == values["heavy_rmsd_to_reference_angstrom"]
    with expect_refusal(fault=Fault.ONLY_ALPHA):
        pc.validate(shared("ubiquitin_ca_only.pdb"))


def test_a_residue_without_pairs_has_no_share_of_them():
    found = means_by(np.array([0, 1, 1, 0]), np.array([1.0, 1.0, 0.0, 0.0]), 3)
    assert found[:2].tolist() == [0.5, 0.5] and np.isnan(found[2])
