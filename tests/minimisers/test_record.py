"""A solution made by hand: its record, its texts, its trace and its file."""

from dataclasses import MISSING, fields, replace
from importlib.metadata import version
from types import SimpleNamespace

import gemmi
import numpy as np
import pytest
from fixtures.repairs import sentences
from fixtures.samples import chain
from fixtures.tolerances import SINGLE_NM
from scipy.spatial.transform import Rotation

from protochain.chains.frame import Frame
from protochain.minimisers.recipes import RECIPES
from protochain.minimisers.restraints import Hold
from protochain.minimisers.solution import TRACE_COLUMNS, Recorder, Solution, frames_of, trace_of
from protochain.minimisers.verdict import Judgement, Status
from protochain.results.columns import flat

ENERGY = SimpleNamespace(
    engine="native", device="cpu", reason="two kernels", forcefield="amber14", solvent="obc2", threads=2
)


def traced(recorder):
    return trace_of(recorder.structure, recorder.rows, recorder.alphas)


def solution(**changed):
    c = chain("ala10.pdb")
    made = Solution(
        recipe=RECIPES["lbfgs"], chain=c, energy_function=ENERGY, constant_terms={"bonds": 3, "angles": 4},
        q=c.q0, x=c.structure.positions, energy=-12.25, status=Status.BUDGET, ended="budget: used",
        n_iterations=5, n_evaluations=6, seconds=1.5, trace=None, start=Judgement(-10.0, 300.0, 40.0),
        end=Judgement(-12.5, 30.0, 4.0), judge="a judge", frame=Frame(c.structure), ca_rmsd_angstrom=0.25,
        tolerance=1.0, hold=Hold((100.0,), 0.5), seed=9, restraints=(0.5, 1.5), lowest_eigenvalue=7.5,
    )  # fmt: skip
    return replace(made, **changed)


def test_cells_are_text_where_values_are_lists_or_counts():
    assert flat(["one", 2]) == "one; 2" and flat({"bonds": 3, "angles": 4}) == "3 bonds; 4 angles"
    assert flat([]) == flat({}) == "" and flat(1.5) == 1.5 and flat(None) is None and flat("text") == "text"


def test_a_solution_shows_itself():
    s = solution()
    assert "-10.00 -> -12.50 kJ/mol" in repr(s) and "300 to 30" in s._repr_html_()
    assert s.method == "lbfgs" and s.keeps_geometry and s.is_usable
    assert not solution(end=Judgement(np.nan, 1.0, 1.0)).is_usable
    # Where it began: an end if it converged there, and otherwise no result.
    there = solution().start
    assert solution(end=there, status=Status.CONVERGED).is_usable
    assert not solution(end=there, status=Status.BUDGET).is_usable
    x = s.x + 0.1
    assert np.array_equal(solution(x=x).structure.positions, x)


def test_a_solution_in_scipys_terms():
    found = solution(status=Status.CONVERGED).to_scipy()
    expected = {"fun": -12.5, "success": True, "status": 0, "message": "budget: used", "nit": 5, "nfev": 6,
                "njev": 6}  # fmt: skip
    assert {name: found[name] for name in expected} == expected
    assert np.array_equal(found.x, chain("ala10.pdb").q0) and set(found) == {*expected, "x"}
    assert (solution().to_scipy().success, solution().to_scipy().status) == (False, 2)


def test_the_provenance_of_a_structure(tmp_path):
    c = chain("1ejg.pdb")
    start = c.structure.positions
    s = solution(chain=c, x=start + np.array([0.3, 0.0, -0.4]), frame=Frame(c.structure, "a spring"))
    packages = [f"{name.upper()} {version(name)}" for name in ("openmm", "gemmi")]
    assert list(s.provenance()) == [
        f"PROTOCHAIN {version('protochain')}, METHOD lbfgs, STATUS budget",
        f"WITH {', '.join(packages)}",
        "FORCE FIELD amber14, SOLVENT obc2, ENGINE native",
        "ENERGY -12.5000 KJ/MOL BEFORE ROUNDING, AT THE START -10.0000",
        "ENERGIES BY A JUDGE",
        "C-ALPHA RMSD TO THE START 0.250 ANGSTROM, AS FILED 5.000, HELD BY A SPRING",
    ]
    s = solution(chain=c, x=start, frame=Frame(c.structure))
    told = "C-ALPHA RMSD TO THE START 0.250 ANGSTROM, AS FILED 0.000, SUPERPOSED ON THE START"
    assert list(s.provenance())[-1] == told
    # The file itself lists what was changed, once.
    s.save(tmp_path / "a.cif")
    block = gemmi.cif.read(str(tmp_path / "a.cif")).sole_block()
    for category, lines in (("provenance", s.provenance()), ("repair", sentences(c.structure))):
        said = [gemmi.cif.as_string(each) for each in block.find_values(f"_protochain_{category}.text")]
        assert said == list(lines) and said
    assert any("alternate location" in line for line in sentences(c.structure))


def test_a_recorder_numbers_its_rows_and_measures_rmsds_afterwards(monkeypatch):
    s = chain("ala10.pdb").structure
    seen, clock = [], iter((10.0, 12.5, 13.0, 99.0))
    monkeypatch.setattr("protochain.minimisers.solution.perf_counter", lambda: next(clock))
    held = Frame(s, "a spring")
    recorder = Recorder(s, held, lambda row, x: seen.append((row, x)), started=8.0)
    larger = s.positions.copy()
    alpha = s.alpha_carbons
    middle = s.positions[alpha] - s.positions[alpha].mean(axis=0)
    larger[alpha] += 0.01 * middle
    none = np.full_like(larger, np.nan)
    for k, x in enumerate((s.positions, larger, none)):
        recorder(x, -float(k), {"max_torque_kj_mol_rad": 10.0 * k, "rms_torque_kj_mol_rad": 1.0}, 3 * k)
    assert [row["iteration"] for row, _ in seen] == [0, 1, 2] and seen[1][1] is larger
    trace = traced(recorder)
    assert tuple(trace.columns) == TRACE_COLUMNS == (
        "iteration", "evaluations", "seconds", "energy_kj_mol", "rms_torque_kj_mol_rad",
        "max_torque_kj_mol_rad", "rms_force_kj_mol_nm", "max_force_kj_mol_nm", "ca_rmsd_angstrom",
    )  # fmt: skip
    assert trace["evaluations"].tolist() == [0, 3, 6] and trace["energy_kj_mol"].tolist() == [0.0, -1.0, -2.0]
    assert trace["max_torque_kj_mol_rad"].tolist() == [0.0, 10.0, 20.0]
    assert trace["rms_torque_kj_mol_rad"].tolist() == [1.0] * 3
    assert trace[["rms_force_kj_mol_nm", "max_force_kj_mol_nm"]].isna().all(axis=None)
    assert trace["seconds"].tolist() == [2.0, 4.5, 5.0]
    size = 10.0 * 0.01 * np.sqrt(np.mean(np.sum(middle**2, axis=1)))
    assert trace["ca_rmsd_angstrom"].tolist() == pytest.approx([0.0, size, np.nan], abs=1e-6, nan_ok=True)


def test_a_recorder_shows_and_keeps_positions_in_the_frame_of_the_start():
    s = chain("ala10.pdb").structure
    turned = s.positions @ Rotation.from_rotvec([0.3, -0.2, 0.9]).as_matrix().T + [1.0, 2.0, 3.0]
    none = np.full_like(turned, np.nan)
    for held_by, expected in (("", s.positions), ("a spring", turned)):
        seen = []
        recorder = Recorder(s, Frame(s, held_by), lambda row, x, seen=seen: seen.append(x))
        for x in (turned, none, turned):
            recorder(x, 0.0, {}, 1)
        frames = frames_of(recorder.frame, recorder.recorded_frames().values())
        for x, kept in zip(seen[::2], frames[::2], strict=True):
            assert np.abs(x - expected).max() < 1e-12 and np.abs(kept - expected).max() < 1e-6
        assert seen[1] is none and list(recorder.recorded_frames()) == [0, 1, 2]
        assert traced(recorder)["ca_rmsd_angstrom"].tolist() == pytest.approx(
            [0.0, np.nan, 0.0], abs=1e-6, nan_ok=True
        )


def test_a_recorder_tells_its_watcher_of_stages_if_it_listens():
    s, told = chain("ala10.pdb").structure, []

    class Bar:
        def __call__(self, row, x):
            told.append(row["evaluations"])

        def at_stage(self, *given):
            told.append(given)

    recorder = Recorder(s, Frame(s), Bar())
    recorder.at_stage("torsions", 3)
    recorder(s.positions, 0.0, {}, 4)
    assert told == [("torsions", 3), 4] and len(traced(recorder)) == 1
    for watch in (None, lambda row, x: told.append(x)):
        Recorder(s, Frame(s), watch).at_stage("torsions", 3)
    assert len(told) == 2


def test_a_trace_is_made_once_when_it_is_first_read():
    made = []
    solution = Solution(
        **{field.name: None for field in fields(Solution)} | {"trace": lambda: made.append(1) or [7]}
    )
    assert not made
    assert solution.trace == [7] and solution.trace is solution.trace and made == [1]
    assert Solution.__dataclass_fields__["trace"].default is MISSING


def test_frames_are_superposed_when_they_are_read():
    structure = chain("ala10.pdb").structure
    fits = []

    class Fit(Frame):
        def __call__(self, x):
            fits.append(x)
            return super().__call__(x)

    recorder = Recorder(structure, Fit(structure))
    for shift in (0.0, 1.0):
        recorder(structure.positions + shift, 0.0, {}, 1)
    assert not fits
    frames = frames_of(recorder.frame, recorder.recorded_frames().values())
    assert len(fits) == 2 and frames.dtype == np.float32
    assert np.allclose(frames, structure.positions, atol=SINGLE_NM)
