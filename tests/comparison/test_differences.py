"""What changed between two structures: identities, and mdtraj as the oracle."""

import mdtraj
import numpy as np
import pytest
from fixtures.samples import STRUCTURES, load, shared
from scipy.spatial.transform import Rotation

import protochain as pc
from protochain.comparison.differences import TORSIONS, concatenate, of_ends, totals_of
from protochain.comparison.domains import rigid_domains
from protochain.comparison.plots import plot_differences


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


def mdtrajs(s):
    """Hydrogen bonds by mdtraj: donor, hydrogen, acceptor."""
    return {*map(tuple, mdtraj.baker_hubbard(pc.to_mdtraj(s), periodic=False).tolist())}


def hydrogen_bonds_of(found):
    return [found.totals[f"hydrogen_bonds_{kind}"] for kind in ("kept", "gained", "lost")]


def test_hydrogen_bonds_gained_and_lost_are_mdtrajs(ubiquitin):
    after = turned(ubiquitin, "psi", "35", 60.0)
    mine, theirs = mdtrajs(ubiquitin), mdtrajs(after)
    found = pc.differences(ubiquitin, after)
    assert hydrogen_bonds_of(found) == [len(mine & theirs), len(theirs - mine), len(mine - theirs)]
    assert min(hydrogen_bonds_of(found)) > 0
    told = found.bonds[found.bonds["kind"] == "hydrogen bond"]
    lost = told[told["change"] == "lost"][["first", "second"]].to_numpy().tolist()
    named = [[str(ubiquitin.atom(d)), str(ubiquitin.atom(a))] for d, _, a in mine - theirs]
    assert sorted(lost) == sorted(named)
    back = pc.differences(after, ubiquitin)
    assert back.totals["hydrogen_bonds_gained"] == found.totals["hydrogen_bonds_lost"]
    assert 0.0 < found.totals["contacts_kept"] < 1.0


@pytest.mark.parametrize(
    ("file", "method"),
    [("1l2y_trpcage.pdb", "cartesian"), ("3al1_caps_altloc.pdb", "cartesian"), ("5vav_cyclic.pdb", "lbfgs"),
     ("2n0n_lactam.pdb", "relax"), ("3i40_insulin.pdb", "moved")],
)  # fmt: skip
def test_hydrogen_bonds_are_counted_in_one_way(file, method):
    """The count at the end is that at the start, less those lost, and those gained; both are mdtraj's."""
    start = pc.load(shared(file))
    if method == "moved":
        size = np.random.default_rng(3).normal(0.0, 0.02, start.positions.shape)
        end = start.with_positions(start.positions + size)
    else:
        end = (pc.relax(start) if method == "relax" else pc.minimise(start, method=method)).structure
    before, after = mdtrajs(start), mdtrajs(end)
    kept, gained, lost = hydrogen_bonds_of(pc.differences(start, end))
    assert (kept, gained, lost) == (len(before & after), len(after - before), len(before - after))
    counts = [pc.quality(s)["hydrogen_bonds"] for s in (start, end)]
    assert counts == [len(before), len(after)] and counts[1] == counts[0] - lost + gained


def test_secondary_structure_is_dssps_and_its_parts_are_superposed_by_themselves(ubiquitin):
    found = pc.differences(ubiquitin, turned(ubiquitin, "psi", "35", 60.0))
    codes = mdtraj.compute_dssp(pc.to_mdtraj(ubiquitin))[0]
    named = found.residues["secondary_structure"].map({"helix": "H", "strand": "E", "loop": "C"})
    assert named.tolist() == codes.tolist()
    assert found.totals["ca_rmsd_angstrom_helix"] < found.totals["ca_rmsd_angstrom"]
    assert found.totals["ca_rmsd_angstrom_A"] == pytest.approx(found.totals["ca_rmsd_angstrom"], rel=1e-12)


def test_parts_on_either_side_of_a_hinge_are_rigid_domains_and_turn_as_it_does():
    """One bond of a chain turns: two rigid bodies, whose motions differ by its angle."""
    s = load("1hel.pdb")
    found = pc.differences(s, turned(s, "psi", "70", 80.0))
    domain = found.residues["domain"].to_numpy()
    (first,), (second,) = np.unique(domain[:65]), np.unique(domain[75:])
    assert {first, second} == {1, 2} and (np.diff(domain) != 0).sum() == 1
    assert found.totals["rigid_domains"] == 2
    assert found.totals["turn_degrees_domain_2"] == pytest.approx(80.0, abs=1e-3)
    # Of C-alphas near the axis, some that belong to the other side lie within the tolerance.
    assert max(found.totals[f"ca_rmsd_angstrom_domain_{k}"] for k in (1, 2)) < 0.3
    assert found.totals["ca_rmsd_angstrom"] > 5.0


def test_adenylate_kinases_domains_are_those_of_its_crystals():
    """Core, and the lids over AMP and ATP: 30 to 59 and 122 to 159, Mueller, Structure 4:147 (1996)."""
    table = pc.differences(load("4ake.pdb.gz"), load("1ake.pdb.gz"))
    domain = dict(zip(table.residues["residue"].astype(int), table.residues["domain"], strict=True))
    assert table.totals["rigid_domains"] == 3
    for k, places, share in ((1, [*range(1, 30), *range(85, 117), *range(180, 214)], 0.9),
                             (2, range(122, 160), 1.0), (3, range(32, 60), 0.7)):  # fmt: skip
        assert np.mean([domain[place] == k for place in places]) >= share
    assert 40.0 < table.totals["turn_degrees_domain_2"] < 65.0


def test_points_that_moved_each_for_itself_are_no_domain_and_few_are_none():
    rng = np.random.default_rng(1)
    x = 3.0 * rng.normal(size=(60, 3))
    assert rigid_domains(x, 3.0 * rng.normal(size=(60, 3))) == []
    assert rigid_domains(x[:19], x[:19]) == [] and rigid_domains(x[:0], x[:0]) == []
    turn = Rotation.from_euler("z", 50, degrees=True).as_matrix()
    random_turn = Rotation.random(random_state=rng).as_matrix()
    x[35:] += 10.0
    # All of it is turned, too, which tells nothing of its parts.
    whole, other = rigid_domains(x, np.concatenate([x[:35] + 1.0, x[35:] @ turn.T]) @ random_turn)
    assert whole.members.tolist() == [*range(35)] and other.members.tolist() == [*range(35, 60)]
    assert other.turn == pytest.approx(50.0) and max(whole.rmsd, other.rmsd) < 1e-12


def test_totals_in_words_and_tables_of_several_ends(ubiquitin):
    ends = {"start": ubiquitin, "a": turned(ubiquitin, "chi1", "7", 120.0), "b": ubiquitin}
    found = of_ends(ends)
    totals = totals_of(found).set_index("quantity")
    assert totals.loc["rotamers changed"].tolist() == [1, 0]
    assert {"contacts kept", "C-alpha RMSD of chain A, angstrom", "C-alpha RMSD of helix, angstrom",
            "C-alpha RMSD of domain 1, angstrom", "rigid domains"} <= {*totals.index}  # fmt: skip
    assert concatenate(found, "residues")["method"].tolist() == ["a"] * 76 + ["b"] * 76
    figure = plot_differences({name: each.residues for name, each in found.items()}, "two")
    top, bottom = figure.axes
    assert [line.get_label() for line in top.lines] == ["a", "b"] and len(bottom.lines) == 2
    assert top.get_xticklabels()[0].get_text() == "A:1"


def test_of_nucleotides_alone_nothing_is_told():
    s = load("1bna.pdb")
    assert of_ends({"start": s, "end": s}) == {}


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


def test_another_residue_has_no_changed_rotamer():
    s = pc.load(STRUCTURES / "1l2y.pdb")
    other = pc.Setup(sequence="NIYLQWMKEGGPSTGKPPPS").load(STRUCTURES / "1l2y.pdb")
    found = pc.differences(s, other)
    rows = found.residues
    assert found.totals["rotamers_changed"] == 0
    assert (rows["rotamer_before"] != rows["rotamer_after"]).sum() >= 2
