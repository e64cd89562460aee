"""Examples at the end of the help of each command: they are parsed, and run in the slow tests."""

import re
import shlex

import pytest
from click.testing import CliRunner
from fixtures.command_line import COMMANDS, run
from fixtures.samples import STRUCTURES

from protochain.cli.help import examples

EXAMPLES = examples()
LINES = [(name, line) for name, lines in EXAMPLES.items() for line in lines]
EXISTING = re.compile(r"\.(pdb|cif)(\.gz)?$")


def test_every_help_ends_with_examples():
    assert {*EXAMPLES} | {"minimize"} == {*COMMANDS}
    for name, lines in EXAMPLES.items():
        help_text = CliRunner().invoke(COMMANDS[name], ["--help"]).output
        assert len(lines) in (2, 3)
        last = help_text.partition("\nExamples:\n")[2].splitlines()
        assert last == [f"  protochain {line}" for line in lines]
        assert max(map(len, last)) <= 80


@pytest.mark.parametrize(("name", "line"), LINES, ids=[line for _, line in LINES])
def test_an_example_is_of_the_command_and_of_files_that_exist(name, line):
    words = shlex.split(line)
    assert words[0] == name
    COMMANDS[name].make_context(name, words[1:])
    outputs = {
        words[k + 1] for k, word in enumerate(words[:-1]) if word.startswith("-") and "reference" not in word
    }
    files = [word for word in words[1:] if EXISTING.search(word) and word not in outputs]
    assert all((STRUCTURES / file).is_file() for file in files)
    assert files or name in {"build", "search", "schema"}


@pytest.mark.slow
@pytest.mark.parametrize(("name", "line"), LINES, ids=[line for _, line in LINES])
def test_an_example_runs(name, line, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for path in STRUCTURES.iterdir():
        (tmp_path / path.name).symlink_to(path)
    before = {*tmp_path.iterdir()}
    # Status 3 is a usable result that is not converged.
    assert run(*shlex.split(line)) in (0, 3, None)
    is_printed = name in {"energy", "rmsd", "info", "schema", "score", "validate"} and "csv" not in line
    assert is_printed or {*tmp_path.iterdir()} > before
