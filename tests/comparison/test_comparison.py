import json

import numpy as np
import openmm
import pandas as pd
import pytest
from fixtures.repairs import noted
from fixtures.samples import chain, energy, load
from fixtures.tolerances import PDB_ROUNDING_NM
from matplotlib.figure import Figure
from openmm import app, unit

import protochain as pc
from protochain.comparison import plots
from protochain.core import defaults
from protochain.results.columns import Column, heading
from protochain.results.viewer import library


@pytest.fixture(scope="module")
def comparison():
    return pc.compare(chain("1l2y.pdb"), energy=energy("1l2y.pdb"), max_evaluations=100)


@pytest.fixture(scope="module")
def folder(comparison, tmp_path_factory):
    directory = tmp_path_factory.mktemp("report")
    comparison.report(directory)
    return directory


def test_every_method_is_judged_from_one_start(comparison):
    assert [s.method for s in comparison.solutions] == list(defaults.COMPARED)
    assert comparison.table["energy_start_kj_mol"].nunique() == 1
    judge = energy("1l2y.pdb").reference
    for s in comparison.solutions:
        assert s.end.energy == pytest.approx(judge(s.x)[0], abs=1e-6)


def test_what_changed_is_in_the_folder_and_on_the_page(folder, comparison):
    totals = pd.read_csv(folder / "differences.csv").set_index("method")
    residues = pd.read_csv(folder / "residue_differences.csv", dtype={"residue": str})
    bonds = pd.read_csv(folder / "bonds_changed.csv")
    page = (folder / "report.html").read_text()
    assert "What changed" in page
    for s in comparison.solutions:
        found = pc.differences(comparison.structure, s)
        own = totals.loc[s.method].dropna()
        assert own.to_dict() == pytest.approx(dict(found.totals))
        moved = residues.loc[residues["method"] == s.method, "ca_moved_angstrom"]
        assert moved.to_numpy() == pytest.approx(found.residues["ca_moved_angstrom"].to_numpy())
        assert (bonds["method"] == s.method).sum() == len(found.bonds)
        assert f"<td>{found.totals['ca_rmsd_angstrom']:.3f}</td>" in page


def test_csv_json_and_page_hold_the_same_numbers(folder, comparison):
    table = pd.read_csv(folder / "summary.csv")
    summary = json.loads((folder / "summary.json").read_text())
    page = (folder / "report.html").read_text()
    for row, record, s in zip(
        table.to_dict("records"), summary["results"], comparison.solutions, strict=True
    ):
        for key in ("energy_start_kj_mol", "energy_end_reference_kj_mol", "ca_rmsd_angstrom", "evaluations"):
            assert row[key] == record[key]
        assert record["energy_end_reference_kj_mol"] == s.end.energy
        assert f"{s.end.energy:.3f}" in page and f"{s.ca_rmsd_angstrom:.3f}" in page
        assert record["message"] in page
    quality = pd.read_csv(folder / "quality.csv", index_col=0)
    for name, row in summary["quality"].items():
        assert {key: quality.loc[name, key] for key in row} == pytest.approx(row, rel=1e-12)
        assert f"{row['radius_of_gyration_angstrom']:.3f}" in page
    for stem in ("work", "spread"):
        written = pd.read_csv(folder / f"{stem}.csv")
        pd.testing.assert_frame_equal(written, pd.DataFrame(summary[stem]), rtol=1e-12, check_dtype=False)
        for v in written.select_dtypes("float").stack():
            assert (f"{v:.0f}" if v % 1 == 0 else f"{v:.3f}") in page
    # OpenMM repeats exactly where it is given one core.
    varying = [s.method for s in comparison.solutions if not s.recipe.repeats_exactly(s.energy_function)]
    repeats = [(record["method"], record["seed"]) for record in summary["repeats"]]
    assert repeats == [(method, seed) for method in varying for seed in (1, 2)]
    traces = pd.read_csv(folder / "traces.csv")
    assert list(traces.columns[:2]) == ["structure", "method"]
    assert len(traces) == sum(len(s.trace) for s in comparison.solutions)


@pytest.mark.parametrize(
    ("name", "said", "unit"),
    [
        ("energy_end_kj_mol", "energy end, kJ/mol", "kJ/mol"),
        ("ca_rmsd_angstrom", "C-alpha RMSD, angstrom", "angstrom"),
        ("bond_angle_change_rms_degrees", "bond angle change RMS, degrees", "degrees"),
        ("energy_drop_kj_mol_per_residue", "energy drop, kJ/mol per residue", "kJ/mol per residue"),
        ("tm_score_to_start", "TM score to start", ""),
    ],
)
def test_a_heading_has_the_unit_that_the_name_ends_in(name, said, unit):
    column = Column(name, float, "short")
    assert heading(name) == said and column.unit == unit
    assert column.title == (f"short, {unit}" if unit else "short")


def test_the_page_stands_alone(folder):
    page = (folder / "report.html").read_text()
    own = page.replace(library(), "")
    assert len(own) < len(page) - 500_000 and "default-src 'none'" in own
    assert "http://" not in own and "https://" not in own
    assert "href=" not in own and own.count("src=") == own.count('src="data:image/') == 6
    assert page.count('src="data:image/') == 6
    # kcm, md and lbfgs turn hinges; hybrid and openmm move every atom.
    assert page.count("all other angles are untouched") == 3
    assert page.count("lengths and angles relax") == 2


def test_names_from_files_are_escaped(tmp_path):
    import dataclasses

    evil = "<script>alert(1)</script>$x$"
    s = dataclasses.replace(load("ala10.pdb"), name=evil, repairs=(noted("<b>bold</b>"),))
    k = pc.compare(s, methods=("lbfgs",), max_evaluations=3)
    k.write_page(tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text()
    assert evil not in page and "<b>bold</b>" not in page
    assert "&lt;script&gt;alert(1)&lt;/script&gt;" in page


def test_rmsd_is_symmetric_and_between_the_ends(comparison):
    values = comparison.rmsd.to_numpy()
    assert np.allclose(values, values.T, atol=1e-9) and np.allclose(np.diag(values), 0, atol=1e-9)
    for s in comparison.solutions:
        assert comparison.rmsd.loc["start", s.method] == pytest.approx(s.ca_rmsd_angstrom, abs=1e-9)


@pytest.mark.parametrize("suffix", [".pdb", ".cif"])
@pytest.mark.parametrize("method", ("kcm", "cartesian"))
def test_openmm_alone_finds_the_reported_energy_in_the_written_file(comparison, method, suffix, tmp_path):
    s = next(s for s in comparison.solutions if s.method == method)
    path = tmp_path / f"out{suffix}"
    s.save(path)
    read = app.PDBFile(str(path)) if suffix == ".pdb" else app.PDBxFile(str(path))
    topology = read.topology
    topology.createDisulfideBonds(read.positions)
    system = app.ForceField("amber14/protein.ff14SB.xml", "implicit/obc2.xml").createSystem(topology)
    context = openmm.Context(system, openmm.VerletIntegrator(0.001), openmm.Platform.getPlatform("Reference"))
    context.setPositions(read.positions)
    alone = context.getState(energy=True).getPotentialEnergy().value_in_unit(unit.kilojoule_per_mole)
    x = np.array(read.getPositions(asNumpy=True).value_in_unit(unit.nanometer))
    # At the positions as written the two agree to round-off and the constants of GBSAOBCForce ...
    judge = energy("1l2y.pdb").reference
    assert alone == pytest.approx(judge(x)[0], rel=2e-8)
    # ... and what rounding did to the energy is what the forces say it must do, to second order: the
    # stiffest bond has k = 5e5 kJ/mol/nm^2, each atom a few bonds.
    _, forces = judge(s.x)
    first_order = -np.sum(forces * (x - s.x))
    off = np.abs(x - s.x).max()
    assert off <= (PDB_ROUNDING_NM * 1.001 if suffix == ".pdb" else 1e-8)
    curvature = 5e5 * 4 * np.sum((x - s.x) ** 2)
    assert abs(alone - s.end.energy - first_order) < curvature + 2e-8 * abs(alone)


def test_different_energies_or_starts_are_not_compared(comparison):
    other = pc.minimise(chain("1l2y.pdb"), energy("1l2y.pdb", solvent="vacuum"), max_evaluations=2)
    with pytest.raises(pc.ProtochainError, match="different energy functions"):
        pc.Comparison(comparison.structure, (*comparison.solutions, other))
    with pytest.raises(pc.ProtochainError, match="different starts"):
        pc.Comparison(load("1vii.pdb"), comparison.solutions)


def test_an_interrupt_keeps_what_is_done_and_leaves_out_the_rest():
    def watch(method):
        def interrupt(row, x):
            if method == "lbfgs" and row["iteration"] == 3:
                raise KeyboardInterrupt

        return interrupt

    methods = ("kcm", "lbfgs", "openmm")
    k = pc.compare(chain("ala10.pdb"), methods, energy("ala10.pdb"), max_evaluations=10, watch=watch)
    assert [(s.method, str(s.status)) for s in k.solutions] == [("kcm", "budget"), ("lbfgs", "interrupted")]


def test_an_interrupt_before_a_method_has_anything_keeps_the_others():
    def watch(method):
        def stop(row, x):
            if method == "openmm":
                raise KeyboardInterrupt

        return stop

    k = pc.compare(
        chain("1l2y.pdb"), ("lbfgs", "openmm"), energy("1l2y.pdb"), max_evaluations=20, watch=watch
    )
    assert [s.method for s in k.solutions] == ["lbfgs"]


def test_a_comparison_of_nothing_finite_still_writes_its_page(tmp_path):
    s = load("ala10.pdb")
    x = s.positions.copy()
    x[s.n_atoms - 3] = x[0]
    k = pc.compare(pc.build_chain(s.with_positions(x)), energy=energy("ala10.pdb"), max_evaluations=4)
    page = k.report(tmp_path)
    assert page.exists()
    json.loads((tmp_path / "summary.json").read_text(), parse_constant=pytest.fail)


def test_structures_too_far_out_for_pdb_are_written_as_mmcif(tmp_path):
    s = load("ala10.pdb")
    far = pc.build_chain(s.with_positions(s.positions + 1500.0))
    k = pc.compare(far, ("lbfgs",), energy("ala10.pdb"), max_evaluations=3)
    k.report(tmp_path)
    assert (tmp_path / "ala10.lbfgs.cif").exists()


def test_unknown_methods_are_refused_before_any_work():
    with pytest.raises(pc.ProtochainError, match="method 'nope' is not known"):
        pc.compare("nowhere.pdb", methods=("nope",))
    with pytest.raises(pc.ProtochainError, match="no methods"):
        pc.compare("nowhere.pdb", methods=())


def test_quality_is_what_other_programs_measure(comparison):
    import MDAnalysis
    import mdtraj

    quality, s = comparison.quality, comparison.structure
    assert list(quality.index) == ["start", *(each.method for each in comparison.solutions)]
    start = quality.loc["start"]
    assert start["secondary_structure_kept"] == 1.0 and start["tm_score_to_start"] == pytest.approx(1.0)
    assert start["bond_length_change_rms_angstrom"] == 0.0 == start["bond_angle_change_rms_degrees"]
    for solution in comparison.solutions:
        row = quality.loc[solution.method]
        frames = mdtraj.Trajectory(
            solution.x[None].astype(np.float32), mdtraj.Topology.from_openmm(s.topology)
        )
        universe = MDAnalysis.Universe.empty(s.n_atoms, trajectory=True)
        universe.add_TopologyAttr("masses", s.atom_mass)
        universe.atoms.positions = 10 * solution.x
        size = universe.atoms.radius_of_gyration()
        assert row["radius_of_gyration_angstrom"] == pytest.approx(size, rel=1e-5)
        assert row["ca_rmsd_to_start_angstrom"] == solution.ca_rmsd_angstrom
        assert row["hydrogen_bonds"] == len(mdtraj.baker_hubbard(frames, freq=0.0, periodic=False))
        moved = comparison.displacements[solution.method]
        assert np.sqrt(np.mean(moved**2)) == pytest.approx(solution.ca_rmsd_angstrom, rel=1e-9)
        if solution.keeps_geometry:
            assert row["bond_length_change_rms_angstrom"] < 1e-8
        else:
            assert row["bond_length_change_rms_angstrom"] > 1e-3
    assert len(comparison.displacements) == len(s.alpha_carbons)


def test_equal_cost_is_the_lowest_energy_so_far(comparison, folder):
    table = pd.read_csv(folder / "equal_cost.csv")
    traces = comparison.traces
    assert set(table["cost"]) == {"evaluations", "seconds"}
    for row in table.to_dict("records"):
        for method in defaults.COMPARED:
            run = traces[(traces["method"] == method) & (traces[row["cost"]] <= row["at"] * (1 + 1e-12))]
            if run.empty:
                assert np.isnan(row[f"{method}_kj_mol"])
            else:
                assert row[f"{method}_kj_mol"] == pytest.approx(run["energy_kj_mol"].min(), rel=1e-12)
    assert (np.diff(table[table["cost"] == "evaluations"]["lbfgs_kj_mol"]) <= 0).all()


def test_a_view_holds_all_it_needs(comparison):
    view = comparison.view()
    shown = view._repr_html_()
    assert shown.startswith("<iframe title=") and shown.count("<") == 2 and "start, kcm" in repr(view)


def test_methods_that_do_not_repeat_are_run_again_and_their_spread_is_told():
    k = pc.compare(
        chain("ala10.pdb"), ("lbfgs", "anneal"), energy("ala10.pdb"), max_evaluations=60, seed=5, repeats=3
    )
    assert [s.method for s in k.solutions] == ["lbfgs", "anneal"]
    assert [(s.method, s.seed) for s in k.repeats] == [("anneal", 6), ("anneal", 7)]
    spread = k.spread.set_index("method")
    assert spread.loc["lbfgs", ["runs", "repeats_exactly"]].tolist() == [1, True]
    row, runs = spread.loc["anneal"], [k.solutions[1], *k.repeats]
    energies = sorted(s.end.energy for s in runs)
    columns = ["energy_lowest_kj_mol", "energy_median_kj_mol", "energy_highest_kj_mol"]
    assert row[columns].tolist() == energies and energies[0] < energies[2]
    apart = [pc.ca_rmsd(k.structure, a.x, b.x) for a in runs for b in runs]
    # The last bit is another the other way round.
    assert row["ca_rmsd_between_angstrom"] == pytest.approx(max(apart), rel=1e-12)
    assert not row["repeats_exactly"]
    again = pc.minimise(chain("ala10.pdb"), energy("ala10.pdb"), "anneal", max_evaluations=60, seed=6)
    assert again.end.energy == k.repeats[0].end.energy
    other = pc.minimise(chain("ala10.pdb"), energy("ala10.pdb", solvent="vacuum"), max_evaluations=2)
    with pytest.raises(pc.ProtochainError, match="different energy functions"):
        pc.Comparison(k.structure, k.solutions, repeats=(other,))


@pytest.mark.parametrize("methods", [("hybrid", "openmm", "lbfgs")])
def test_a_method_compared_ends_as_it_does_alone_in_any_order(methods):
    c, s, shared = chain("1ejg.pdb"), load("1ejg.pdb"), pc.energy(load("1ejg.pdb"), threads=1)
    # Near enough for neighbour lists to hold at the start too, and to be others.
    near = s.positions + np.random.default_rng(0).uniform(-0.02, 0.02, s.positions.shape)
    alone = {m: pc.minimise(c, pc.energy(s, threads=1), m, 1.0, max_evaluations=25) for m in methods}
    for order in (methods, methods[::-1]):
        k = pc.compare(c, order, shared, max_evaluations=25, watch=lambda _: shared(near) and None)
        for one in k.solutions:
            other = alone[one.method]
            assert np.array_equal(one.x, other.x) and (one.start, one.end) == (other.start, other.end)
            traces = (each.trace.filter(regex=r"^(?!.*seconds)") for each in (one, other))
            pd.testing.assert_frame_equal(*traces, check_exact=True)
            assert one.constant_terms == other.constant_terms
            # Without hinges nothing is constant.
            assert bool(one.constant_terms) == (one.method not in ("cartesian", "openmm"))


def test_work_is_what_it_took_to_come_near(comparison, folder):
    traces = comparison.traces
    work = pd.read_csv(folder / "work.csv").set_index("method")
    for s in comparison.solutions:
        runs = comparison.solutions + comparison.repeats
        lowest = min(r.end.energy for r in runs if r.keeps_geometry == s.keeps_geometry)
        assert work.loc[s.method, "lowest_kj_mol"] == pytest.approx(lowest, rel=1e-14)
        for cost in ("evaluations", "seconds"):
            for near in (100, 10, 1):
                run = traces[traces["method"] == s.method]
                met = run[run["energy_kj_mol"] <= work.loc[s.method, "lowest_kj_mol"] + near][cost]
                told = work.loc[s.method, f"{cost}_within_{near}_kj_mol"]
                assert np.isnan(told) if met.empty else told == pytest.approx(met.min(), rel=1e-12)
    assert (
        work.loc["lbfgs", "evaluations_within_1_kj_mol"] > work.loc["lbfgs", "evaluations_within_10_kj_mol"]
    )


def plot_energies(traces, title, ax=None):
    return plots.plot_energy(traces, {"torsions": ["kcm"]}, title, ax)


def titles(axes):
    return axes.get_title() + axes.get_title("left")


@pytest.mark.parametrize("plot", [plot_energies, plots.plot_torque])
@pytest.mark.parametrize("value", [10.0, -np.inf])
def test_a_title_is_above_all_panels_or_above_the_first_axes_of_the_user(plot, value):
    """Also of a figure without curves, which a torque below 0 or an infinite energy makes."""
    traces = pd.DataFrame(
        {"method": "kcm", "evaluations": [1, 2], "seconds": [0.1, 0.2], "energy_kj_mol": value,
         "max_torque_kj_mol_rad": value}
    )  # fmt: skip
    whole = plot(traces, "ala")
    assert f"{whole.get_suptitle()}{titles(whole.axes[0])}".startswith("ala")
    axes = Figure().subplots(1, 2)
    mine = plot(traces, "ala", axes)
    assert mine is axes[0].figure and not mine.get_suptitle()
    assert titles(axes[0]).startswith("ala") and not titles(axes[1])
