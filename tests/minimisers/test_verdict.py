"""Verdicts and judgements by hand."""

from dataclasses import replace

import numpy as np
import pytest
from fixtures.samples import STRUCTURES, chain, load

import protochain as pc
from protochain.chains.chain import pose, pull_back
from protochain.chains.contacts import overlaps
from protochain.minimisers.loop import Stop
from protochain.minimisers.verdict import Status, describe_rejections, judge, rebuilt, verdict
from protochain.validation.findings import describe_remains, remains

OTHERS = {Stop.BUDGET: "budget", Stop.NON_FINITE: "non-finite", Stop.INTERRUPTED: "interrupted"}
"""Statuses of runs that did not stall."""


@pytest.mark.parametrize("stop", Stop)
def test_a_verdict_is_of_the_reason_and_of_what_the_judge_measured(stop):
    s = load("ala10.pdb")
    status, message = verdict(stop, False, "so far", s, s.positions, 7)
    assert status == OTHERS.get(stop, "stalled") and message.startswith(status) and message.endswith("so far")
    met = Status.SADDLE if stop is Stop.SADDLE else Status.CONVERGED
    assert verdict(stop, True, "so far", s, s.positions, 7)[0] is met


@pytest.mark.parametrize("met", [True, False])
@pytest.mark.parametrize("stop", Stop)
def test_an_overlap_is_a_clash_whatever_else(stop, met):
    s = load("ala10.pdb")
    x = s.positions.copy()
    x[-1] = x[0] + [0.03, 0.0, 0.0]
    worst, *others = overlaps(s, x)
    assert others
    status, message = verdict(stop, met, "so far", s, x, 7)
    assert status == ("interrupted" if stop is Stop.INTERRUPTED else "clash")
    assert (str(worst) in message) == (status == "clash")


def test_restraints_count_in_the_residuals_of_a_judgement_only():
    c = chain("ala10.pdb")
    rng = np.random.default_rng(0)
    forces, pull = rng.normal(size=(2, c.structure.n_atoms, 3))
    at = pose(c, c.q0)
    for restraint, total in ((None, forces), (lambda x: (3.0, pull), forces + pull)):
        found = judge(c, at, (-5.0, forces), restraint)
        assert found.energy == -5.0
        assert found.rms_force == pytest.approx(np.sqrt(np.mean(total**2)), rel=1e-12)
        assert found.max_torque == pytest.approx(np.abs(pull_back(c, at, total)).max(), rel=1e-12)


def test_a_chain_rebuilt_elsewhere_has_the_same_hinges_root_and_selection():
    c = pc.build_chain(load("ala10.pdb"), "phi psi", "free")
    assert c.root == "free"
    x = 1.01 * c.structure.positions
    moved = rebuilt(c, x)
    assert np.array_equal(moved.structure.positions, x)
    assert (moved.opened, moved.root, moved.move, moved.n_v) == (c.opened, c.root, c.move, c.n_v)
    part = pc.build_chain(load("ala10.pdb"), move="resid 3:6")
    assert (rebuilt(part, x).move, rebuilt(part, x).n_v) == ("resid 3:6", part.n_v)


# --- What no result may have, though forces vanish


def judged(structure, x=None):
    return verdict(Stop.TOLERANCE, True, "so far", structure, structure.positions if x is None else x, 7)


def test_a_stereocentre_that_was_inverted_at_the_start_is_no_converged_result():
    """By reflection: the plane of N, C-alpha and C mirrors C-beta and H-alpha, and phi stays that of L."""
    s = load("ala10.pdb")
    x, of = s.positions.copy(), s.atom_residue == 4
    at = {str(s.atom_name[i]): i for i in np.flatnonzero(of)}
    n, alpha, c = (x[at[name]] for name in ("N", "CA", "C"))
    normal = np.cross(n - alpha, c - alpha)
    normal /= np.linalg.norm(normal)
    side = [i for name, i in at.items() if name not in ("N", "H", "C", "O", "CA")]
    x[side] -= 2.0 * np.outer((x[side] - alpha) @ normal, normal)
    changed = s.with_positions(x)
    named = "inverted stereocentres: CA of A:ALA5"
    assert judged(changed) == (Status.VIOLATIONS, f"violations: {named}; so far")
    assert describe_rejections(changed, x) == [named] and describe_rejections(s, s.positions) == []
    # What the message names is printed once; that of a clash does not name it.
    lines = {each: describe_remains(remains(changed, x) | {"status": each}) for each in Status}
    assert [each for each, its in lines.items() if named in "".join(its)] == [Status.CLASH]
    # What a run itself inverts is another matter.
    assert judged(s, x)[0] is Status.INVERTED


def test_a_protein_of_which_most_stands_still_is_not_converged():
    s = load("1l2y.pdb")
    for n, expected in ((10, Status.CONVERGED), (11, Status.VIOLATIONS)):
        fixed = replace(s, obstacle=s.atom_residue >= s.n_residues - n)
        status, message = judged(fixed)
        assert status is expected and (f"{n} of 20 residues" in message) == (n == 11)
        held = remains(fixed, fixed.positions)["fixed_residues"]
        assert held == [fixed.describe_residue(r) for r in range(20 - n, 20)]


def test_a_double_bond_of_the_other_kind_is_no_converged_result(tmp_path):
    """Of 2-butenoic acid in its E form under the Z form's SMILES; RDKit, which made it, is the oracle."""
    chem = pytest.importorskip("rdkit.Chem.AllChem")
    made = chem.AddHs(chem.MolFromSmiles("OC(=O)/C=C/C"))
    assert chem.EmbedMolecule(made, randomSeed=7) == 0
    x, protein = made.GetConformer().GetPositions(), 10.0 * load("1l2y.pdb").positions
    x += [protein[:, 0].max() + 3.0 - x[:, 0].min(), *(protein.mean(0) - x.mean(0))[1:]]
    lines = (STRUCTURES / "1l2y.pdb").read_text().splitlines()
    lines = [line for line in lines if line.startswith("ATOM")][:304]
    for atom in list(made.GetAtoms())[:6]:
        place, name = x[atom.GetIdx()], f"{atom.GetSymbol()}{atom.GetIdx()}"
        at = "".join(f"{each:8.3f}" for each in place)
        lines.append(
            f"HETATM{900 + atom.GetIdx():5d}  {name:<3} LIG A 101    {at}  1.00  0.00           {name[0]}"
        )
    (tmp_path / "lig.pdb").write_text("\n".join([*lines, "END"]))
    for smiles, wrong in (("OC(=O)/C=C/C", []), ("OC(=O)/C=C\\C", ["C3=C4 of A:LIG101"])):
        s = pc.load(tmp_path / "lig.pdb", ligands=[f"LIG={smiles}"])
        assert remains(s, s.positions)["inverted_double_bonds"] == wrong
        assert judged(s)[0] is (Status.VIOLATIONS if wrong else Status.CONVERGED)
        assert pc.validate(s, posebusters=False).measures["other_double_bonds"] == len(wrong)
