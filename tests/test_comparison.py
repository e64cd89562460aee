import json

import numpy as np
import openmm
import pandas as pd
import pytest
from conftest import PDB_ROUNDING_NM, STRUCTURES, chain, energy, load
from openmm import app, unit

import protochain as pc
from protochain.analysis.comparison import DEFAULT_METHODS
from protochain.analysis.viewer import library
from protochain.structure.trajectory import TrajectoryFile


@pytest.fixture(scope="module")
def comparison():
    return pc.compare(chain("1l2y.pdb"), energy=energy("1l2y.pdb"), max_evaluations=200)


@pytest.fixture(scope="module")
def folder(comparison, tmp_path_factory):
    directory = tmp_path_factory.mktemp("report")
    comparison.report(directory)
    return directory


def test_every_method_is_judged_from_one_start(comparison):
    assert [s.method for s in comparison.solutions] == list(DEFAULT_METHODS)
    assert comparison.table["energy_start_kj_mol"].nunique() == 1
    judge = energy("1l2y.pdb").reference
    for s in comparison.solutions:
        assert s.end.energy == pytest.approx(judge(s.x)[0], abs=1e-6)


def test_the_folder_holds_what_the_interface_promises(folder):
    names = {path.name for path in folder.iterdir()}
    structures = {f"1l2y.{m}.pdb" for m in ("start", *DEFAULT_METHODS)}
    tables = {f"{stem}.csv" for stem in ("summary", "traces", "quality", "displacement", "progress")}
    tables |= {"summary.json", "report.html"}
    pictures = {"energy.png", "rmsd.png", "displacement.png", "ramachandran.png"}
    assert names == structures | tables | pictures
    for name in pictures:
        assert (folder / name).read_bytes().startswith(b"\x89PNG") and (folder / name).stat().st_size > 20_000


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
    traces = pd.read_csv(folder / "traces.csv")
    assert list(traces.columns[:2]) == ["structure", "method"]
    assert len(traces) == sum(len(s.trace) for s in comparison.solutions)


def test_the_page_stands_alone(folder):
    page = (folder / "report.html").read_text()
    own = page.replace(library(), "")
    assert len(own) < len(page) - 500_000 and "default-src 'none'" in own
    assert "http://" not in own and "https://" not in own
    assert "href=" not in own and own.count("src=") == own.count('src="data:image/png;base64,') == 4
    assert page.count("data:image/png;base64,") == 4
    # kcm, md and lbfgs turn hinges; hybrid and openmm move every atom.
    assert page.count("all other angles stay as they came") == 3
    assert page.count("lengths and angles relax") == 2


def test_names_from_files_are_escaped(tmp_path):
    import dataclasses

    evil = "<script>alert(1)</script>$x$"
    s = dataclasses.replace(load("ala10.pdb"), name=evil, repairs=("<b>bold</b>",))
    k = pc.compare(s, methods=("lbfgs",), max_evaluations=3)
    from protochain.analysis.report import render

    page = render(k, k.summary(), {"energy": k.plot_energy(), "rmsd": k.plot_rmsd()})
    assert evil not in page and "<b>bold</b>" not in page
    assert "&lt;script&gt;alert(1)&lt;/script&gt;" in page


def test_rmsd_is_symmetric_and_between_the_ends(comparison):
    values = comparison.rmsd.to_numpy()
    assert np.allclose(values, values.T, atol=1e-9) and np.allclose(np.diag(values), 0, atol=1e-9)
    for s in comparison.solutions:
        assert comparison.rmsd.loc["start", s.method] == pytest.approx(s.ca_rmsd_angstrom, abs=1e-9)


@pytest.mark.parametrize("suffix", [".pdb", ".cif"])
@pytest.mark.parametrize("method", DEFAULT_METHODS)
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


@pytest.mark.parametrize(("suffix", "precision"), [(".dcd", 1e-6), (".xtc", 6e-4)])
def test_a_trajectory_holds_the_frames(suffix, precision, tmp_path):
    import mdtraj

    s = load("ala10.pdb")
    frames = [s.positions + 0.01 * k for k in range(3)]
    path = tmp_path / f"run{suffix}"
    with TrajectoryFile(path, s) as file:
        for x in frames:
            file.append(x)
    read = mdtraj.load(str(path), top=mdtraj.Topology.from_openmm(s.topology))
    assert np.allclose(read.xyz, frames, atol=precision)
    assert list(tmp_path.iterdir()) == [path]


def test_a_trajectory_that_fails_leaves_nothing(tmp_path):
    s = load("ala10.pdb")
    with pytest.raises(RuntimeError, match="stop"), TrajectoryFile(tmp_path / "run.dcd", s) as file:
        file.append(s.positions)
        raise RuntimeError("stop")
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(pc.ProtochainError, match="unknown trajectory suffix"):
        TrajectoryFile(tmp_path / "run.abc", s)


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


def test_backbone_dihedrals_equal_those_of_the_chain_and_outliers_are_found():
    from protochain.analysis.quality import ramachandran, ramachandran_outliers

    s = load("1ubq.pdb")
    c = chain("1ubq.pdb")
    residues, angles = ramachandran(s)
    phi = {int(h.residue_number): q for h, q in zip(c.hinges, c.q0, strict=True) if h.kind == "phi"}
    own = {int(s.residue_number[r]): a for r, a in zip(residues, angles[:, 0], strict=True)}
    assert len(own) == 74
    for number, value in phi.items():
        if number in own:
            assert np.degrees(value) == pytest.approx(own[number], abs=1e-3)
    assert not ramachandran_outliers(s).any()
    q = c.q0.copy()
    (place,) = [i for i, h in enumerate(c.hinges) if (h.kind, h.residue_number) == ("phi", "30")]
    q[c.tree.q_start[c.hinge_body[place]]] = np.radians(0.0)
    bent = s.with_positions(pc.pose(c, q).x)
    assert [int(s.residue_number[r]) for r in residues[ramachandran_outliers(bent)]] == [30]


def test_ends_are_measured_against_a_native_structure():
    k = pc.compare(
        chain("1l2y.pdb"), ("lbfgs",), energy("1l2y.pdb"), max_evaluations=20,
        native=STRUCTURES / "1l2y.pdb",
    )  # fmt: skip
    assert k.quality.loc["start", "native_rmsd_angstrom"] == pytest.approx(0.0, abs=1e-6)
    end = k.quality.loc["lbfgs"]
    assert end["native_rmsd_angstrom"] == pytest.approx(end["ca_rmsd_to_start_angstrom"], abs=1e-6)


def test_progress_is_the_lowest_energy_so_far(comparison, folder):
    table = pd.read_csv(folder / "progress.csv")
    traces = comparison.traces
    assert set(table["cost"]) == {"evaluations", "seconds"}
    for row in table.to_dict("records"):
        for method in DEFAULT_METHODS:
            run = traces[(traces["method"] == method) & (traces[row["cost"]] <= row["at"] * (1 + 1e-12))]
            if run.empty:
                assert np.isnan(row[method])
            else:
                assert row[method] == pytest.approx(run["energy_kj_mol"].min(), rel=1e-12)
    assert (np.diff(table[table["cost"] == "evaluations"]["lbfgs"]) <= 0).all()


def test_a_view_holds_all_it_needs(comparison):
    view = comparison.view()
    shown = view._repr_html_()
    assert shown.startswith("<iframe sandbox=") and shown.count("<") == 2 and "start, kcm" in repr(view)
