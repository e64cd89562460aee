"""The mutation run: what it changes, and that the tests notice it."""

import ast
import subprocess

import mutants
import pytest
from coverage import CoverageData

CODE = '''
"""Of a module."""
__all__ = ["a"]
LIMIT: float = 2.5
def a(x: int = 3) -> bool:
    """Of a function."""
    for i, j in zip(x, x, strict=True):
        x[i] = j
    return x < LIMIT and not b(x + 1, key="name")
'''


def changed():
    found = set()
    for node in mutants.sites(ast.parse(CODE)):
        found |= {(kind, ast.unparse(node), ast.unparse(new)) for kind, new in mutants.changes(node)}
    return found


def test_faults_are_put_into_what_runs_and_nowhere_else():
    assert changed() == {
        ("value", "2.5", "5.0"),
        ("value", "3", "4"),
        ("left out", "x[i] = j", "pass"),
        ("condition", "x < LIMIT and (not b(x + 1, key='name'))", "x < LIMIT or not b(x + 1, key='name')"),
        ("comparison", "x < LIMIT", "x <= LIMIT"),
        ("sign", "not b(x + 1, key='name')", "b(x + 1, key='name')"),
        ("keyword left out", "b(x + 1, key='name')", "b(x + 1)"),
        ("operator", "x + 1", "x - 1"),
        ("value", "1", "2"),
        ("name", "'name'", "'nameX'"),
    }


def test_lines_that_run_on_import_have_the_tests_of_all_functions_of_their_file(tmp_path, monkeypatch):
    """Coverage gives them to whichever test is the first to import the file."""
    file = tmp_path / "a.py"
    file.write_text(
        "LIMIT = 2\ndef f(x=1):\n    return x\nclass C:\n    y = 3\n    def g(self):\n        return 4\n"
    )
    constants = tmp_path / "b.py"
    constants.write_text("NAME = 1\n")

    def run(command, cwd, **options):
        cases = "".join(f'<testcase classname="tests.test_a" name="{name}" time="0.5"/>' for name in "uvw")
        failing = '<testcase classname="tests.test_a" name="x" time="1"><failure/></testcase>'
        (cwd / "timing.xml").write_text(f"<testsuite>{cases}{failing}</testsuite>")
        data = CoverageData(str(cwd / ".coverage"))
        for test, at, lines in (
            ("", file, [1]),
            ("u", file, [1, 2, 4, 5, 6, 3]),
            ("v", file, [7]),
            ("w", constants, [1]),
        ):
            data.set_context(test and f"tests/test_a.py::{test}|run")
            data.add_lines({str(at): lines})
        data.write()

    monkeypatch.setattr(subprocess, "run", run)
    reached, seconds = mutants.tests_of_lines(tmp_path, 1)
    u, v, w = (f"tests/test_a.py::{name}" for name in "uvw")
    assert seconds == dict.fromkeys((u, v, w), 0.5)
    assert {line: tests for (at, line), tests in reached.items() if at == "a.py"} == {
        1: {u, v}, 2: {u, v}, 3: {u}, 4: {u, v}, 5: {u, v}, 6: {u, v}, 7: {v},
    }  # fmt: skip
    assert reached["b.py", 1] == {w}


def test_an_excuse_is_of_a_fault_that_could_be_made():
    parts = {file.removeprefix("protochain/") for file, _ in mutants.excuses()}
    possible = {(fault.file, fault.fault) for part in parts for fault in mutants.faults(part, mutants.ROOT)}
    assert mutants.excuses().keys() <= possible


@pytest.mark.slow
def test_the_tests_notice_most_random_faults():
    ended = mutants.mutation_run([*mutants.FOLDERS], number=4, seed=2, jobs=2, tree=mutants.ROOT)
    noticed = sum(fault.result != "survived" for fault in ended)
    assert noticed >= 0.85 * len(ended), [fault for fault in ended if fault.result == "survived"]
