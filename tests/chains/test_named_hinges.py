"""Dihedrals and hinges by name: told, set, frozen, held, scanned."""

import itertools
import json

import MDAnalysis
import numpy as np
import pandas as pd
import pytest
from fixtures.command_line import refusal_as_said, run
from fixtures.samples import STRUCTURES, chain, load, shared
from MDAnalysis.analysis.dihedrals import Janin, Ramachandran

import protochain as pc
from protochain.chains.chain import pose
from protochain.chains.hinges import find_hinges
from protochain.comparison.dihedral_scan import energy_map

FILE = STRUCTURES / "1l2y.pdb"


def test_dihedrals_are_those_of_mdanalysis():
    s = pc.load(shared("1ubq_ubiquitin.pdb"))
    table = s.dihedrals()
    group = pc.to_mdanalysis(s).select_atoms("protein")
    with pytest.warns(UserWarning, match="first or last"):
        inner = Ramachandran(group).run().results.angles[0]
    off = (table[["phi", "psi"]].to_numpy()[1:-1] - inner + 180.0) % 360.0 - 180.0
    assert len(off) == 74 and np.abs(off).max() < 0.01
    with pytest.warns(UserWarning):
        chi = Janin(group).run().results.angles[0]
    both = table[table["chi2"].notna() & ~table["name"].isin(["PRO"])]
    assert MDAnalysis.__version__ and len(chi) == len(both)
    assert np.abs((both[["chi1", "chi2"]].to_numpy() - chi + 180.0) % 360.0 - 180.0).max() < 0.01


def test_dihedrals_are_the_coordinates_of_hinges():
    c = chain("1l2y.pdb", "phi psi omega chi")
    table = c.structure.dihedrals()
    rows = {f"{row.chain}:{row.residue}": row for row in table.itertuples()}
    for i, hinge in enumerate(c.hinges):
        kind, place = hinge.name.split()
        q = c.q0[c.tree.q_start[c.hinge_body[i]]]
        assert np.cos(np.deg2rad(getattr(rows[place], kind)) - q) == pytest.approx(1.0, abs=1e-9), hinge.name


def test_a_hinge_that_is_set_has_this_dihedral_and_no_other_changes():
    c = chain("1l2y.pdb")
    before = c.structure.dihedrals()
    q = c.set({"phi A:5": -100.0, "chi1@A:8": 65.0})
    after = c.structure.with_positions(pc.pose(c, q).x).dihedrals()
    changed = before.iloc[:, 3:].to_numpy() - after.iloc[:, 3:].to_numpy()
    assert {*zip(*np.nonzero(np.abs(np.nan_to_num(changed)) > 1e-9), strict=True)} == {(4, 0), (7, 3)}
    assert after["phi"][4] == pytest.approx(-100.0) and after["chi1"][7] == pytest.approx(65.0)
    again = c.set({"psi A:5": 20.0}, q)
    assert (again != q).sum() == 1


def test_single_hinges_are_opened_and_frozen():
    s = load("1l2y.pdb")
    names = [hinge.name for hinge in chain("1l2y.pdb").hinges]
    frozen = pc.build_chain(s, "phi psi chi -phi@A:5 -chi2@A:8")
    assert sorted(h.name for h in frozen.hinges) == sorted({*names} - {"phi A:5", "chi2 A:8"})
    alone = pc.build_chain(s, "psi chi1@A:8")
    assert sorted(h.name for h in alone.hinges) == sorted([n for n in names if n[:3] == "psi"] + ["chi1 A:8"])
    r = pc.minimise(frozen, pc.energy(s, solvent="vacuum"), "lbfgs", max_evaluations=20)
    assert r.structure.dihedrals()["phi"][4] == pytest.approx(s.dihedrals()["phi"][4], abs=1e-6)
    assert pc.build_chain(r).opened == frozen.opened


def test_a_run_starts_from_coordinates():
    c = chain("1l2y.pdb")
    e = pc.energy(c.structure, solvent="vacuum")
    q = c.set({"chi1 A:8": -60.0})
    r = pc.minimise(c, e, "lbfgs", max_evaluations=30, q=q)
    assert r.start.energy == pytest.approx(e(pc.pose(c, q).x)[0], rel=1e-9)
    assert pc.minimise(c, e, max_evaluations=30, q=q).start.energy == pytest.approx(r.start.energy)


def test_a_spring_holds_one_hinge():
    c = chain("ala10.pdb")
    e = pc.energy(c.structure, solvent="vacuum", threads=1)
    for name in ("phi@A:5", "phi A:5"):
        m = pc.simulate(c, e, n_steps=200, seed=1, time_step=0.002, hinge_springs=pc.HingeSpring(name, 1e5))
        off = m.structure.dihedrals()["phi"] - c.structure.dihedrals()["phi"]
        assert abs(off[4]) < 1.0 < off.abs().max()
        assert m.trace["hinge_springs_kj_mol"].iloc[-1] < 50.0
    assert pc.HingeSpring.read("phi@A:5 40 0.5").damping == 0.5


def test_a_scan_is_the_energy_at_each_point():
    c = chain("ala10.pdb")
    e = pc.energy(c.structure, solvent="vacuum")
    table = pc.scan(c, e, {"phi A:5": [-60.0, 60.0], "psi A:5": [-45.0, 0.0, 135.0]})
    assert table.shape == (6, 3)
    for row in table.to_dict("records"):
        value = row.pop("energy_kj_mol")
        assert value == pytest.approx(e(pc.pose(c, c.set(row)).x)[0], rel=1e-12)
    drawn = energy_map(table)
    assert drawn.axes[0].get_xlabel() == "phi A:5, degrees"


def test_a_map_shows_energies_above_the_lowest_point_wherever_it_is():
    table = pd.DataFrame({"phi A:5": [60.0, -60.0, 180.0], "energy_kj_mol": [-90.0, -97.0, -95.0]})
    (line,) = energy_map(table).axes[0].lines
    assert line.get_xdata().tolist() == [60.0, -60.0, 180.0] and line.get_ydata().tolist() == [7.0, 0.0, 2.0]
    steep = energy_map(table.assign(energy_kj_mol=[-90.0, 1e6, 0.0])).axes[0]
    assert energy_map(table).axes[0].get_yscale() == "linear" and steep.get_yscale() == "symlog"
    grid = pd.DataFrame(itertools.product([-60.0, 60.0], [0.0, 90.0, 180.0]), columns=["phi A:5", "psi A:5"])
    axes = energy_map(grid.assign(energy_kj_mol=[-40.0, -50.0, -45.0, -30.0, -20.0, 99.0])).axes[0]
    assert axes.get_title() == "lowest at phi A:5 = -60, psi A:5 = 90 degrees"
    # Contours every 5 kJ/mol from the lowest: its region is of the first colour.
    filled = axes.collections[0]
    assert filled.levels[[0, 1, -1]].tolist() == [0.0, 5.0, 60.0] and filled.zmin == 0.0


def test_a_relaxed_scan_moves_the_selected_atoms_only():
    """Only phi turns with the scanned psi: the result is the lowest energy along phi."""
    s = load("ala10.pdb")
    c = pc.build_chain(s, "phi psi", move="resid 5")
    e = pc.energy(s, solvent="vacuum")
    (relaxed,) = pc.scan(c, e, {"psi A:5": [-30.0]}, relax=True)["energy_kj_mol"]
    phi = s.dihedrals()["phi"][4]
    turned = (pose(c, c.set({"psi A:5": -30.0, "phi A:5": phi + turn})) for turn in np.arange(0.0, 80.0, 0.2))
    assert 0.0 <= min(e(at.x)[0] for at in turned) - relaxed < 0.01


def test_a_relaxed_scan_is_lower_and_keeps_the_dihedral():
    c = pc.build_chain(pc.from_sequence("AAA"))
    e = pc.energy(c.structure)
    grids = {"phi A:2": [-110.0, -40.0]}
    rigid, relaxed = (pc.scan(c, e, grids, relax=relax) for relax in (False, True))
    assert (relaxed["energy_kj_mol"] < rigid["energy_kj_mol"] - 1.0).all()
    for phi, value in zip((-110.0, -40.0), relaxed["energy_kj_mol"], strict=True):
        line, q = f"dihedral phi@A:2 {phi} {phi} 1e6", c.set({"phi A:2": phi})
        held, free = (pc.minimise(c, e, "lbfgs", q=q, restraints=each).end.energy for each in (line, ""))
        assert value == pytest.approx(held, abs=0.1) and value > free + 0.3
    assert (relaxed["status"] == "converged").all()


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda c: c.set({"phi A:99": 1.0}), "'phi A:99': does not turn"),
        (lambda c: c.set({"omega A:5": 1.0}), "does not turn; psi A:5, phi A:5"),
        (lambda c: c.set({"phi A:5": np.nan}), "values phi A:5: nan: give finite"),
        (lambda c: c.set({"phi A:5": "x"}), "values 'x': give a number"),
        (lambda c: pc.build_chain(c.structure, "phi psi -phi@A:99"), "no hinge 'phi A:99'"),
        (lambda c: pc.HingeSpring("phy@A:5", 1.0), "not a hinge kind"),
        (lambda c: pc.simulate(c, n_steps=1, hinge_springs="phi@A:99 5"), "does not turn"),
        (lambda c: pc.scan(c, None, {"phi A:5": []}), "finite"),
        (lambda c: pc.scan(c, None, {"phi A:5": [np.nan]}), "finite"),
        (lambda c: pc.scan(c, None, "phi A:5"), "give values by the names"),
        (lambda c: pc.minimise(c, method="lbfgs", q=np.zeros(3)), "q has shape"),
    ],
)  # fmt: skip
def test_what_is_not_there_is_refused(call, said):
    with pytest.raises(pc.ProtochainError, match=said):
        call(chain("ala10.pdb"))


def test_the_command_scans(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    given = ["scan", STRUCTURES / "ala10.pdb", "--solvent", "vacuum"]
    # The lowest point is neither the first nor the last.
    run(*given, "phi A:5=0,-90,90", "psi A:5=45,-45", "--json", "--report", "map.html")
    told = json.loads(capsys.readouterr().out)
    table = pd.read_csv("ala10.scan.csv")
    assert told["n_points"] == len(table) == 6 and table["phi A:5"].tolist() == [0, 0, -90, -90, 90, 90]
    assert told["lowest"] == pytest.approx(
        {"phi A:5": -90.0, "psi A:5": -45.0, "energy_kj_mol": table["energy_kj_mol"].min()}
    )
    run(*given, "phi A:5=0:180:90", "-o", "curve.csv")
    assert pd.read_csv("curve.csv")["phi A:5"].tolist() == [0, 90, 180]
    assert 'src="data:image/' in (tmp_path / "map.html").read_text()
    for wrong in (
        "phi A:5",
        "phi A:5=1:2",
        "phi A:5=2:1:1",
        "phi A:5=1:2:0",
        "phi A:5=a",
        "phi A:5=0:1:1e-9",
    ):
        assert "give a hinge and its values" in refusal_as_said(*given, wrong)
    assert "does not turn" in refusal_as_said(*given, "omega A:5=0:1:1")
    assert "each hinge once" in refusal_as_said(*given, *2 * ["phi A:5=0:10:5"])


def test_names_of_hinges_are_their_own():
    names = [hinge.name for hinge in find_hinges(load("3i40.pdb"), ("phi", "psi", "omega", "chi"))]
    assert len(names) == len({*names})
