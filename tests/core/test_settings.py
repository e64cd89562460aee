"""Settings are described once, and docstrings have what they say."""

import inspect
from dataclasses import dataclass, field

import pytest
from fixtures.refusals import expect_refusal
from numpydoc.docscrape import FunctionDoc

import protochain as pc
from protochain.batches import BatchSettings
from protochain.core import settings
from protochain.core.checks import check_arguments, number, text
from protochain.core.settings import Settings, document_fields, document_settings, setting, settings_of
from protochain.dynamics.simulate_settings import RunSettings, SimulationSettings
from protochain.minimisers.minimise_settings import CheckpointSettings, MinimiseSettings, StartSettings
from protochain.searching.search_settings import SearchRunSettings, SearchSettings


@dataclass(frozen=True)
class Heating(Settings):
    """Settings of a test."""

    kind: str = setting("fast", "fast or slow.", text)
    heat: float | None = setting(None, "Heat, kJ/mol.", number, float)
    speed: float = setting(1.0, "In DIR.", number, float, doc="Speed, nm/ps.", type="float, nm/ps")


def test_entries_follow_the_signature_and_an_entry_of_the_docstring_itself_stays():
    @document_settings(Heating)
    def heat_up(source, speed=1.0, heat=None, last="", kind="fast"):
        """Heat up.

        Parameters
        ----------
        source, last : str
            Names.

        Returns
        -------
        None
        """

    read = {
        tuple(each.name.split(", ")): (each.type, each.desc) for each in FunctionDoc(heat_up)["Parameters"]
    }
    assert read == {
        ("source", "last"): ("str", ["Names."]), ("speed",): ("float, nm/ps", ["Speed, nm/ps."]),
        ("heat",): ("float, optional", ["Heat, kJ/mol."]), ("kind",): ("str", ["One of fast or slow."]),
    }  # fmt: skip
    assert [*read] == [("source", "last"), ("speed",), ("heat",), ("kind",)]
    assert FunctionDoc(heat_up)["Returns"][0].type == "None"


@document_fields
@dataclass(frozen=True)
class Spring:
    """A spring of a test.

    Examples
    --------
    >>> Spring
    """

    # kJ/mol/nm^2: Constant k, for E = k/2 (x - x0)^2: the energy.
    stiffness: float
    rest: "float" = 0.0  # (n,) float, nm: Distances x0.
    name: str | None = None  # Name, as ``a: b``.
    atoms: tuple[int, ...] = field(default=(1,))  # Two
    count = 3  # Not a field.

    def stretch(self) -> None:
        count: int = 1  # Not a field either.
        assert count


@document_fields
@dataclass(frozen=True)
class Rod(Spring):
    """A rod."""

    rest: float = 1.0  # nm: Its length.


def test_comments_of_fields_are_the_parameters_of_a_class():
    read = {each.name: (each.type, " ".join(each.desc)) for each in FunctionDoc(Spring)["Parameters"]}
    assert read == {
        "stiffness": ("float, kJ/mol/nm^2", "Constant k, for E = k/2 (x - x0)^2: the energy."),
        "rest": ("(n,) float, nm", "Distances x0."), "name": ("str, optional", "Name, as ``a: b``."),
        "atoms": ("tuple[int, ...]", "Two"),
    }  # fmt: skip
    assert FunctionDoc(Spring)["Examples"] == [">>> Spring"]
    rod = {each.name: " ".join(each.desc) for each in FunctionDoc(Rod)["Parameters"]}
    assert rod == {name: text for name, (_, text) in read.items()} | {"rest": "Its length."}


@pytest.mark.parametrize(
    ("function", "kinds"),
    [
        (pc.simulate, (SimulationSettings, RunSettings)),
        (pc.minimise, (MinimiseSettings, CheckpointSettings)),
        (pc.search, (SearchSettings, SearchRunSettings)),
        (BatchSettings, (StartSettings,)),
    ],
)
def test_functions_describe_every_setting_by_its_own_words(function, kinds):
    described = {each.name: " ".join(each.desc) for each in FunctionDoc(function)["Parameters"]}
    assert [*described] == [*inspect.signature(function).parameters]
    for kind in kinds:
        for name, each in settings_of(kind):
            assert described[name].endswith(each.doc or each.help), name


@pytest.mark.parametrize("takes_more", [False, True])
def test_a_former_keyword_is_accepted_with_a_warning_that_names_the_new_one(takes_more):
    @check_arguments(restraints=text)
    def hold(restraints=""):
        return restraints

    @check_arguments()
    def pass_on(**settings):
        return hold(**settings)

    function = pass_on if takes_more else hold
    with pytest.warns(
        DeprecationWarning, match=f"{function.__name__}: restraint= is now restraints="
    ) as seen:
        assert function(restraint="500") == "500"
    assert len(seen) == 1 and seen[0].filename == __file__
    with pytest.raises(TypeError, match="'restraint'"):
        function(restraint="500", restraints="400")
    with pytest.warns(DeprecationWarning), expect_refusal("restraints", "max_rmsd"):
        pc.explore(None, n_starts=2, restraint="500")


def test_the_docstring_of_a_class_is_composed_when_it_is_read(monkeypatch):
    """Sources of 44 classes would be read at every start."""
    sources = []
    monkeypatch.setattr(settings, "_source", lambda kind: sources.append(kind) or "    n: int  # nm: Size.\n")

    @document_fields
    @dataclass
    class Example:
        """An example."""

        n: int

    assert not sources
    assert Example.__doc__ == "An example.\n\nParameters\n----------\nn : int, nm\n    Size.\n"
    assert Example(1).__doc__ is Example.__doc__ and sources == [Example]
