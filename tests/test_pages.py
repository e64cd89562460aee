"""Pages and the results they quote: tables made from CSV, commands that exist, and the one that makes all."""

import contextlib
import importlib
import json
import os
import re
import shlex
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from conftest import MORE_STRUCTURES, ROOT
from test_docs import COMMANDS, options_of
from typer.exceptions import TyperException

from protochain.analysis.studies import STUDIES

FOLDER = ROOT / "analysis" / "benchmarks"
sys.path.insert(0, str(FOLDER))
import made  # noqa: E402
import pages  # noqa: E402
import tables  # noqa: E402
import tables_more  # noqa: E402

benchmarks = importlib.import_module("all")
HELPERS = {
    "all", "made", "pages", "relax_openmm", "tables", "tables_curves", "tables_kcm", "tables_more",
    "tables_near", "tables_scenes",
}  # fmt: skip
NOTEBOOKS = sorted((ROOT / "analysis" / "notebooks").glob("*.ipynb"))
TEXTS = {
    str(page.relative_to(ROOT)): re.sub(
        r"<!-- table made -->.*?<!-- end -->", "", page.read_text(), flags=re.S
    )
    for page in sorted({*pages.PAGES, *(ROOT / "analysis" / "docs").glob("*.md")})
}
"""Of pages, but for the list of past commands, which were true at their commits."""
TEXTS |= {
    path.name: "\n".join("".join(cell["source"]) for cell in json.loads(path.read_text())["cells"])
    for path in NOTEBOOKS
}
SCRIPTS = sorted(
    {
        found.strip()
        for text in TEXTS.values()
        for found in re.findall(r"python ((?:analysis|tests)/[\w/]+\.py[^`)\n#;]*)", text)
    }
)
PROGRAM = sorted(
    {
        found.strip()
        for text in TEXTS.values()
        for code in (
            *re.findall(r"^```\n(.*?)^```$", text, flags=re.M | re.S),
            *re.findall(r"`([^`\n]+)`", text),
        )
        for found in re.findall(r"^(protochain [a-z]+[^\n#]*)", code, flags=re.M)
    }
)
every_job = pytest.mark.parametrize("job", benchmarks.JOBS, ids=lambda job: job.name)


def accepted(script, words):
    """Whether the parser of a script takes these words."""
    module = importlib.import_module(script.removesuffix(".py"))
    with contextlib.suppress(SystemExit):
        module.parser().parse_args(words)
        return True
    return False


@pytest.mark.parametrize("page", pages.PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_tables_of_a_page_are_those_of_the_results(page):
    text = page.read_text()
    assert pages.rendered(text, pages.RESULTS) == text


def test_every_table_is_used():
    used = {name for page in pages.PAGES for _, name, _, _ in pages.MARKED.findall(page.read_text())}
    assert used == set(tables.TABLES)


def test_every_table_of_numbers_is_made_from_results():
    """But of synopses, words and names, and the two of KCM's own study."""
    for name in ("README.md", "analysis/README.md"):
        typed = pages.MARKED.sub("", TEXTS[name])
        for block in re.findall(r"^\|.*\n\|[-:| ]+\|\n((?:\|.*\n)+)", typed, re.M):
            cells = [cell.strip() for row in block.splitlines() for cell in row.strip("|").split("|")]
            numbers = [cell for cell in cells if re.fullmatch(r"[-+]?[\d.,]+( ?%|x)?", cell)]
            assert numbers == [], f"{name}: typed numbers {numbers[:5]}"


def test_a_table_follows_its_results():
    text = "before\n<!-- table race-medians -->\nstale\n<!-- end -->\nafter\n"
    new = pages.rendered(text, pages.RESULTS)
    assert new.startswith("before\n<!-- table race-medians -->\n") and new.endswith("<!-- end -->\nafter\n")
    assert "stale" not in new and "GBSAOBCForce" in new
    with pytest.raises(KeyError):
        pages.rendered("<!-- table nothing -->\n<!-- end -->", pages.RESULTS)


def test_a_table_without_results_is_left_alone(tmp_path):
    text = "<!-- table threads -->\n| typed |\n<!-- end -->\n<!-- table mechanics -->\nstale\n<!-- end -->\n"
    pd.DataFrame(
        {
            "hinges": [100],
            "forward_us": [10.0],
            "pinocchio_us": [25.0],
            "dart_us": [np.nan],
            "solve_us": [5.0],
        }
    ).to_csv(tmp_path / "mechanics.csv", index=False)
    new = pages.rendered(text, tmp_path)
    assert "| typed |" in new and "stale" not in new
    assert "| 100 | 10.0 | 25.0 (2.50x) | - | 5.0 | 25.0 (5.00x) |\n" in new
    assert pages.without_results(text, tmp_path) == ["threads"]


def test_markdown_aligns_numbers_right():
    assert tables.markdown(("a", "b"), [("x", 1)]) == "| a | b |\n|---|--:|\n| x | 1 |\n"


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        (0.0, "never"),
        (float("nan"), "never"),
        (0.62, "0.62x"),
        (5.0, "5.0x"),
        (9.94, "9.9x"),
        (9.96, "10x"),
        (133.4, "133x"),
    ],
)
def test_ratios_are_quoted_with_two_digits(value, shown):
    assert tables.ratio(value) == shown


def test_costs_of_minimisers_are_quoted_with_quartiles(tmp_path):
    levels = [(m, c, a) for m in (*tables.TORSIONS, *tables.CARTESIAN) for c in ("evaluations", "seconds")
              for a in (100.0, 10.0, 1.0)]  # fmt: skip
    rows = pd.DataFrame(levels, columns=["method", "cost", "above_kj_mol_per_100_residues"])
    rows = rows.assign(first_quartile=12.0, median=23.46, third_quartile=np.inf)
    rows.loc[rows["method"] == "kcm", ["first_quartile", "median"]] = np.inf
    rows.to_csv(tmp_path / "precision.csv", index=False)
    ends = pd.DataFrame({"method": [m for m in (*tables.TORSIONS, *tables.CARTESIAN) for _ in range(2)]})
    ends = ends.assign(
        status=["converged", "budget"] * 9, ca_rmsd_angstrom=[0.5, 0.7] * 9, structure=["a", "b"] * 9,
        residues=50, energy_end_reference_kj_mol=-10.0,
    )  # fmt: skip
    # 0.4 kJ/mol of 50 residues are 0.8 of a hundred; those that move all atoms have their own lowest.
    higher = {("lbfgs", "a"): 0.4, ("lbfgs", "b"): 0.6, ("hybrid", "a"): -9.0}
    for (method, structure), rise in higher.items():
        its = (ends["method"] == method) & (ends["structure"] == structure)
        ends.loc[its, "energy_end_reference_kj_mol"] += rise
    ends.to_csv(tmp_path / "precision_ends.csv", index=False)
    long, short = tables.TABLES["precision"](tmp_path), tables.TABLES["precision-short"](tmp_path)
    assert (
        "| `lbfgs` | 23 (12 to never) | 23 (12 to never) | 23 (12 to never) | 1 of 2 | 1 | 0.60 |\n" in long
    )
    assert "| `lbfgs` | 23.5 (12.0 to never) | 23.5" in long
    assert "| `kcm` | never | never | never | 1 of 2 | 2 | 0.60 |\n" in long
    assert [row.split("|")[6].strip() for row in long.splitlines()[9:12]] == ["1", "2", "1"]
    assert short.splitlines()[2] == "| evaluations | never | 23 | 23 | 23 | 23 | 23 | 23 |"
    assert short.splitlines()[4] == "| converged |" + " 1 of 2 |" * 7


@pytest.mark.parametrize("quoted", SCRIPTS)
def test_commands_that_are_quoted_exist(quoted):
    name, *words = shlex.split(quoted)
    script = ROOT / name
    text = script.read_text()
    if script.parent == FOLDER and "def parser()" in text:
        shown = [word for word in words if word != "..."]
        assert accepted(script.name, shown), quoted
    options = [word for word in words if re.fullmatch(r"--?[a-z][\w-]*", word)]
    helped = text + (FOLDER / "made.py").read_text()
    assert [option for option in options if f'"{option}"' not in helped] == []


@pytest.mark.parametrize("quoted", PROGRAM)
def test_commands_of_the_program_that_are_quoted_exist(quoted):
    _, command, *words = quoted.replace("[", " ").replace("]", " ").split()
    assert command in COMMANDS
    options = {word for word in words if re.fullmatch(r"--?[a-z][\w-]*", word)}
    assert options <= options_of(command)
    if command == "bench" and words:
        assert set(words[0].split("|")) <= {*STUDIES}


def test_pages_quote_commands_that_make_their_tables():
    """Each is a command of the one table, or its beginning; "..." or FILES stand for names of files."""
    known = [job.command for job in benchmarks.JOBS]
    for name in ("README.md", "analysis/README.md", "analysis/docs/cluster.md", "analysis/docs/theory.md"):
        for quoted in re.findall(r"`(python analysis/benchmarks/[^`]+|protochain bench [^`]+)`", TEXTS[name]):
            quoted = " ".join(quoted.split())
            if quoted.split()[1] == "analysis/benchmarks/all.py":
                continue
            if "..." in quoted or "FILES" in quoted:
                first, last = re.split(r" \S+ \.\.\. | FILES ", quoted)
                assert any(line.startswith(first) and line.endswith(last) for line in known), quoted
            else:
                assert any(line.startswith(quoted) for line in known), quoted


def test_every_benchmark_is_run_by_all():
    run = {word for job in benchmarks.JOBS for word in job.command.split() if word.endswith(".py")}
    assert {path.name for path in FOLDER.glob("*.py")} - {f"{name}.py" for name in HELPERS} == {
        word.rpartition("/")[2] for word in run
    }
    names = [job.name for job in benchmarks.JOBS]
    assert len(set(names)) == len(names)


@every_job
@pytest.mark.parametrize("quick", [True, False])
def test_every_job_is_a_command_that_exists(job, quick, tmp_path):
    assert job.minutes > 0
    program, *words = benchmarks.words_of(job, tmp_path, MORE_STRUCTURES, quick)
    if program == sys.executable:
        script, *words = words
        assert (ROOT / script).parent == FOLDER
        assert accepted((ROOT / script).name, words)
    else:
        command, *words = words
        COMMANDS[command].make_context(command, list(words))
    assert str(tmp_path) in words
    for word in words:
        if word.endswith((".pdb", ".cif")) and (MORE_STRUCTURES.exists() or word.startswith("structures/")):
            assert (ROOT / word).is_file(), word


def test_a_job_with_an_unknown_option_would_be_noticed():
    assert not accepted("race.py", ["--force", "gbsa", "--nothing"])
    assert not accepted("dynamics.py", ["energies"])
    with pytest.raises(TyperException, match="nothing"):
        COMMANDS["bench"].make_context("bench", ["precision", "--nothing"])


def all_py(*words):
    surroundings = os.environ | {"PYTHONPATH": str(ROOT)}
    command = [sys.executable, str(FOLDER / "all.py"), *words]
    return subprocess.run(command, env=surroundings, capture_output=True, text=True)


def test_all_makes_a_table_and_the_page_that_quotes_it(tmp_path):
    done = all_py("--quick", "--only", "mechanics", "-o", str(tmp_path))
    assert done.returncode == 0, done.stderr
    record = pd.read_csv(tmp_path / "made.csv", dtype=str, keep_default_na=False).set_index("table")
    assert list(record.index) == ["mechanics.csv", "mechanics_scaling.csv"]
    row = record.loc["mechanics.csv"]
    assert row["command"] == "python analysis/benchmarks/mechanics.py -o DIR --quick"
    assert (
        row["commit"] and "numpy" in row["versions"] and "cores" in row["machine"] and float(row["load"]) >= 0
    )
    table = pd.read_csv(tmp_path / "mechanics.csv")
    page = (tmp_path / "pages" / "analysis" / "README.md").read_text()
    for r in table.itertuples():
        assert f"| {r.hinges} | {r.forward_us:.1f} | " in page
    assert (tmp_path / "pages" / "README.md").exists()


def test_all_goes_on_after_a_failure_and_says_so(tmp_path, monkeypatch, capfd):
    fails = benchmarks.Job(
        "fails", "python -c 'raise SystemExit(4)'", 1, quick="python -c 'raise SystemExit(4)'"
    )
    works = replace(fails, name="works", quick='python -c \'open("there", "w")\'')
    works = replace(
        fails, name="works", quick=f"python -c 'import pathlib; pathlib.Path(\"{tmp_path}/there\").touch()'"
    )
    monkeypatch.setattr(benchmarks, "JOBS", (fails, works))
    monkeypatch.setattr(sys, "argv", ["all.py", "--quick", "-o", str(tmp_path)])
    with pytest.raises(SystemExit) as ended:
        benchmarks.main()
    assert ended.value.code == 1 and (tmp_path / "there").exists()
    assert "failed: fails: exit status 4\n" in capfd.readouterr().err


def test_all_takes_the_tables_of_a_study(tmp_path, monkeypatch):
    monkeypatch.setattr(made, "MORE", tmp_path / "more")
    (tmp_path / "more").mkdir()
    script = "import sys, pathlib; p = pathlib.Path(sys.argv[1]); p.mkdir(); "
    script += "(p / 'a.csv').write_text('x,y\\n1,2\\n')"
    job = benchmarks.Job(
        "study", f'python -c "{script}" DIR MORE/1abc.pdb', 1, collects={"a.csv": ("study.csv", ("y",))}
    )
    out = tmp_path / "out"
    assert benchmarks.run(job, out, tmp_path / "nowhere", False).endswith("name their folder by --more")
    assert benchmarks.run(job, out, tmp_path / "more", False) == ""
    assert (out / "study.csv").read_text() == "y\n2\n"
    lacks = replace(job, collects={"b.csv": ("study.csv", ())})
    assert benchmarks.run(lacks, out, tmp_path / "more", False) == "wrote no b.csv"
    record = pd.read_csv(out / "made.csv", dtype=str).set_index("table")
    assert record.loc["study.csv", "inputs"] == "1abc.pdb"
    assert record.loc["study.csv", "command"].endswith("MORE/1abc.pdb")


def test_some_are_chosen_by_how_they_begin():
    names = [job.name for job in benchmarks.chosen(["race", "dynamics-steps"])]
    assert names == ["race", "race-custom", "dynamics-steps"]
    with pytest.raises(SystemExit, match="no benchmark 'nothing'"):
        benchmarks.chosen(["nothing"])


def test_quick_does_not_write_where_pages_look():
    done = all_py("--quick")
    assert done.returncode == 1 and "-o DIR" in done.stderr


def test_a_result_says_how_it_was_made(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "argv", [str(FOLDER / "race.py"), "-o", str(tmp_path), "--forces", "obc2"])
    for value in (1, 2):
        made.write(pd.DataFrame({"a": [value]}), tmp_path / "race.csv", ["some/folder/1l2y.pdb"], threads=2)
    made.write(pd.DataFrame({"b": [3]}), tmp_path / "other.csv")
    rows = pd.read_csv(tmp_path / "made.csv", dtype=str, keep_default_na=False).set_index("table")
    assert list(rows.index) == ["other.csv", "race.csv"]
    row = rows.loc["race.csv"]
    assert row["command"] == "python analysis/benchmarks/race.py -o DIR --forces obc2"
    assert (row["inputs"], row["threads"]) == ("1l2y.pdb", "2")
    head = subprocess.run(["git", "rev-parse", "--short", "HEAD"], cwd=ROOT, capture_output=True, text=True)
    assert row["commit"] == made.COMMIT
    assert made.commit().removesuffix(" and changes") == (head.stdout.strip() or "none: an installed package")
    assert pd.read_csv(tmp_path / "race.csv")["a"].tolist() == [2]


def test_no_result_names_a_folder_of_a_machine():
    for path in sorted(made.RESULTS.glob("*.csv")):
        assert not re.search(r"(?:^|[ ,\"'])/(?:home|work|tmp|root|usr)/", path.read_text(), re.M), path.name


def test_the_dipeptide_is_capped_alanine():
    structure = importlib.import_module("dipeptide").molecule()
    assert list(structure.residue_name) == ["ACE", "ALA", "NME"]
    assert structure.n_atoms == 22


def test_modules_of_tables_share_one_register():
    assert tables_more.table is tables.table
