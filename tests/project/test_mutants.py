"""The mutation run: what it changes, and that the tests notice it."""

import ast

import mutants
import pytest

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


def test_an_excuse_is_of_a_fault_that_could_be_made():
    parts = {file.removeprefix("protochain/") for file, _ in mutants.excuses()}
    possible = {(fault.file, fault.fault) for part in parts for fault in mutants.faults(part, mutants.ROOT)}
    assert mutants.excuses().keys() <= possible


@pytest.mark.slow
def test_the_tests_notice_most_random_faults():
    ended = mutants.mutation_run([*mutants.FOLDERS], number=1, seed=2, jobs=2, tree=mutants.ROOT)
    noticed = sum(fault.result != "survived" for fault in ended)
    assert noticed >= 0.85 * len(ended), [fault for fault in ended if fault.result == "survived"]
