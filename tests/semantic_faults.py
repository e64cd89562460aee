"""Faults of meaning: changes of a line that runs on and that a tired programmer makes.

A function for each kind yields :class:`Change` of a :class:`Site`. Three groups of faults are left out, since
they change nothing or end every run: those in messages, those of caches that save time only, and keywords
without a default.
"""

import ast
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from pathlib import Path

UPDATES = {"append", "add", "update", "extend", "discard", "remove", "clear", "insert", "truncate", "pop"}
"""Methods that change their object. Their result is not used where the call is a statement."""
CACHE = re.compile(r"cache|memo|lru|scratch|buffer")
KEY = re.compile(r"(^|_)(key|keys|identity|digest|fingerprint)(_|$)")
"""Names of the key of a cache, and of what identifies a job."""
COMMUTING = {"dot", "rmsd", "distance", "distances", "_differences", "overlap", "same"}
"""Functions of the package whose arguments may change places."""
MESSAGES = re.compile(r"Error$|Warning$|^(refusal|warn|print|fail|Argument|Column|Option|setting)$")


@dataclass(frozen=True)
class Signature:
    """Positional parameters with their types, the types of all, and those with a default."""

    positional: tuple[tuple[str, str], ...]
    kinds: tuple[tuple[str, str], ...]
    optional: frozenset[str]


@dataclass(frozen=True)
class Site:
    """A node with the function and the class around it."""

    node: ast.AST
    function: ast.FunctionDef | None
    owner: ast.ClassDef | None
    signatures: Mapping[str, Signature]


@dataclass(frozen=True)
class Change:
    """A kind of fault, the first and the last node that it replaces, and their new text.

    Without a text, the nodes are removed with their comma and with ``before`` characters in front.
    """

    kind: str
    first: ast.AST
    last: ast.AST
    text: str = ""
    before: int = 0

    def put_into(self, lines: list[str]) -> str | None:
        """Return the new line, or None if the change spans lines or the line is not ASCII."""
        first, last = self.first, self.last
        line = lines[first.lineno - 1]
        if first.lineno != last.end_lineno or not line.isascii():
            return None
        head, tail = line[: first.col_offset - self.before], line[last.end_col_offset :]
        if self.text:
            return head + self.text + tail
        if comma := re.match(r"\s*,\s*", tail):
            return head + tail[comma.end() :]
        return re.sub(r",\s*$", "", head) + tail


def drop_key(site: Site) -> Iterator[Change]:
    """Delete a key of a dictionary, or a name of a list of names."""
    match site.node:
        case ast.Dict(keys=keys, values=values) if len(keys) > 1:
            for key, value in zip(keys, values, strict=True):
                yield Change("key", key or value, value, before=0 if key else 2)
        case ast.Tuple(elts=names) | ast.List(elts=names) | ast.Set(elts=names) if len(names) > 2:
            if all(isinstance(name, ast.Constant) and isinstance(name.value, str) for name in names):
                for name in names:
                    yield Change("key", name, name)


def swap_arguments(site: Site) -> Iterator[Change]:
    """Swap two neighbouring arguments of the same type."""
    if not isinstance(site.node, ast.Call) or not (known := signature(site)):
        return
    places = list(zip(site.node.args, known.positional, strict=False))
    for (a, (_, kind)), (b, (_, other)) in pairwise(places):
        if kind and kind == other and is_variable(a) and is_variable(b) and not same(a, b):
            yield Change("swapped arguments", a, b, f"{ast.unparse(b)}, {ast.unparse(a)}")
    kinds = dict(known.kinds)
    for a, b in pairwise(site.node.keywords):
        alike = bool(a.arg and b.arg and kinds.get(a.arg)) and kinds.get(a.arg) == kinds.get(b.arg)
        if alike and is_variable(a.value) and is_variable(b.value) and not same(a.value, b.value):
            text = f"{a.arg}={ast.unparse(b.value)}, {b.arg}={ast.unparse(a.value)}"
            yield Change("swapped arguments", a, b, text)


def use_other_variable(site: Site) -> Iterator[Change]:
    """Use another parameter, or another field of the object, of the same type."""
    match site.node:
        case ast.Name(id=name, ctx=ast.Load()) if site.function:
            others = kinds_of(site.function.args)
        case ast.Attribute(value=ast.Name(id="self"), attr=name, ctx=ast.Load()) if site.owner:
            others = fields(site.owner)
        case _:
            return
    names = [other for other, kind in others.items() if kind and kind == others.get(name)]
    if len(names) > 1:
        other = names[(names.index(name) + 1) % len(names)]
        text = f"self.{other}" if isinstance(site.node, ast.Attribute) else other
        yield Change("other variable", site.node, site.node, text)


def drop_update(site: Site) -> Iterator[Change]:
    """Drop the update of a counter or of a table, or a part of the key of a cache."""
    match site.node:
        case ast.AugAssign(target=target):
            yield from updates(site.node, target)
        case ast.Assign(targets=[ast.Subscript() as target]):
            yield from updates(site.node, target)
        case ast.Expr(value=ast.Call(func=ast.Attribute(value=target, attr=name))) if name in UPDATES:
            yield from updates(site.node, target)
        case ast.Assign(targets=[ast.Name(id=name)], value=ast.Tuple(elts=parts)) if KEY.search(name):
            yield from (Change("update", part, part) for part in parts if len(parts) > 2)
        case ast.Return(value=ast.Tuple(elts=parts)) if site.function and KEY.search(site.function.name):
            yield from (Change("update", part, part) for part in parts if len(parts) > 2)


def updates(statement: ast.AST, target: ast.AST) -> Iterator[Change]:
    """Drop a statement that changes a target, unless it is a cache."""
    if not CACHE.search(ast.unparse(target).lower()):
        yield Change("update", statement, statement, "pass")


def return_input(site: Site) -> Iterator[Change]:
    """Return the unmodified input in place of a result of its type."""
    if not isinstance(site.node, ast.Return) or not site.node.value or not site.function:
        return
    if not (result := kind_of(site.function.returns)):
        return
    inputs = kinds_of(site.function.args)
    if site.owner and result in (site.owner.name, "Self") and "self" in inputs:
        inputs["self"] = result
    names = [name for name, kind in inputs.items() if kind == result]
    if names and not (isinstance(site.node.value, ast.Name) and site.node.value.id in names):
        yield Change("input returned", site.node, site.node, f"return {names[0]}")


def replace_order(site: Site) -> Iterator[Change]:
    """Replace the key of a sort, or use the first in place of the highest or lowest."""
    node = site.node
    if not isinstance(node, ast.Call):
        return
    key = next((word for word in node.keywords if word.arg == "key"), None)
    values = ast.unparse(node.args[0]) if len(node.args) == 1 else ""
    if key and isinstance(key.value, ast.Lambda) and isinstance(key.value.body, ast.Tuple):
        parts = key.value.body.elts
        yield from (Change("sort key", part, part) for part in parts if len(parts) > 2)
    match node.func:
        case ast.Name(id="sorted") if values and not isinstance(node.args[0], ast.Starred):
            if key:
                yield Change("sort key", node, node, f"list({values})")
            elif not node.keywords:
                yield Change("sort key", node, node, f"sorted({values}, reverse=True)")
        case ast.Name(id="min" | "max") if key and values and not isinstance(node.args[0], ast.Starred):
            yield Change("sort key", node, node, f"next(iter({values}))")
        case ast.Attribute(attr="argsort") if len(node.args) == 1 and ast.unparse(node.func) == "np.argsort":
            yield Change("sort key", node, node, f"np.arange(len({values}))")
        case ast.Attribute(value=ast.Name(id="np"), attr="argmin" | "argmax") if values and not node.keywords:
            yield Change("sort key", node, node, "0")
        case ast.Attribute(value=of, attr="argmin" | "argmax") if not node.args and not node.keywords:
            yield Change("sort key", node, node, "0")
        case ast.Attribute(value=of, attr="nlargest" | "nsmallest") if node.args:
            yield Change("sort key", node, node, f"{ast.unparse(of)}.head({ast.unparse(node.args[0])})")
        case ast.Attribute(value=of, attr="sort_values"):
            yield Change("sort key", node, node, ast.unparse(of))


def skip_keyword(site: Site) -> Iterator[Change]:
    """Skip a keyword whose value is passed on, if the function has a default for it."""
    if not isinstance(site.node, ast.Call):
        return
    known = signature(site)
    optional = known.optional if known else frozenset()
    for word in site.node.keywords:
        if word.arg is None or (word.arg in optional and word.arg != "strict" and is_variable(word.value)):
            yield Change("keyword", word, word)


KINDS: tuple[Callable[[Site], Iterator[Change]], ...] = (
    drop_key, swap_arguments, use_other_variable, drop_update, return_input, replace_order, skip_keyword,
)  # fmt: skip


def is_variable(node: ast.AST) -> bool:
    """Whether a value is a name, or an attribute of one."""
    return isinstance(node, ast.Name) or (isinstance(node, ast.Attribute) and is_variable(node.value))


def same(a: ast.AST, b: ast.AST) -> bool:
    return ast.unparse(a) == ast.unparse(b)


def called(node: ast.Call) -> str:
    """Last name of the called function."""
    return ast.unparse(node.func).split(".")[-1] if is_variable(node.func) else ""


def signature(site: Site) -> Signature | None:
    name = called(site.node)
    return None if name in COMMUTING else site.signatures.get(name)


def kind_of(annotation: ast.AST | None) -> str:
    return ast.unparse(annotation).strip("'") if annotation else ""


def kinds_of(arguments: ast.arguments) -> dict[str, str]:
    """Types of parameters."""
    every = [*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs]
    return {argument.arg: kind_of(argument.annotation) for argument in every}


def fields(owner: ast.ClassDef) -> dict[str, str]:
    """Types of the fields of a dataclass."""
    return {
        line.target.id: kind_of(line.annotation)
        for line in owner.body
        if isinstance(line, ast.AnnAssign) and isinstance(line.target, ast.Name)
    }


@cache
def read_signatures(root: Path) -> dict[str, Signature]:
    """Signatures of the functions and classes of the package whose name means one of them only."""
    signatures: dict[str, set[Signature]] = {}
    for file in sorted((root / "protochain").rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.FunctionDef):
                signatures.setdefault(node.name, set()).add(of_function(node))
            elif isinstance(node, ast.ClassDef) and (kinds := tuple(fields(node).items())):
                optional = (
                    line.target.id for line in node.body if isinstance(line, ast.AnnAssign) and line.value
                )
                signatures.setdefault(node.name, set()).add(Signature(kinds, kinds, frozenset(optional)))
    return {name: next(iter(known)) for name, known in signatures.items() if len(known) == 1}


def of_function(node: ast.FunctionDef) -> Signature:
    arguments, kinds = node.args, kinds_of(node.args)
    names = [a.arg for a in (*arguments.posonlyargs, *arguments.args)]
    optional = {*names[len(names) - len(arguments.defaults) :]}
    words = zip(arguments.kwonlyargs, arguments.kw_defaults, strict=True)
    optional |= {word.arg for word, default in words if default}
    positional = tuple((name, kinds[name]) for name in names if name not in ("self", "cls"))
    return Signature(positional, tuple(kinds.items()), frozenset(optional))


def walk(
    node: ast.AST, signatures: Mapping[str, Signature], function: ast.FunctionDef | None = None,
    owner: ast.ClassDef | None = None,
) -> Iterator[Site]:  # fmt: skip
    """Sites that run: no types, no decorators, no messages, no constructors of names for tools."""
    for name, value in ast.iter_fields(node):
        if name in ("annotation", "returns", "decorator_list", "type_params", "format_spec", "defaults"):
            continue
        for child in value if isinstance(value, list) else [value]:
            if not isinstance(child, ast.AST) or is_silent(child):
                continue
            inner = child if isinstance(child, ast.FunctionDef) else function
            around = child if isinstance(child, ast.ClassDef) else owner
            yield Site(child, function, owner, signatures)
            yield from walk(child, signatures, inner, around)


def is_silent(node: ast.AST) -> bool:
    """Whether a node is text for people or for tools."""
    match node:
        case ast.Raise() | ast.Assert() | ast.JoinedStr() | ast.Expr(value=ast.Constant()):
            return True
        case ast.Call():
            # Arrays of a kernel have as many rows as one another.
            return called(node) == "len" or bool(MESSAGES.search(called(node)))
        case ast.Subscript(value=ast.Name(id="Literal")) | ast.Assign(targets=[ast.Name(id="__all__")]):
            return True
        case ast.If(test=ast.Name(id="TYPE_CHECKING")):
            return True
        case ast.FunctionDef(name=name):
            return name in ("__repr__", "__str__", "_repr_html_")
        case _:
            return False


def changes(text: str, signatures: Mapping[str, Signature]) -> Iterator[tuple[int, str, str]]:
    """Faults of a module: the number of a line, the kind of fault, and the new line."""
    lines = text.splitlines()
    for site in walk(ast.parse(text), signatures):
        for kind in KINDS:
            for change in kind(site):
                line = change.put_into(lines)
                if line is not None and line != lines[change.first.lineno - 1]:
                    yield change.first.lineno, change.kind, line
