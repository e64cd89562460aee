"""Messages in the words of the command line, and numbers with the right form of what they count."""

import ast
import re
from pathlib import Path

from click.testing import CliRunner
from fixtures.command_line import COMMANDS, refusal_as_said
from fixtures.samples import STRUCTURES
from typer.core import TyperOption

import protochain as pc
from protochain.cli.help import _FEW, _FIRST, _GROUPS
from protochain.cli.options import as_option
from protochain.core.errors import Argument

SOURCES = [*Path(pc.__file__).parent.rglob("*.py")]
OF_THE_LIBRARY = {"x"}
"""Arguments of functions that no command calls with them."""
OPTIONS = {
    name for each in COMMANDS.values() for param in each.params if isinstance(param, TyperOption)
    for name in (*param.opts, *param.secondary_opts)
}  # fmt: skip


def test_the_command_line_has_an_option_of_each_argument_that_messages_name():
    named = {}
    for path in SOURCES:
        for node in ast.walk(ast.parse(path.read_text())):
            is_one = isinstance(node, ast.Call) and getattr(node.func, "id", "") == "Argument"
            if is_one and isinstance(node.args[0], ast.Constant):
                named[node.args[0].value] = path.name
    assert len(named) > 20
    wrong = {name: path for name, path in named.items() if as_option(Argument(name)) not in OPTIONS}
    assert {*wrong} == OF_THE_LIBRARY, wrong


def test_the_library_names_no_options_of_the_command_line():
    """But in the settings, which are its options."""
    shown = re.compile(r"(?<![\w-])--[a-z][a-z-]+")
    for path in SOURCES:
        if "cli" not in path.parts and not path.name.endswith(("setup.py", "settings.py")):
            tree = ast.parse(path.read_text())
            docs = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
            for node in ast.walk(tree):
                if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in docs:
                    assert not OPTIONS & {*shown.findall(node.value)}, (path, node.value)


def test_a_row_of_scores_is_no_atom(tmp_path):
    text = (STRUCTURES / "ala10.pdb").read_text()
    (tmp_path / "scored.pdb").write_text(f"{text}label fa_atr\natom_pair_constraint 0 0\npose 1\n")
    scored = pc.load(tmp_path / "scored.pdb")
    assert scored.n_atoms == pc.load(STRUCTURES / "ala10.pdb").n_atoms
    assert [*map(str, scored.repairs)] == [*map(str, pc.load(STRUCTURES / "ala10.pdb").repairs)]


def test_an_input_that_is_not_there_is_named_before_its_output():
    assert refusal_as_said("relax", "missing/", "-o", "x") == "missing: not found; check the name"


def test_values_of_options_and_arguments_have_few_names():
    """On all commands; others than words show what is typed, as ``A:3-A:40``."""
    found = {(param.metavar or "").strip("[].") for each in COMMANDS.values() for param in each.params}
    assert {word for word in found if re.fullmatch("[A-Z]{2,}", word)} == {
        "IN", "FILE", "DIR", "FRAMES", "FASTA", "COLUMN", "REFERENCE", "SEQUENCE", "COMMAND",
    }  # fmt: skip


LONG = re.compile("--")


def test_help_names_options_that_there_are_and_what_is_used_most_comes_first():
    known = {param.name for command in COMMANDS.values() for param in command.params}
    grouped = {name for names in _GROUPS.values() for name in names.split()}
    assert {*_FIRST} <= known and grouped <= known
    for name, command in COMMANDS.items():
        shown = CliRunner().invoke(command, ["--help"]).output
        own = {param.name: ([*filter(LONG.match, param.opts)] or param.opts)[0] for param in command.params}
        first = [own[each] for each in _FIRST if each in own and own[each].startswith("--")][:_FEW]
        part = shown.partition("Used most:")[2].split("\n\n")[0]
        assert re.findall(r"(?m)^  (?:-\w, )?(--[\w-]+)", part) == first, name
