"""Settings: fields of frozen values, each declared once with its check, its help and its option.

Functions use them by name, commands as their options, and batches as the columns of their manifests.
"""

import inspect
import itertools
import linecache
import re
import sys
import textwrap
from collections.abc import Callable, Iterator, Mapping
from dataclasses import Field, dataclass, field, fields, is_dataclass
from functools import cached_property, wraps
from typing import Any, ParamSpec, TypeVar

from protochain.core.checks import Check, check_fields

Made = TypeVar("Made")
Documented = TypeVar("Documented", bound=Callable[..., Any])
P = ParamSpec("P")


@dataclass(frozen=True)
class Setting:
    """Data of a field for commands and manifests, in addition to its name and default."""

    # (value, name) -> the value that functions work with, as those of :mod:`protochain.core.checks`.
    check: Check
    help: str = ""  # Of the option; a field without help has none.
    kind: Any = str  # Of what an option or a cell of a manifest gives.
    # The option's names, where they are not the field's, the first of which is said; one that begins with
    # ``--no-`` turns a field off that is on.
    option: str = ""
    read: Callable[[Any], Any] | None = None  # (what is given) -> value of the field; as of degrees.
    metavar: str | None = None  # What stands for the value in the help.
    # A further option without a value: its name, its help, and what it puts before the values given.
    word: tuple[str, str, str] | None = None
    doc: str = ""  # In docstrings, if they say more than the help of the option.
    type: str = ""  # In docstrings, if it is not the type of the field.

    @property
    def turns_off(self) -> bool:
        """Whether the option turns off a feature that is on."""
        return self.option.startswith("--no-")

    def names(self, field: str) -> list[str]:
        """Names of the option of a field."""
        return self.option.split() or [f"--{field.replace('_', '-')}"]

    def columns(self, field: str) -> list[str]:
        """Names of a field in a manifest, as its option's if this sets the value. Others are former names."""
        if "/" in self.option or self.turns_off:
            return [field]
        return [name.removeprefix("--").replace("-", "_") for name in self.names(field)]


def setting(default: Any, help: str, check: Check, kind: Any = str, option: str = "", **metadata: Any) -> Any:
    """Field of a frozen dataclass of settings, with arguments as for :class:`Setting`."""
    return field(default=default, metadata={"setting": Setting(check, help, kind, option, **metadata)})


class Settings:
    """Base of frozen dataclasses of settings, whose fields are checked when one is made."""

    def __post_init__(self) -> None:
        check_fields(self, **{name: entry.check for name, entry in settings_of(type(self))})


def settings_of(kind: type) -> Iterator[tuple[str, Setting]]:
    """Names and settings of the fields of a dataclass that were declared by :func:`setting`."""
    for column in fields(kind):
        if "setting" in column.metadata:
            yield column.name, column.metadata["setting"]


def document_settings(*kinds: type) -> Callable[[Documented], Documented]:
    """Decorate a function: its docstring gets an entry for each setting of these classes."""

    def decorate(target: Documented) -> Documented:
        text = inspect.getdoc(target) or ""  # There is none if Python optimises.
        before, heading, after = text.partition("Parameters\n----------\n")
        written, end, tail = after.partition("\n\n")
        entries = {item.name: _entry(item) for kind in kinds for item in fields(kind) if item.metadata}
        # An entry of the docstring itself may be of several parameters.
        for entry in re.split(r"\n(?=\S)", written):
            entries |= dict.fromkeys(entry.partition(" : ")[0].split(", "), entry)
        ordered = dict.fromkeys(entries[name] for name in inspect.signature(target).parameters)
        if heading:
            target.__doc__ = "".join((before, heading, "\n".join(ordered), end, tail, "\n"))
        return target

    return decorate


def _entry(item: "Field[Any]") -> str:
    """Entry of a setting in the section of parameters of a docstring."""
    described: Setting = item.metadata["setting"]
    kind = described.type or getattr(item.type, "__name__", str(item.type).replace(" | None", ", optional"))
    text = described.doc or described.help
    return _entry_of(item.name, kind, f"One of {text}" if text[:1].islower() else text)


def _entry_of(name: str, kind: str, text: str) -> str:
    lines = textwrap.fill(text, 100, break_on_hyphens=False)
    return f"{name} : {kind}\n{textwrap.indent(lines, '    ')}"


_FIELD = re.compile(r"^((?: {4,8}# .*\n)*) {4,8}(\w+): (.+?)(?: = .*?)?(?:  # (.*))?$", re.MULTILINE)
"""Comment above a field, its name, its type, and the comment behind it."""
_COMMENT = re.compile(r"(?:([^A-Z`:][^:]*|K): )?(.*)")  # Unit or shape, and text, of a comment.


def document_fields(kind: type[Made]) -> type[Made]:
    """Decorate a dataclass or NamedTuple: its docstring gets entries for settings and fields with comments.

    The comment is above or behind the field. It may begin with a unit, as ``nm: Distance.``, or with a shape
    and unit in place of the type, as ``(n, 3) float, nm: Positions.``
    """
    documentation = _Documentation(kind, kind.__doc__ or "")
    # ``help`` does not read the descriptor of a class with a metaclass.
    kind.__doc__ = documentation if type(kind) is type else documentation.docstring  # type: ignore[assignment]
    return kind


@dataclass(frozen=True)
class _Documentation:
    """Docstring of a class, composed from its source when it is read."""

    kind: type
    text: str

    def __get__(self, instance: object, owner: type) -> str:
        return self.docstring

    @cached_property
    def docstring(self) -> str:
        entries: dict[str, str] = {}
        for base in (self.kind, *filter(is_dataclass, self.kind.__mro__[1:])):
            for above, name, annotation, behind in _FIELD.findall(_source(base)):
                unit, text = _COMMENT.findall(" ".join(f"{above.replace('# ', '')} {behind}".split()))[0]
                parts = [annotation.removesuffix(" | None").strip("'\""), unit]
                parts += ["optional"] * annotation.endswith(" | None")
                described = unit if unit.startswith("(") else ", ".join(filter(None, parts))
                if text:
                    entries.setdefault(name, _entry_of(name, described, text))
        for item in fields(self.kind) if is_dataclass(self.kind) else ():
            if item.metadata:
                entries.setdefault(item.name, _entry(item))
        before, *sections = re.split(r"\n\n(?=\w+\n---)", inspect.cleandoc(self.text), maxsplit=1)
        listed = [entries[name] for name in inspect.signature(self.kind).parameters if name in entries]
        return "\n\n".join([before, "\n".join(["Parameters\n----------", *listed]), *sections]) + "\n"


def _source(kind: type) -> str:
    """Source of a class below its name. Empty if the file of its module is missing."""
    # Much quicker than inspect.getsource, which parses the file.
    lines = linecache.getlines(getattr(sys.modules[kind.__module__], "__file__", None) or "")
    heads = f"class {kind.__name__}:", f"class {kind.__name__}("
    below = itertools.dropwhile(lambda line: not line.startswith(heads), lines)
    return "".join(itertools.takewhile(lambda line: line[:1] in " )\n", itertools.islice(below, 1, None)))


def settings_from(kind: type[Made], arguments: Mapping[str, Any], **other_fields: Any) -> Made:
    """Settings of the arguments of a call by their names. ``other_fields`` are not settings."""
    return kind(**{name: arguments[name] for name, _ in settings_of(kind)}, **other_fields)


def without_none(**options: Any) -> dict[str, Any]:
    """Options that are not None."""
    return {name: value for name, value in options.items() if value is not None}


def inheriting(
    build: Callable[[Callable[..., Made], Any, dict[str, Any]], Made],
) -> Callable[[Callable[P, Made]], Callable[P, Made]]:
    """Decorate a function: ``build`` calls it, with its first argument and those that a caller has named."""

    def decorate(function: Callable[P, Made]) -> Callable[P, Made]:
        signature = inspect.signature(function)
        first = next(iter(signature.parameters))

        @wraps(function)
        def call(*args: P.args, **kwargs: P.kwargs) -> Made:
            arguments = signature.bind(*args, **kwargs).arguments
            return build(function, arguments.pop(first), arguments)

        return call

    return decorate
