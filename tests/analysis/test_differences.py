"""What changed between two structures: identities, and mdtraj as the oracle."""

import mdtraj
import numpy as np
import pytest
from fixtures.samples import STRUCTURES, load

import protochain as pc
from protochain.analysis.differences import TORSIONS


@pytest.fixture(scope="module")
def ubiquitin():
    return load("1ubq.pdb")


def turned(structure, kind, residue, degrees):
    """The structure with one hinge turned."""
    chain = pc.build_chain(structure, "phi psi chi")
    (k,) = (
        k for k, hinge in enumerate(chain.hinges)
        if hinge.kind == kind and hinge.residue_number == residue
    )  # fmt: skip
    q = chain.q0.copy()
    q[len(q) - chain.n_hinges + k] += np.deg2rad(degrees)
    return structure.with_positions(pc.pose(chain, q).x)


def test_nothing_changes_from_a_structure_to_itself_moved(ubiquitin):
    moved = ubiquitin.with_positions(ubiquitin.positions @ np.diag([-1.0, -1.0, 1.0]) + 3.0)
    found = pc.differences(ubiquitin, moved)
    assert found.residues["torsions_degrees"].max() < 1e-6 and found.bonds.empty
    assert found.residues["ca_moved_angstrom"].max() < 1e-6
    assert found.totals["contacts_kept"] == 1.0 and found.totals["rotamers_changed"] == 0


@pytest.mark.parametrize(("kind", "residue", "degrees"), [("chi1", "7", 120.0), ("psi", "20", -95.0),
                                                         ("phi", "52", 170.0)])  # fmt: skip
def test_a_hinge_that_turned_is_the_one_torsion_that_changed(ubiquitin, kind, residue, degrees):
    found = pc.differences(ubiquitin, turned(ubiquitin, kind, residue, degrees)).residues
    change = found.loc[found["residue"] == residue, kind].item()
    assert change == pytest.approx(degrees, abs=1e-6)
    others = found[list(TORSIONS)].abs().to_numpy(copy=True)
    others[(found["residue"] == residue).to_numpy(), TORSIONS.index(kind)] = 0.0
    assert np.nanmax(others) < 1e-6


def test_a_rotamer_that_changed_is_counted_and_half_a_turn_of_a_ring_is_none(ubiquitin):
    found = pc.differences(ubiquitin, turned(ubiquitin, "chi1", "7", 120.0))
    assert found.totals["rotamers_changed"] == 1
    changed = found.residues[found.residues["rotamer_before"] != found.residues["rotamer_after"]]
    assert changed["residue"].tolist() == ["7"]
    flipped = pc.differences(ubiquitin, turned(ubiquitin, "chi2", "59", 180.0))
    assert flipped.residues["torsions_degrees"].max() < 1e-6


def test_hydrogen_bonds_gained_and_lost_are_mdtrajs(ubiquitin):
    after = turned(ubiquitin, "psi", "35", 60.0)

    def bonds(s):
        of = s.atom_residue
        found = mdtraj.baker_hubbard(pc.to_mdtraj(s), periodic=False)
        return {(of[d], of[a]) for d, _, a in found if of[d] != of[a]}

    mine, theirs = bonds(ubiquitin), bonds(after)
    found = pc.differences(ubiquitin, after)
    assert found.totals["hydrogen_bonds_lost"] == len(mine - theirs) > 0
    assert found.totals["hydrogen_bonds_gained"] == len(theirs - mine)
    assert found.totals["hydrogen_bonds_kept"] == len(mine & theirs)
    told = found.bonds[found.bonds["kind"] == "hydrogen bond"]
    assert (told["change"] == "lost").sum() == len(mine - theirs)
    back = pc.differences(after, ubiquitin)
    assert back.totals["hydrogen_bonds_gained"] == found.totals["hydrogen_bonds_lost"]
    assert 0.0 < found.totals["contacts_kept"] < 1.0


def test_secondary_structure_is_dssps_and_its_parts_are_superposed_by_themselves(ubiquitin):
    found = pc.differences(ubiquitin, turned(ubiquitin, "psi", "35", 60.0))
    codes = mdtraj.compute_dssp(pc.to_mdtraj(ubiquitin))[0]
    named = found.residues["secondary_structure"].map({"helix": "H", "strand": "E", "loop": "C"})
    assert named.tolist() == codes.tolist()
    assert found.totals["ca_rmsd_angstrom_helix"] < found.totals["ca_rmsd_angstrom"]
    assert found.totals["ca_rmsd_angstrom_A"] == pytest.approx(found.totals["ca_rmsd_angstrom"], rel=1e-12)


def test_a_salt_bridge_that_was_broken_is_lost(ubiquitin):
    far = turned(ubiquitin, "chi1", "11", 180.0)
    found = pc.differences(ubiquitin, far).totals
    bridges = pc.differences(ubiquitin, ubiquitin).totals["salt_bridges_kept"]
    assert found["salt_bridges_kept"] + found["salt_bridges_lost"] == bridges
    assert found["salt_bridges_lost"] > 0


def test_the_command_writes_the_changes_from_the_reference(tmp_path, capsys):
    from protochain.cli import app

    table = tmp_path / "changes.csv"
    path = str(STRUCTURES / "ala10.pdb")
    app(["validate", path, "--reference", path, "--changes", str(table)], standalone_mode=False)
    assert len(table.read_text().splitlines()) == 11
    assert "0 rotamers changed" in capsys.readouterr().out


def test_the_figure_has_a_point_for_each_residue(ubiquitin):
    top, bottom = pc.differences(ubiquitin, ubiquitin).plot().axes
    assert [len(line.get_xdata()) for line in (*top.lines, *bottom.lines)] == [76, 76, 76]
