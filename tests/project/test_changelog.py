"""The CHANGELOG names every difference between the public interface and that of the last release."""

import re
import tomllib

import pytest
from fixtures.public_names import interface
from fixtures.samples import ROOT
from released import FILE

CHANGELOG = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
SECTIONS = dict(re.findall(r"^## \[([^]]+)\].*?\n(.*?)(?=^## |\Z)", CHANGELOG, re.MULTILINE | re.DOTALL))
VERSION = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]


def unnamed(released: dict[str, str], present: dict[str, str], text: str) -> list[str]:
    """Return added, removed and changed names whose last word the text does not contain."""
    changed = {name for name in released | present if released.get(name) != present.get(name)}
    # A new function brings its parameters, and a new command its options.
    owners = {name for name in changed if (name in released) != (name in present)}
    changed -= {name for name in changed if name.rpartition(" ")[0] in owners}
    words = {name: re.split(r"[ .]", name)[-1] for name in changed}
    said = set(re.findall(r"[\w-]+", text))
    return sorted(name for name, word in words.items() if word not in said)


def test_public_changes_since_the_release_have_a_line_under_unreleased():
    released = dict(line.split("\t") for line in FILE.read_text(encoding="utf-8").splitlines())
    missing = unnamed(released, interface(), SECTIONS["Unreleased"])
    assert not missing, f"describe in CHANGELOG.md under Unreleased: {missing}"


@pytest.mark.parametrize(
    ("present", "text", "missing"),
    [
        ({"minimise": "", "minimise seed": "0", "relax --cap": "None"}, "", []),
        ({"minimise": "", "minimise seed": "1", "relax --cap": "None"}, "The default of `seed` is 1.", []),
        ({"minimise": "", "minimise seed": "1", "relax --cap": "None"}, "`seeds`", ["minimise seed"]),
        ({"minimise": "", "minimise seed": "0"}, "`relax --caps`", ["relax --cap"]),
        (
            {"minimise": "", "minimise seed": "0", "relax --cap": "None", "scan": "", "scan step": "1"},
            "", ["scan"],
        ),
    ],
)  # fmt: skip
def test_a_change_without_a_line_is_noticed(present, text, missing):
    released = {"minimise": "", "minimise seed": "0", "relax --cap": "None"}
    assert unnamed(released, present, text) == missing


def test_the_version_has_a_section():
    assert SECTIONS[VERSION].strip()
