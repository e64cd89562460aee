"""The mutation run: what it changes, and that the tests notice it."""

import ast
import random

import mutants
import pytest
import semantic_faults

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


MEANING = """
class A:
    low: float
    high: float = 1.0
    def widen(self) -> A:
        self.count += 1
        self.cache[1] = 2
        return A(self.low, high=self.high)
def key_of(a: str, b: str, c: int) -> tuple:
    if a:
        raise ValueError({"a": a, "b": b})
    rows = {
        "low": a,
        "high": max(b, key=len),
    }
    return (a, b, c)
def call(a: str, b: str) -> str:
    return key_of(a, b, 2)
"""
PLACES = (("low", "float"), ("high", "float"))
SIGNATURES = {
    "A": semantic_faults.Signature(PLACES, PLACES, frozenset({"high"})),
    "key_of": semantic_faults.Signature((("a", "str"), ("b", "str"), ("c", "int")), (), frozenset()),
}


def test_faults_of_meaning_are_of_every_kind_and_not_in_messages():
    found = {(kind, line.strip()) for _, kind, line in semantic_faults.changes(MEANING, SIGNATURES)}
    assert found == {
        ("update", "pass"),
        ("other variable", "return A(self.high, high=self.high)"),
        ("other variable", "return A(self.low, high=self.low)"),
        ("keyword", "return A(self.low)"),
        ("input returned", "return self"),
        ("other variable", "if b:"),
        ("key", ""),
        ("other variable", '"low": b,'),
        ("other variable", '"high": max(a, key=len),'),
        ("sort key", '"high": next(iter(b)),'),
        ("other variable", "return (b, b, c)"),
        ("other variable", "return (a, a, c)"),
        ("update", "return (b, c)"),
        ("update", "return (a, c)"),
        ("update", "return (a, b)"),
        ("swapped arguments", "return key_of(b, a, 2)"),
        ("other variable", "return key_of(b, b, 2)"),
        ("other variable", "return key_of(a, a, 2)"),
        ("input returned", "return a"),
    }
    # A cache saves time only.
    assert (
        len([kind for _, kind, line in semantic_faults.changes(MEANING, SIGNATURES) if "pass" in line]) == 1
    )


def test_a_sample_of_meaning_has_different_kinds_in_each_package():
    every = mutants.faults_of_meaning("searching", mutants.ROOT)
    sample = mutants.sample_kinds(every, 4, random.Random(1))
    assert len({fault.kind for fault in sample}) == 4
    assert sample == mutants.sample_kinds(every, 4, random.Random(1))
    near = mutants.nearest_tests(sample[0], mutants.ROOT, 3)
    assert len(near) == 3 and all((mutants.ROOT / test.split("::")[0]).is_file() for test in near)


def test_an_excuse_is_of_a_fault_that_could_be_made():
    parts = {file.removeprefix("protochain/") for file, _ in mutants.excuses()}
    makers = mutants.faults, mutants.faults_of_meaning
    made = (fault for part in parts for faults in makers for fault in faults(part, mutants.ROOT))
    assert mutants.excuses().keys() <= {(fault.file, fault.fault) for fault in made}


@pytest.mark.slow
def test_the_tests_notice_most_random_faults():
    ended = mutants.mutation_run([*mutants.FOLDERS], number=1, seed=2, jobs=2, tree=mutants.ROOT)
    noticed = sum(fault.result != "survived" for fault in ended)
    assert noticed >= 0.85 * len(ended), [fault for fault in ended if fault.result == "survived"]
