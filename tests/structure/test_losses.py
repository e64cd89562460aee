"""Atoms of a file that are lost: values, counted, and told at the end of a run, in tables and on pages."""

import json
import re

import numpy as np
import pytest
from fixtures.samples import STRUCTURES

import protochain as pc
from protochain.batches.batch_structures import _finish
from protochain.batches.jobs import BatchSettings, find_jobs
from protochain.batches.table import Tables, read_table
from protochain.batches.task import Task
from protochain.chains.setup import Setup
from protochain.cli.relaxing import print_folder
from protochain.structure.molecule.repairs import _ACTION, Kind, Loss, Rank, Reason, loss_lines
from protochain.structure.write import as_text

CHANGES = {
    1: ("PCA", "CD", {"OE": (1.2, 0.0, 0.0)}, ("OE1", "OE2")),
    3: ("SEP", "OG", {"P": (1.6, 0.0, 0.0), "O1P": (2.1, 1.4, 0.0), "O2P": (2.1, -1.4, 0.0)}, ()),
    5: ("TPO", "OG1", {"P": (0.0, 0.0, 1.6), "O1P": (1.4, 0.0, 2.1)}, ()),
    7: ("TYS", "OH", {"S": (0.0, 1.6, 0.0), "O1": (1.4, 2.1, 0.0), "O2": (-1.4, 2.1, 0.0)}, ()),
    9: ("MLE", "N", {"CN": (0.0, 0.0, 1.5)}, ()),
}
"""Residue number to the new name, the atom at which others hang, these (angstrom from it), and what goes."""
LOST = (
    Loss("A", "1", "PCA", ("OE",), Reason.ASKED),
    Loss("A", "3", "SEP", ("P", "O1P", "O2P"), Reason.ASKED),
    Loss("A", "5", "TPO", ("P", "O1P"), Reason.ASKED),
    Loss("A", "7", "TYS", ("S", "O1", "O2"), Reason.ASKED),
    Loss("A", "9", "MLE", ("CN",), Reason.ASKED),
)
ASKED = ("--standard-residues",)
SAID = "A:1 PCA OE; A:3 SEP P, O1P, O2P; A:5 TPO P, O1P; A:7 TYS S, O1, O2; A:9 MLE CN"


def line_of(name, residue, chain, number, x, record="HETATM", element=""):
    return (
        f"{record:6}{1:5d} {name:^4} {residue:>3} {chain}{number:4d}    {x[0]:8.3f}{x[1]:8.3f}{x[2]:8.3f}"
        f"  1.00  0.00          {element or name[0]:>2}\n"
    )


def modified_text():
    """A peptide of E, S, T, Y and L in their modified forms, with alanines between."""
    lines = []
    for line in as_text(pc.from_sequence("EASATAYALA"), ".pdb", hydrogens=False).splitlines(keepends=True):
        if not line.startswith("ATOM"):
            lines += [line] if line.startswith(("TER", "END")) else []
            continue
        number, atom = int(line[22:26]), line[12:16].strip()
        name, at, more, gone = CHANGES.get(number, (line[17:20], "", {}, ()))
        if atom not in gone:
            lines.append(f"{line[:17]}{name}{line[20:]}")
        if atom == at:
            x = np.array([float(line[k : k + 8]) for k in (30, 38, 46)])
            lines += [line_of(each, name, "A", number, x + way) for each, way in more.items()]
    return "".join(lines)


@pytest.fixture
def modified(tmp_path):
    path = tmp_path / "in" / "modified.pdb"
    path.parent.mkdir()
    path.write_text(modified_text())
    return path


def test_atoms_of_modified_residues_are_named_and_counted(modified, tmp_path):
    s = pc.load(modified, standard_residues=True)
    assert s.losses == LOST and tuple(s.residue_name[[0, 2, 4, 6, 8]]) == ("GLU", "SER", "THR", "TYR", "LEU")
    counts = {"atoms of PCA": 1, "atoms of SEP": 3, "atoms of TPO": 2, "atoms of TYS": 3, "atoms of MLE": 1}
    assert dict(s.left_out) == counts
    pc.save(s, tmp_path / "written.cif")
    again = pc.load(tmp_path / "written.cif")
    assert again.losses == () and dict(again.left_out) == {}


def test_a_folder_says_it_in_its_last_lines_its_table_its_summary_and_its_pages(modified, tmp_path, capsys):
    (modified.parent / "whole.pdb").write_bytes((STRUCTURES / "ala10.pdb").read_bytes())
    settings, folder = (
        BatchSettings(("relax",), setup=Setup(solvent="vacuum", standard_residues=True)),
        tmp_path / "out",
    )
    jobs = find_jobs([modified.parent], settings, None, folder)
    tables = Tables(folder, False, "relaxed", {"relax"})
    tables.select_finished(jobs)
    for job in jobs:
        tables.append(list(Task(job, folder).run(1)))
    _finish(tables, jobs)
    tables.close()
    table = read_table(folder / "relaxed.csv")
    assert table["n_lost_atoms"].tolist() == [10, 0] and table["lost_atoms"][0] == SAID
    assert table["lost_atoms"].isna().tolist() == [False, True]
    print_folder(table, folder)
    line = f"1 of 2 structures lost atoms: modified ({SAID})"
    assert capsys.readouterr().out.splitlines()[-2] == line
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["lost_atoms"] == {"modified": SAID} and summary["far_molecules"] == {}
    assert f"{line}." in (folder / "report.html").read_text()
    assert f"lost atoms: {SAID}." in (folder / "pages" / "modified.html").read_text()
    assert "lost atoms" not in (folder / "pages" / "whole.html").read_text()


def test_what_is_far_what_is_broken_and_an_inner_end_are_lost_for_other_reasons(tmp_path):
    lines = [line for line in (STRUCTURES / "ala10.pdb").read_text().splitlines(True) if line[:4] == "ATOM"]
    ala = {line[12:16].strip(): line for line in lines if int(line[22:26]) == 4}
    inner = f"{ala['O'][:12]} OXT{ala['O'][16:46]}{float(ala['O'][46:54]) + 2.2:8.3f}{ala['O'][54:]}"
    lines.insert(lines.index(ala["O"]), inner)
    beside = [
        line_of(name, "SO4", "B", 1, (90.0 + k, 0.0, 0.0)) for k, name in enumerate(("S", "O1", "O2"))
    ] + [
        line_of("O", "HOH", "B", 2, (0.0, 50.0, 0.0)),
        line_of("N", "ALA", "C", 7, (60.0, 0.0, 0.0)), line_of("CB", "ALA", "C", 7, (61.0, 1.0, 0.0)),
        line_of("Q", "QQQ", "D", 1, (0.0, 0.0, 80.0), element="X"),
    ]  # fmt: skip
    path = tmp_path / "x.pdb"
    path.write_text("".join(lines + beside) + "END\n")
    s = pc.load(path)
    assert set(s.losses) == {
        Loss("A", "4", "ALA", ("OXT",), Reason.INNER),
        Loss("B", "1", "SO4", ("S", "O1", "O2"), Reason.FAR),
        Loss("C", "7", "ALA", ("N", "CB"), Reason.BACKBONE),
        Loss("D", "1", "QQQ", ("Q",), Reason.ELEMENT),
    }
    assert s.left_out["waters"] == 1 and s.left_out["atoms of ALA"] == 1 == s.left_out["SO4"]
    # Left out by choice, they are not lost.
    assert {loss.why for loss in pc.load(path, keep="none").losses} == {
        Reason.INNER,
        Reason.BACKBONE,
        Reason.ELEMENT,
    }
    record = pc.minimise(s, max_evaluations=1).record()
    assert record["far_molecules"] == ["B:1 SO4"] and record["n_lost_atoms"] == 4
    assert loss_lines([record]) == [
        "lost atoms: D:1 QQQ; C:7 ALA; A:4 ALA OXT",
        'left out molecules further than 5 angstrom from the protein: B:1 SO4; keep="all" keeps them',
    ]


def test_what_says_that_something_is_left_out_or_ignored_is_ranked_as_a_loss():
    """It is then in the summary before all changes, and among the notes to act on."""
    losses = {kind for kind in Kind if re.search("left out|ignored|of another configuration", kind.words.one)}
    assert {kind for kind in losses if kind.words.rank > Rank.LOSS} == set()
    silent = {kind for kind in losses if kind.words.rank is Rank.LOSS} - _ACTION
    assert silent == {Kind.ALTERNATES}
