"""Restraints that the end of a run does not meet: status, tables, JSON, pages and what is printed."""

import csv
import json
import re

import numpy as np
import pytest
from fixtures.command_line import run
from fixtures.samples import STRUCTURES, chain, load

import protochain as pc
from protochain.chains.restraint_list import Restraints

APART = "distance A:1:CA A:10:CA 0 4 1"
"""Of alanines whose ends repel each other: too weak to bring them near."""


def distance(x, structure, first, last):
    ends = [
        k
        for k in structure.alpha_carbons
        if structure.residue_number[structure.atom_residue[k]] in (first, last)
    ]
    return 10.0 * np.linalg.norm(x[ends[0]] - x[ends[1]])


def test_values_and_violations_are_those_of_the_coordinates():
    s = load("1l2y.pdb")
    x = np.array(s.positions)
    moved = s.alpha_carbons[6]
    x[moved] += [0.0, 0.09, 0.12]
    d, phi = float(distance(x, s, "3", "15")), float(s.with_positions(x).dihedrals()["phi"][4])
    bounds = d - 2.0, d + 3.0, phi + 352.0, phi - 25.0
    held = Restraints.of(s, [
        f"distance A:3:CA A:15:CA 0 {bounds[0]!r}",
        f"distance A:3:CA A:15:CA {bounds[1]!r} {bounds[1] + 9.0!r} 0,500",
        f"dihedral phi@A:5 {bounds[2] - 5.0!r} {bounds[2]!r} 10",
        f"dihedral phi@A:5 {bounds[3] - 5.0!r} {bounds[3]!r}",
        "position 'name CA' 0.2", f"distance A:3:CA A:15:CA {d + 0.4!r} {d + 5.0!r}",
    ])  # fmt: skip
    values = held.measure(x)
    found = [(v.value, v.bound, v.violation, v.unit, v.is_violated) for v in values]
    expected = [
        (d, bounds[0], 2.0, "angstrom", True), (d, bounds[1], 0.0, "angstrom", False),  # No stiffness below.
        (phi, bounds[2], 8.0, "degrees", False), (phi, bounds[3], 25.0, "degrees", True),
        (1.5, 0.2, 1.3, "angstrom", True), (d, d + 0.4, 0.4, "angstrom", False),
    ]  # fmt: skip
    for one, other in zip(found, expected, strict=True):
        assert one[:3] == pytest.approx(other[:3], abs=1e-6) and one[3:] == other[3:]


@pytest.mark.parametrize("line", [APART, "dihedral phi@A:5 60 60 20", "position 'name CA' 0 0.001"])
def test_a_converged_run_with_a_violated_restraint_has_violations(line):
    c = chain("ala10.pdb")
    e = pc.energy(c.structure, solvent="vacuum", threads=1)
    r = pc.minimise(c, e, "lbfgs", restraints=line, max_evaluations=400)
    (row,) = r.restraint_violations.to_dict("records")
    assert str(r.status) == "violations" and r.end.max_torque <= r.tolerance and r.is_usable
    assert row["restraint"] == line and line in r.message
    record = r.record()
    assert record["restraints_violated"] == 1 and record["restraint_violations"] == [row]
    assert record[f"restraint_violation_{row['unit']}"] == row["violation"]
    if line == APART:
        d = distance(r.x, c.structure, "1", "10")
        assert row["value"] == pytest.approx(d) and row["violation"] == pytest.approx(d - 4.0)
        assert (row["bound"], row["unit"]) == (4.0, "angstrom")
    free = pc.minimise(c, e, "lbfgs", max_evaluations=400)
    assert str(free.status) == "converged" and free.restraint_violations.empty
    assert free.record()["restraints_violated"] is None and free.record()["restraint_violations"] == []


def test_a_minimum_is_left_where_a_restraint_asks_for_it():
    """The energy to compare is that with restraints, or else the start would be the result."""
    c = chain("ala10.pdb")
    e = pc.energy(c.structure, solvent="vacuum", threads=1)
    lowest = pc.minimise(c, e, "lbfgs", max_evaluations=400)
    line = "dihedral phi@A:5 60 60 5000"
    done = pc.relax(lowest.structure, solvent="vacuum", threads=1, restraints=line, stiffness=1.0)
    assert done.energy_end > done.energy_start and done.is_usable
    assert sum((done.energy_end, done.restraints[1])) < sum((done.energy_start, done.restraints[0]))
    assert done.restraint_violations.empty and done.record()["restraints_violated"] == 0
    weak = pc.minimise(
        lowest.structure, e, "lbfgs", restraints="dihedral phi@A:5 60 60 100", max_evaluations=400
    )
    assert weak.end.energy > weak.start.energy and weak.is_usable and weak.restraints[1] < weak.restraints[0]


def test_the_worst_is_first_and_all_are_listed():
    s = load("5awl.pdb")
    lines = [
        "distance A:1:CA A:10:CA 0 3 1", "dihedral phi@A:5 60 60 1", "distance A:2:CA A:9:CA 40 50 1",
        "position 'name CA' 5 1",
    ]  # fmt: skip
    done = pc.relax(s, restraints=lines, solvent="vacuum", threads=1)
    table = done.restraint_violations
    excess = table["violation"] / table["unit"].map({"angstrom": 0.5, "degrees": 10.0})
    assert [*table["restraint"]] == [lines[2], lines[1], lines[0]] and excess.is_monotonic_decreasing
    record = done.record()
    assert record["restraints_violated"] == 3 and str(done.status) == "violations"
    assert record["restraint_violation_angstrom"] == pytest.approx(table["violation"][0])
    assert record["restraint_violations"] == table.to_dict("records")
    assert "3 restraints are violated" in done.message


def test_commands_report_violations(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    source = STRUCTURES / "5awl.pdb"
    (tmp_path / "r.txt").write_text(
        "".join(f"distance A:{k}:CA A:10:CA {30 + k} {40 + k} 1\n" for k in range(1, 8))
    )
    s = load("5awl.pdb")
    common = ["--restraints", "r.txt", "-o", "r.pdb", "--solvent", "vacuum"]
    assert run("relax", source, *common, "--report", "r.html", "--force") == 3
    lines = capsys.readouterr().out.splitlines()
    at = next(k for k, line in enumerate(lines) if line.startswith("7 restraints violated"))
    stated = [float(re.search(r"violated by ([\d.]+) angstrom", line)[1]) for line in lines[at + 1 : at + 6]]
    x = pc.load("r.pdb").positions
    violations = sorted((30.0 + k - distance(x, s, str(k), "10") for k in range(1, 8)), reverse=True)
    assert stated == pytest.approx(violations[:5], abs=0.011) and "2 more" in lines[at + 6]
    page = (tmp_path / "r.html").read_text()
    (table,) = re.findall(r"<caption>Restraints violated.*?</table>", page, re.DOTALL)
    cells = [float(c) for c in re.findall(r"<td>([\d.]+)</td><td class=\"text\">angstrom", table)]
    assert cells == pytest.approx(violations, abs=0.011)
    assert run("relax", source, *common, "--json", "--force") == 3
    told = json.loads(capsys.readouterr().out)
    assert told["status"] == "violations" and told["restraints_violated"] == 7
    assert [v["violation"] for v in told["restraint_violations"]] == pytest.approx(violations, abs=0.002)
    assert run("minimise", source, "--restraints", "r.txt", "-o", "m.pdb", "--report", "m.html",
               "--tolerance", 100, "--solvent", "vacuum") == 3  # fmt: skip
    assert "7 restraints violated" in capsys.readouterr().out
    assert "<caption>Restraints violated" in (tmp_path / "m.html").read_text()


def test_tables_of_batches_and_frames_have_violations(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    source = STRUCTURES / "5awl.pdb"
    line = "distance A:1:CA A:10:CA 30 40 1"
    common = ["--solvent", "vacuum", "--workers", 1, "--json"]
    run("batch", source, "-o", "b", "--restraints", line, "--tolerance", 100, *common)
    (row,) = csv.DictReader((tmp_path / "b" / "summary.csv").read_text().splitlines())
    assert (row["status"], row["restraints_violated"]) == ("violations", "1")
    assert float(row["restraint_violation_angstrom"]) > 10.0 and row["restraint_violation_degrees"] == ""
    assert "<caption>Restraints violated" in (tmp_path / "b" / "pages" / "5awl.html").read_text()
    capsys.readouterr()
    run("relax", source, source, "-o", "r", "--restraints", line, *common)
    row = next(csv.DictReader((tmp_path / "r" / "relaxed.csv").read_text().splitlines()))
    assert (row["status"], row["restraints_violated"]) == ("violations", "1")
    (frame,) = pc.relax_frames(
        load("5awl.pdb"), load("5awl.pdb").positions[None], restraints=line, solvent="vacuum"
    )
    assert frame.record["restraints_violated"] == 1 and frame.record["restraint_violation_angstrom"] > 10.0


def test_simulations_report_their_ends(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    how = ["--steps", 10, "--every", 5, "--no-relax", "--solvent", "vacuum"]
    run(
        "simulate",
        STRUCTURES / "ala10.pdb",
        "-o",
        "sim",
        "--restraints",
        "distance A:1:CA A:10:CA 0 2 1",
        *how,
    )
    assert "1 restraint violated" in capsys.readouterr().out
    assert "<caption>Restraints violated" in (tmp_path / "sim" / "report.html").read_text()
    c = chain("ala10.pdb")
    e = pc.energy(c.structure, solvent="vacuum", threads=1)
    m = pc.simulate(c, e, n_steps=10, restraints=["distance A:1:CA A:10:CA 0 2 1", "position 'name CA' 5 1"])
    (row,) = m.restraint_violations.to_dict("records")
    assert row["value"] == pytest.approx(distance(m.x, m.chain.structure, "1", "10"))
    assert m.record()["restraints_violated"] == 1 and m.record()["restraint_violations"] == [row]
