"""``protochain scene``."""

import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from protochain.cli.options import CONVERGED, AsJson, fail
from protochain.cli.printable import printer

if TYPE_CHECKING:
    from rich.console import Console

    from protochain.scenes import Scene

_FEW = 20
"""Extremes that are listed one by one."""


def scene(
    name: Annotated[str | None, typer.Argument(metavar="[NAME]", help="A scene; none lists them.")] = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="DIR", help="Folder [default: scene-NAME].")
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Some seconds of it, small cases.")] = False,
    as_json: AsJson = False,
) -> None:
    """Run a mechanical scene: checks, error against run time, stiff and extreme cases, what is left out.

    Scenes are mechanisms of all kinds, not proteins, on the same mechanics. What is wrong fails the command.
    """
    from protochain.scenes import SCENES, check_name, run
    from protochain.storage import check_writable, json_text

    if name is None:
        width = max(map(len, SCENES))
        print(json_text({"scenes": SCENES}) if as_json else "\n".join(_listed(width)))
        raise typer.Exit(CONVERGED)
    check_name(name)
    folder = output or Path(f"scene-{name}")
    check_writable(folder / "checks.csv")
    if not quick:
        print(f"scene {name}: may take two minutes; --quick takes some seconds", file=sys.stderr)
    found = run(name, quick)

    from protochain.scenes.folder import summary, write

    made = write(found, folder)
    if as_json:
        print(json_text({**summary(found, made), "output": str(folder)}, indent=None))
    else:
        _print(found)
        print(f"made by {made['versions']}, commit {made['commit']}, on {made['machine']}, 1 thread")
        print(f"written: tables and work.png in {folder}")
    if found.wrong:
        raise typer.Exit(
            fail(f"scene {name}: wrong: {'; '.join(found.wrong)}; the tables in {folder} say how")
        )
    raise typer.Exit(CONVERGED)


def _listed(width: int) -> list[str]:
    from protochain.scenes import SCENES

    return [f"{name:<{width}}  {line}" for name, line in SCENES.items()]


def _print(scene: "Scene") -> None:
    """Print what a scene has found: a table each of checks, work, extremes and what is left out."""
    console = printer()
    console.print(f"{scene.name}: {scene.title}", markup=False, highlight=False)
    checks = [
        (c.name, f"{c.value:.6g}", f"{c.oracle:.6g}", f"{c.error:.2g}", f"{c.bound:.2g}", _said(c.right))
        for c in scene.checks
    ]
    _print_table(console, ("check", "value", "oracle", "error", "bound", ""), checks)
    work = [
        (w["method"], w["setting"], f"{w['seconds']:.3g}", f"{w['error']:.2g}")
        for w in scene.work.to_dict("records")
    ]
    _print_table(console, ("method", "setting", "seconds", scene.error_of), work)
    few = len(scene.extremes) <= _FEW
    counts = Counter(each.outcome for each in scene.extremes)
    told = ", ".join(f"{n} {outcome}" for outcome, n in counts.items())
    console.print(f"\n{len(scene.extremes)} extremes{told and f': {told}'}", highlight=False)
    extremes = [(e.name, e.outcome, e.detail) for e in scene.extremes if few or not e.right]
    _print_table(console, ("extreme", "", "detail"), extremes)
    left_out = [
        (x.what, f"{x.ratio:.3g}", f"{x.difference:.2g}", f"{x.bound:.2g}", _said(x.right))
        for x in scene.left_out
    ]
    _print_table(console, ("left out", "times as long with it", "difference", "bound", ""), left_out)
    console.print()


def _print_table(console: "Console", headings: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    from rich.markup import escape
    from rich.table import Table

    if not rows:
        return
    table = Table(box=None, pad_edge=False, padding=(0, 1, 0, 0))
    for k, heading in enumerate(headings):
        number = k and heading not in ("", "setting", "detail")
        table.add_column(heading, justify="right" if number else "left", overflow="fold")
    for row in rows:
        table.add_row(*map(escape, row))
    console.print()
    console.print(table)


def _said(right: bool) -> str:
    return "right" if right else "wrong"
