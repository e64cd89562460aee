"""Pages and the results they quote: tables made from CSV, commands that exist, and the one that makes all."""

import contextlib
import importlib
import json
import re
import shlex
import subprocess
import sys

import numpy as np
import pandas as pd
import pytest
from fixtures.command_line import COMMANDS
from fixtures.samples import MORE_STRUCTURES, ROOT
from fixtures.texts import blocks

from bench.__main__ import parser as bench_parser
from bench.scenes import SCENES
from bench.studies import STUDIES

FOLDER = ROOT / "analysis" / "benchmarks"
sys.path.insert(0, str(FOLDER))
import made  # noqa: E402
import pages  # noqa: E402
import tables  # noqa: E402

benchmarks = importlib.import_module("all")
HELPERS = {"all", "made", "pages", "quick", "race_openmm", "relax_openmm"}
NOTEBOOKS = sorted((ROOT / "analysis" / "notebooks").glob("*.ipynb"))
MADE = re.compile(r"<!-- table made -->.*?<!-- end -->", re.DOTALL)
"""Past commands, which were true at their commits."""
TEXTS = {str(page.relative_to(ROOT)): MADE.sub("", page.read_text()) for page in pages.PAGES} | {
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
        for name, text in TEXTS.items()
        if name != "analysis/docs/commands.md"  # Synopses: tests/project/test_docs.py.
        for code in (
            *re.findall(r"^```(?:sh)?\n(.*?)^```$", text, flags=re.M | re.S),
            *(" ".join(span.split()) for span in re.findall(r"`([^`]+)`", pages.FENCED.sub("", text))),
        )
        for found in re.findall(
            r"^(?:.*(?:&&|\|) )?((?:protochain [a-z]+|python analysis/bench(?= |$))[^\n#]*)", code, flags=re.M
        )
    }
)
"""Commands of the program, in blocks and in the text."""
BENCH = {None, *STUDIES, *SCENES}
every_job = pytest.mark.parametrize("job", benchmarks.JOBS, ids=lambda job: job.name)
every_page = pytest.mark.parametrize("page", pages.PAGES, ids=lambda page: str(page.relative_to(ROOT)))


def accepted(script, words):
    """Whether the parser of a script takes these words."""
    module = importlib.import_module(script.removesuffix(".py"))
    with contextlib.suppress(SystemExit):
        module.parser().parse_args(words)
        return True
    return False


@every_page
def test_tables_of_a_page_are_those_of_the_results(page):
    text = page.read_text()
    assert pages.rendered(text, pages.RESULTS) == text


def test_every_table_is_used_and_has_results():
    used = {name for page in pages.PAGES for _, name, _, _ in pages.MARKED.findall(page.read_text())}
    assert used == set(tables.TABLES)
    assert all(make(pages.RESULTS) for make in tables.TABLES.values())


@every_page
def test_every_table_of_numbers_is_made_from_results(page):
    """But of synopses, words and names."""
    typed = pages.MARKED.sub("", page.read_text())
    for block in re.findall(r"^\|.*\n\|[-:| ]+\|\n((?:\|.*\n)+)", typed, re.M):
        rows = [[cell.strip() for cell in row.strip("|").split("|")] for row in block.splitlines()]
        numbers = [cell for row in rows for cell in row[1:] if re.fullmatch(r"[-+]?[\d.,]+( ?%|x)?", cell)]
        assert numbers == [], f"typed numbers {numbers[:5]}"


PICTURES = sorted(
    path
    for folder in ("analysis", "structures")
    for path in (ROOT / folder).rglob("*")
    if path.suffix in {".png", ".svg", ".jpg", ".webp", ".gif"} and "parts" not in path.parts
)
RECORDED = [
    *PICTURES,
    *NOTEBOOKS,
    *(ROOT / "analysis" / "scenes").glob("*.ipynb"),
    *made.RESULTS.glob("*.csv"),
]


@pytest.mark.parametrize("path", [p for p in RECORDED if p.name != made.RECORD], ids=lambda path: path.name)
def test_a_table_picture_or_notebook_is_the_one_of_its_record(path):
    """An old picture next to new tables has another digest, or another commit than they."""
    rows = pd.read_csv(made.RESULTS / made.RECORD, dtype=str, keep_default_na=False).set_index("table")
    row = rows.loc[path.name]
    assert row["digest"] == made.digest(path), f"run: {row['command']}"
    assert " " not in row["commit"] or path.name.startswith("mutants")
    alike = rows[(rows["command"] == row["command"]) & (rows["inputs"] == row["inputs"])]
    # Samples of faults are drawn at two commits.
    assert set(alike["commit"]) == {row["commit"]} or path.name.startswith("mutants")


def test_every_picture_of_a_page_has_its_row_and_a_job():
    """And none is in the repository that no page shows."""
    shown = {
        (page.parent / link).resolve()
        for page in (*ROOT.glob("*.md"), *(ROOT / "analysis").rglob("*.md"))
        for link in re.findall(r"!\[[^\]]*\]\(([^)#]+)\)", page.read_text())
    }
    rows = set(pd.read_csv(made.RESULTS / made.RECORD)["table"])
    jobs = {name for job in benchmarks.JOBS for name in job.tables}
    assert shown == set(PICTURES)
    assert {path.name for path in PICTURES} <= rows & jobs


def test_the_contents_list_every_page_and_section():
    contents = (ROOT / "analysis" / "README.md").read_text()
    for page in pages.DOCS.rglob("*.md"):
        place = page.relative_to(ROOT / "analysis")
        for line in pages.FENCED.sub("", page.read_text()).splitlines():
            if re.match("## ", line):
                assert f"]({place}#{pages.anchor(line[3:])})" in contents, line
        assert f"]({place})" in contents, place


def test_the_readme_tests_as_ci_does():
    (tested,) = [line for line in (ROOT / ".ci" / "run").read_text().splitlines() if ".[test]" in line]
    (quoted,) = [
        line for block in blocks(ROOT / "README.md", "sh") for line in block.splitlines() if "pytest" in line
    ]
    assert quoted.endswith(tested.replace("pip install -q", "pip install"))


def test_a_table_follows_its_results(tmp_path):
    """New results change it, and nothing around it; without them it stays."""
    text = "before\n<!-- table mechanics-scaling -->\nstale\n<!-- end -->\nafter\n"
    assert pages.rendered(text, tmp_path) == text
    for ns in (130.0, 250.0):
        row = {"hinges": [100], "ns_per_hinge": [ns], "bytes_per_hinge": [np.nan]}
        pd.DataFrame(row).to_csv(tmp_path / "mechanics_scaling.csv", index=False)
        lines = pages.rendered(text, tmp_path).splitlines()
        assert [lines[0], lines[-1]] == ["before", "after"] and "stale" not in lines
        assert [cell.strip() for cell in lines[4].split("|")[1:-1]] == ["100", f"{ns:.0f}", "-"]
    with pytest.raises(KeyError):
        pages.rendered("<!-- table nothing -->\n<!-- end -->", pages.RESULTS)


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
def test_commands_of_the_program_that_are_quoted_are_parsed(quoted):
    _program, command, *words = shlex.split(re.split(r" [<>|] ", quoted)[0])
    if words[:1] == ["all"]:
        benchmarks.parser().parse_args(words[1:])
    elif words[:1] == ["quick"]:
        made.parser("").parse_args(words[1:])
    elif command == "analysis/bench":
        assert bench_parser().parse_intermixed_args([word for word in words if word != "..."]).name in BENCH
    else:
        assert command in COMMANDS
        if words:
            COMMANDS[command].make_context(command, [word for word in words if word != "..."])


def test_pages_quote_commands_that_make_their_tables():
    """Each is a command of the one table, or its beginning; "..." or FILES stand for names of files."""
    known = [job.command for job in benchmarks.JOBS]
    for page in pages.PAGES:
        text = pages.MARKED.sub("", page.read_text())
        for quoted in re.findall(
            r"`(python analysis/benchmarks/[^`]+|python analysis/bench [^`]+-o DIR[^`]*)`", text
        ):
            quoted = " ".join(quoted.split())
            if quoted.split()[1:2] in (["all"], ["analysis/benchmarks/pages.py"]):
                continue
            if "..." in quoted or "FILES" in quoted:
                first, last = re.split(r" \S+ \.\.\. | FILES ", quoted)
                assert any(line.startswith(first) and line.endswith(last) for line in known), quoted
            else:
                assert any(line.startswith(quoted) for line in known), quoted


def test_every_benchmark_is_run_by_all():
    run = {word for job in benchmarks.JOBS for word in job.command.split() if word.endswith(".py")}
    run -= {"analysis/remake.py", "analysis/looks.py"}
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
        if script == "analysis/bench":
            assert bench_parser().parse_intermixed_args(words).name in STUDIES
            return
        if script not in ("analysis/remake.py", "analysis/looks.py"):
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
    with pytest.raises(SystemExit):
        bench_parser().parse_intermixed_args(["precision", "--nothing"])


STEPS = 6
IN_STEPS = f"""
import pathlib, signal, sys
folder = pathlib.Path(sys.argv[2])
folder.mkdir(parents=True, exist_ok=True)
left = [step for step in range({STEPS}) if not (folder / f"{{step}}").exists()]
for step in left[:{STEPS // 2}]:
    (folder / f"{{step}}").touch()
    with (folder.parent / "steps").open("a") as steps:
        steps.write(f"{{step}} ")
if left[{STEPS // 2}:]:
    signal.pause()
(folder / "a.csv").write_text("a\\n1\\n")
"""
AT_ONCE = """
import pathlib, sys
folder = pathlib.Path(sys.argv[2])
folder.mkdir(parents=True, exist_ok=True)
(folder / "a.csv").write_text("a\\n1\\n")
"""


def fake(name, code, minutes, **more):
    """A job that makes one table."""
    command = f"python -c {shlex.quote(code)} -o DIR"
    return benchmarks.Job(name, command, minutes, collects={"a.csv": (f"{name}.csv", ())}, **more)


@pytest.fixture
def part(tmp_path, monkeypatch, capfd):
    """A call of all.py with such jobs, as from a commit without changes: exit status, and what it says."""
    head = subprocess.run(["git", "rev-parse", "HEAD"], cwd=ROOT, capture_output=True, text=True)
    monkeypatch.setattr(made, "COMMIT", head.stdout.strip() or "0123456")
    monkeypatch.setattr(benchmarks, "PARTS", tmp_path / "parts")
    monkeypatch.setattr(benchmarks, "wait_until_idle", lambda: None)

    def call(jobs, *words):
        monkeypatch.setattr(benchmarks, "JOBS", jobs)
        monkeypatch.setattr(sys, "argv", ["all.py", "-o", str(tmp_path / "out"), *words])
        return benchmarks.main(), "".join(capfd.readouterr())

    return call


def test_all_goes_on_where_it_was_stopped(part, tmp_path):
    """In parts that are stopped: what is done is not repeated, and what reads a table waits for it."""

    def noted(name, **more):
        note = f"open({str(tmp_path / 'ran')!r}, 'a').write('{name} ')"
        return fake(name, AT_ONCE + note, 0.0, **more)

    once = noted("once")
    jobs = (once, fake("parts", IN_STEPS, 99.0, continues=True), noted("reads", after="parts"))
    said = []
    while not said or (said[-1][0] == 3 and len(said) < 60):
        said.append(part(jobs, "--minutes", "0.03"))
        assert (tmp_path / "out" / "reads.csv").exists() == (said[-1][0] == 0)
    assert len(said) > 1 and [status for status, _ in said] == [3] * (len(said) - 1) + [0]
    assert "left: parts: goes on" in said[0][1] and "left: reads: after parts" in said[0][1]
    (steps,) = (tmp_path / "parts").rglob("steps")
    assert steps.read_text().split() == [str(step) for step in range(STEPS)]
    assert (tmp_path / "ran").read_text().split() == ["once", "reads"]
    status, text = part(jobs, "--list")
    assert status == 0 and len(re.findall(r"^(?:once|parts|reads) .* min  done ", text, re.M)) == 3
    assert re.search(r"^all +0 min", text, re.M)
    assert part((once,), "--again")[0] == 0
    assert (tmp_path / "ran").read_text().split() == ["once", "reads", "once"]


def test_all_jobs_fit_into_parts_of_forty_minutes():
    assert [
        job.name for job in benchmarks.JOBS if job.minutes > 40 and not (job.continues or job.apart)
    ] == []


@pytest.mark.parametrize("folder", [made.MORE, "/some/collection", "../collection", "collection"])
def test_a_record_names_no_folder_of_the_one_who_made_it(folder):
    words = ["python", "files.py", "speed", "--more", str(folder), "-o", "out"]
    assert made.command(words) == "python files.py speed --more MORE -o DIR"


def test_the_tables_of_the_jobs_are_those_that_there_are():
    """But those of the mutants, which is no benchmark; each is of one job."""
    there = set(pd.read_csv(made.RESULTS / "made.csv")["table"])
    assert sorted(name for job in benchmarks.JOBS for name in job.tables) == sorted(
        name for name in there if not name.startswith("mutants")
    )


def test_tables_are_of_today_until_the_code_changes(tmp_path, monkeypatch):
    """Results and pages may, in commits that are not the code's; what is not committed is of no commit."""

    def git(*words):
        who = ["-c", "user.name=test", "-c", "user.email=test@example.org"]
        return subprocess.run(["git", *who, *words], cwd=tmp_path, check=True, capture_output=True)

    def change(name, text):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)

    def today():
        monkeypatch.setattr(made, "COMMIT", made.commit())
        return made.is_of_today(first)

    monkeypatch.setattr(made, "ROOT", tmp_path)
    git("init", "-q")
    for name in ("protochain/code.py", "page.md", "analysis/results/a.csv"):
        change(name, "1")
    git("add", "."), git("commit", "-q", "-m", "1")
    first = made.commit()
    assert today()
    change("page.md", "2"), change("analysis/results/a.csv", "2")
    assert today()
    git("commit", "-q", "-a", "-m", "2")
    assert made.commit() == first and today()
    change("protochain/code.py", "2")
    assert not today() and not made.is_of_today(made.commit())
    git("commit", "-q", "-a", "-m", "3")
    assert not today()
    assert not made.is_of_today("no such commit") and not made.is_of_today("0123456")


def test_which_tables_are_older_than_the_code():
    """It fails for none: it says which are to be made again, as ``pytest -rs`` shows."""
    rows = pd.read_csv(made.RESULTS / "made.csv", dtype=str)
    made_at = {commit: made.is_of_today(commit) for commit in set(rows["commit"])}
    if older := [
        table for table, commit in zip(rows["table"], rows["commit"], strict=True) if not made_at[commit]
    ]:
        pytest.skip(f"older than the code: {len(older)} of {len(rows)}: {', '.join(older)}")


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
    words = ["git", "log", "-1", "--format=%h", "--", *made.CODE]
    head = subprocess.run(words, cwd=ROOT, capture_output=True, text=True)
    assert row["commit"] == made.COMMIT and float(row["seconds"]) >= 0.0
    assert made.commit().removesuffix(" and changes") == (head.stdout.strip() or "none: an installed package")
    assert pd.read_csv(tmp_path / "race.csv")["a"].tolist() == [2]


def test_no_result_names_a_folder_of_a_machine():
    for path in sorted(made.RESULTS.glob("*.csv")):
        assert not re.search(r"(?:^|[ ,\"'])/(?:home|work|tmp|root|usr)/", path.read_text(), re.M), path.name


def test_the_dipeptide_is_capped_alanine():
    structure = importlib.import_module("dipeptide").molecule()
    assert list(structure.residue_name) == ["ACE", "ALA", "NME"]
    assert structure.n_atoms == 22
