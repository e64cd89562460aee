"""What pages of runs are made of: named residues, averages, fluctuations, figures for papers, commands."""

import json
import re
import sys
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from fixtures.command_line import refusal, run
from fixtures.molecules import shaken
from fixtures.samples import STRUCTURES, load
from matplotlib.figure import Figure

import protochain as pc
from protochain.batches.report import USABLE, plot_distributions
from protochain.comparison.dihedral_scan import energy_map
from protochain.comparison.plots import plot_ramachandran_classes
from protochain.comparison.relaxed import named_residues
from protochain.comparison.simulated import _fluctuations, _log, averages, rmsf
from protochain.results.figures import write_figure
from protochain.results.page import write_scan
from protochain.results.provenance import command_line
from protochain.validation.clashes import clashes
from protochain.validation.findings import Findings
from protochain.validation.ramachandran import CLASSES, ramachandran


def test_residues_that_are_named_are_those_whose_outliers_came_and_went():
    relaxation = pc.relax(load("1l2y.pdb"))
    before, after = (
        set(Findings(relaxation.start, x).side_chains.outliers.tolist())
        for x in (relaxation.start.positions, relaxation.x)
    )
    named = named_residues(relaxation, {})
    for what, its in (("Resolved", before - after), ("New", after - before)):
        places = {place for place, _ in named.get(f"{what} rotamer outliers", ())}
        assert places == {f"A:{relaxation.start.residue_number[r]}" for r in its}
    assert before - after  # Else nothing is shown.


def test_residues_that_moved_and_turned_most_are_named_the_most_first():
    s = load("1l2y.pdb")
    x = np.array(s.positions)
    for place, by in ((3, 0.2), (7, 0.4), (11, 0.05)):
        x[s.atom_residue == place] += [0.0, 0.0, by]
    relaxation = replace(pc.relax(s, max_iterations=1, max_outer_iterations=1), x=x)
    changes = pc.differences(s, s.with_positions(x))
    named = named_residues(relaxation, {"end": changes})
    of = changes.residues
    for what, column, least in (
        ("Moved most", "ca_moved_angstrom", 0.1), ("Turned most", "torsions_degrees", 10.0),
    ):  # fmt: skip
        most = of[of[column] >= least].sort_values(column, ascending=False)[:10]
        assert [place for place, _ in named[what]] == [f"A:{number}" for number in most["residue"]]
    farthest = of["ca_moved_angstrom"].max()
    assert named["Moved most"][0] == ("A:8", f"{s.residue(7)}, {farthest:.2g} angstrom") and 2 < farthest < 4


def test_averages_of_a_log_are_those_of_a_straight_line():
    time = np.arange(5.0)
    log = pd.DataFrame({"step": time, "time_ps": time, "temperature_k": 2.0 + 3.0 * time})
    (row,) = averages(log).to_numpy().tolist()
    assert row == [
        row[0],
        pytest.approx(8.0),
        pytest.approx(3.0 * np.sqrt(2.0)),
        2.0,
        14.0,
        pytest.approx(3.0),
    ]


def test_plots_of_a_simulation_state_what_they_show():
    log = pd.DataFrame(
        {"time_ps": [0.0, 1.0], "potential_kj_mol": [-10.0, -12.0], "temperature_k": [290.0, 310.0]}
    )
    titles = [ax.get_title() for ax in _log(log).axes]
    assert titles == ["potential: -11.0 kJ/mol on average", "300 K on average"]
    s = load("ala10.pdb")
    turned = s.positions.copy()
    turned[s.alpha_carbons[3]] += [0.02, 0.0, 0.0]  # Of A:ALA4, by 0.1 angstrom from the mean.
    (ax,) = _fluctuations(s, [s, s.with_positions(turned)]).axes
    assert ax.get_title() == "A:ALA4 moves most: 0.10 angstrom"


def test_a_residue_that_goes_to_and_fro_fluctuates_by_as_much():
    s = load("ala10.pdb")
    size = np.linspace(0.0, 0.09, s.n_residues)
    by = np.outer(size[s.atom_residue], [0.0, 0.6, 0.8])
    assert rmsf(s, [s.with_positions(s.positions + sign * by) for sign in (1, -1)]) == pytest.approx(
        10.0 * size
    )


@pytest.mark.parametrize(("suffix", "head"), [(".svg", b"<?xml"), (".pdf", b"%PDF"), (".png", b"\x89PNG")])
def test_a_figure_has_the_format_of_its_name_and_is_the_same_twice(suffix, head, tmp_path):
    def draw():
        figure = Figure()
        figure.subplots().plot([0, 1], [1, 0])
        return figure

    written = []
    for name in "ab":
        write_figure(tmp_path / f"{name}{suffix}", draw)
        written.append((tmp_path / f"{name}{suffix}").read_bytes())
    assert written[0].startswith(head)
    same = (re.sub(rb'(?:id|href|clip-path)="[^"]*"', b"", each) for each in written)
    assert len(set(same)) == 1


@pytest.mark.parametrize(
    ("command", "words", "shown"),
    [
        ("compare", ("--no-curvature",), ["a, torsions only: lbfgs ends lowest, at -450."]),
        ("batch", ("--workers", 1), ["energy drop,", "C-alpha RMSD", "seconds", "lbfgs", "fire"]),
    ],
)
def test_a_run_has_its_figure_for_a_paper(command, words, shown, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    pc.save(load("ala10.pdb"), tmp_path / "a.pdb")
    given = (command, "a.pdb", "-o", "out", *words, "--methods", "lbfgs,fire", "--max-evaluations", 20)
    assert "ends in .svg, .pdf, .png" in refusal(*given, "--figure", "f.doc")
    assert not (tmp_path / "out").exists()  # Before the work.
    run(*given, "--figure", "f.svg")
    text = (tmp_path / "f.svg").read_text()
    assert [each for each in shown if each not in text] == []


def test_distributions_count_what_is_up_to_each_value():
    random = np.random.default_rng(4)
    methods = np.repeat(["kcm", "lbfgs", "fire"], (6, 9, 3))
    drop, rmsd, seconds = random.uniform(1.0, 9.0, (3, len(methods)))
    rmsd[2], start = np.nan, random.normal(size=len(methods))
    table = pd.DataFrame({
        "method": methods, "energy_start_kj_mol": start, USABLE: start - 10 * drop, "n_residues": 10,
        "ca_rmsd_angstrom": rmsd, "seconds": seconds,
    })  # fmt: skip
    failed = pd.DataFrame([{"method": "kcm", USABLE: np.nan, "seconds": 0.0}])
    figure = plot_distributions(pd.concat([table, failed], ignore_index=True))
    for ax, values in zip(figure.axes, (drop, rmsd, seconds), strict=True):
        assert {line.get_label() for line in ax.lines} == {*methods}
        medians = {name: np.nanmedian(values[methods == name]) for name in dict.fromkeys(methods)}
        low, *_, high = sorted(medians, key=medians.__getitem__)
        title = f"medians from {medians[low]:.3g} ({low})\nto {medians[high]:.3g} ({high})"
        assert ax.get_title() == title
        for line in ax.lines:
            own = values[(methods == line.get_label()) & np.isfinite(values)]
            x, share = line.get_data()
            assert x == pytest.approx(np.sort(own))
            assert share == pytest.approx([100.0 * np.mean(own <= each) for each in np.sort(own)])


@pytest.mark.parametrize("statuses", [None, ["converged", "budget"], ["converged", "converged"]])
def test_a_page_of_a_scan_has_numbers_and_a_verdict_only_of_runs(statuses, tmp_path):
    table = pd.DataFrame({"phi A:2": [0.0, 60.0], "energy_kj_mol": [1.5, -2.0]})
    if statuses:
        table["status"] = statuses
    numbers = {"lowest energy, kJ/mol": "-2.00", "at phi A:2, degrees": "60"}
    write_scan(tmp_path / "s.html", "Scan of <x>", "Energy.", numbers, energy_map(table), table)
    page = (tmp_path / "s.html").read_text()
    assert "Scan of &lt;x&gt;" in page
    assert re.findall(r"<dt>([^<]*)</dt><dd>([^<]*)</dd></div>", page) == [*numbers.items()]
    n_good = statuses and statuses.count("converged")
    kind = "good" if n_good == 2 else "bad"
    expected = [(kind, f"{n_good} of 2 converged")] if statuses else []
    assert re.findall(r'class="badge (\w+)">([^<]*)<', page) == expected


@pytest.mark.parametrize(
    ("program", "shown"),
    [("/x/protochain/__main__.py", "python -m protochain"), ("/x/bin/protochain", "/x/bin/protochain")],
)
def test_a_command_is_shown_as_it_was_typed(program, shown, monkeypatch):
    monkeypatch.setattr(sys, "argv", [program, "relax", "a b.pdb"])
    assert command_line() == f"{shown} relax 'a b.pdb'"


def test_a_ramachandran_plot_has_a_panel_of_each_class_and_names_outliers():
    start = load("1ubq.pdb")
    end = shaken(start, 0.03)
    found = {name: ramachandran(s) for name, s in {"before": start, "after": end}.items()}
    figure = plot_ramachandran_classes({"before": start, "after": end})
    kinds = np.unique(np.concatenate([result.kind for result in found.values()])).tolist()
    panels = [ax for ax in figure.axes if ax.get_visible()]
    titles = [f"{CLASSES[k].replace('_', ' ')}: {(found['after'].kind == k).sum()}" for k in kinds]
    assert [ax.get_title() for ax in panels] == titles and len(kinds) == 5  # It has no cis proline.
    named = {text.get_text().strip() for ax in panels for text in ax.texts}
    assert named == {str(end.residue(r)) for r in found["after"].outliers.tolist()} and len(named) > 1
    drawn = sum(len(points.get_offsets()) for ax in panels for points in ax.collections[-3:])
    assert drawn == sum(len(result.kind) for result in found.values())


def test_a_page_of_a_validation_names_the_residues_with_faults(tmp_path):
    page = tmp_path / "page.html"
    assert run("validate", STRUCTURES / "4pti.pdb", "--report", page) == 0
    text, v = page.read_text(), pc.validate(load("4pti.pdb"))
    assert len(text) < 2e6 and f"{len(v.listing())} residues with faults" in text
    for line in v.listing():
        assert line.split(":", 2)[1] in text
    discs = json.loads(re.search(r'id="colourings">(.*?)</script>', text, re.DOTALL)[1])["discs"]
    assert [len(rows) for rows in discs] == [len(clashes(v.structure).pairs)]
    both = STRUCTURES / "4pti.pdb", STRUCTURES / "1l2y.pdb"
    assert "one structure" in refusal("validate", *both, "--report", page)
