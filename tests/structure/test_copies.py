"""Models that are rigid copies, as of assemblies in the PDB format; molecules that have no hinges."""

import numpy as np
import pytest
from fixtures.samples import load

import protochain as pc
from protochain.structure.molecule.repairs import Kind
from protochain.structure.write import as_text

LINES = [line for line in as_text(load("1l2y.pdb"), ".pdb").splitlines() if line.startswith("ATOM")]
X = np.array([[float(line[k : k + 8]) for k in (30, 38, 46)] for line in LINES])
ALL = Kind.MODELS_ARE_COPIES, Kind.MODELS_LEFT_OUT
NMA = """HETATM    1  CH3 ACE A   1       2.000   2.090   0.000  1.00  0.00           C
HETATM    2  C   ACE A   1       3.427   2.641   0.000  1.00  0.00           C
HETATM    3  O   ACE A   1       4.391   1.877   0.000  1.00  0.00           O
HETATM    4  N   NME A   2       3.555   3.970   0.000  1.00  0.00           N
HETATM    5  CH3 NME A   2       4.853   4.614   0.000  1.00  0.00           C
TER
END
"""


def turned(angle, shift):
    c, s = np.cos(angle), np.sin(angle)
    return X @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]).T + shift


def written(path, *models):
    lines = []
    for number, x in enumerate(models, 1):
        atoms = ["".join(f"{value:8.3f}" for value in row) for row in x]
        body = [f"{line[:30]}{at}{line[54:]}" for line, at in zip(LINES, atoms, strict=True)]
        lines += [f"MODEL     {number:4d}", *body, "TER", "ENDMDL"]
    path.write_text("\n".join([*lines, "END", ""]))
    return path


@pytest.mark.parametrize("n", [2, 4])
def test_copies_are_reported_and_joined(n, tmp_path):
    places = [turned(2 * np.pi * k / n, [40.0 * k, 0.0, 0.0]) for k in range(n)]
    path = written(tmp_path / "x.pdb", *places)
    s = pc.load(path)
    (repair,) = [repair for repair in s.repairs if repair.kind in ALL]
    assert repair.kind is Kind.MODELS_ARE_COPIES and repair.facts["count"] == n - 1
    joined = pc.load(path, assembly="models")
    assert joined.n_residues == 20 * n and len({*joined.residue_chain.tolist()}) == n
    assert joined.left_out == {} and joined.losses == ()
    # A file with all chains in one model is the reference.
    assert 10.0 * joined.positions == pytest.approx(np.vstack(places), abs=6e-4)


@pytest.mark.parametrize("other", [X, X + 1.5, X + 40.0 + 0.3 * np.sin(np.arange(X.size)).reshape(X.shape)])
def test_frames_and_conformers_are_not_copies(other, tmp_path):
    s = pc.load(written(tmp_path / "x.pdb", X, other))
    assert [repair.kind for repair in s.repairs if repair.kind in ALL] == [Kind.MODELS_LEFT_OUT]


def test_one_model_has_nothing_to_join(tmp_path):
    with pytest.raises(pc.ProtochainError, match="has one model"):
        pc.load(written(tmp_path / "x.pdb", X), assembly="models")


@pytest.mark.parametrize("method", ["cartesian", "lbfgs"])
def test_a_molecule_without_hinges_is_minimised(method, tmp_path):
    """ACE-NME has no phi, psi or chi; the rigid body has no torque in vacuum, the atoms move."""
    path = tmp_path / "x.pdb"
    path.write_text(NMA)
    c = pc.build_chain(path)
    assert (c.n_hinges, c.n_q) == (0, 7)
    r = pc.minimise(c, method=method)
    assert str(r.status) == "converged"
    assert (r.start.energy - r.end.energy > 1.0) == (method == "cartesian")


@pytest.mark.parametrize(
    ("head", "is_model"), [("PARENT N/A", True), ("PFRMAT TS\nPARENT N/A", False), ("", False)]
)
def test_a_parent_record_marks_a_prediction(head, is_model, tmp_path):
    path = tmp_path / "x.pdb"
    path.write_text("\n".join([head, *LINES, "TER", "END", ""]))
    assert ("_ma_qa_metric." in pc.load(path).header) == is_model
