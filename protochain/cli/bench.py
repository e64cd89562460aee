"""``protochain bench``, and ``protochain scene``, the same for scenes alone."""

import sys
from collections import Counter
from collections.abc import Sequence
from inspect import signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from protochain.cli.options import CONVERGED, AsJson, fail, print_json
from protochain.cli.printable import printer
from protochain.core.checks import words

if TYPE_CHECKING:
    from rich.console import Console

    from protochain.scenes import Scene

_OF_STABILITY, _OF_KCM, _OF_PRECISION = "Of stability: ", "Of kcm: ", "Of precision: "
_SMALL = "Small cases: some seconds of a scene, a few minutes of a study."
_FEW = 20
"""Extremes that are listed one by one."""


def bench(
    name: Annotated[
        str | None, typer.Argument(metavar="[NAME]", help="A study or scene, or all; none lists them.")
    ] = None,
    inputs: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="[IN...]", help="Structures for precision, omissions and kcm [default: peptides]."
        ),
    ] = None,
    output: Annotated[Path, typer.Option("-o", "--output", metavar="DIR", help="Folder.")] = Path("bench"),
    quick: Annotated[bool, typer.Option("--quick", help=_SMALL)] = False,
    rows: Annotated[
        str | None, typer.Option(help=f"{_OF_STABILITY}rows of its grid, with commas between.")
    ] = None,
    only: Annotated[
        str | None, typer.Option(help=f"{_OF_PRECISION}kinds of curves, with commas between.")
    ] = None,
    threads: Annotated[
        int | None, typer.Option(help=f"{_OF_STABILITY}also computed on so many [default: 2].")
    ] = None,
    minutes: Annotated[
        float | None,
        typer.Option(help=f"{_OF_KCM}start no run after so many; call again to go on [default: 60]."),
    ] = None,
    jobs: Annotated[int | None, typer.Option(help=f"{_OF_KCM}processes [default: 1].")] = None,
    starts: Annotated[
        int | None, typer.Option(help=f"{_OF_KCM}perturbed starts of each kind [default: 20].")
    ] = None,
    evaluations: Annotated[int | None, typer.Option(help=f"{_OF_KCM}most of a run [default: 20000].")] = None,
) -> None:
    """Run a study of proteins or a scene of mechanics: error against run time, extremes, what is left out.

    Cases are right, refused or wrong; one that is wrong fails the command.
    """
    from protochain.core.storage import check_writable
    from protochain.scenes import SCENES

    if name is None:
        from protochain.analysis.studies import STUDIES

        _list({**STUDIES, **SCENES})
        raise typer.Exit(CONVERGED)
    check_writable(output / "any.csv")
    given: dict[str, Any] = {
        "rows": words(rows) if rows else None, "only": words(only) if only else None, "threads": threads,
        "minutes": minutes, "jobs": jobs, "starts": starts, "evaluations": evaluations,
    }  # fmt: skip
    given = {option: value for option, value in given.items() if value is not None}
    wrong: list[str] = []
    if name not in SCENES:
        wrong += _studies(name, inputs or [], output, given | ({"quick": True} if quick else {}))
    elif given or inputs:
        from protochain.core.errors import ProtochainError

        raise ProtochainError(f"{name}: a scene takes no files, and of the options only -o and --quick")
    for each in SCENES if name == "all" else [name] if name in SCENES else []:
        wrong += _scene(each, output / each if name == "all" else output, quick)
    raise typer.Exit(fail("; ".join(wrong)) if wrong else CONVERGED)


def _studies(name: str, inputs: Sequence[Path], output: Path, given: dict[str, Any]) -> list[str]:
    """Run a study, or all; say what is wrong."""
    from protochain.analysis.studies import STUDIES, study
    from protochain.core.errors import ProtochainError
    from protochain.core.markup import counted
    from protochain.scenes import SCENES

    if name not in (*STUDIES, "all"):
        raise ProtochainError(
            f"there is no study or scene {name!r}; choose from {', '.join([*STUDIES, *SCENES])}"
        )
    chosen = {each: study(each) for each in (STUDIES if name == "all" else (name,))}
    inside = next((each for each in inputs if output.resolve() in each.resolve().parents), None)
    if inside is not None:
        raise ProtochainError(
            f"{inside}: lies in the folder for the results; give them a folder of their own"
        )
    wrong = 0
    for each, module in chosen.items():
        taken = {option: given[option] for option in given if option in signature(module.run).parameters}
        if len(taken) < len(given) and name != "all":
            other = next(option for option in given if option not in taken)
            raise ProtochainError(f"{other}: study {each!r} has no such option")
        # Each has a report of the same name.
        for table in module.run(output / each if name == "all" else output, inputs, **taken):
            if len(table):
                print(table.to_string(index=False), end="\n\n", flush=True)
            wrong += int((table["verdict"] == "wrong").sum()) if "verdict" in table else 0
    print(f"written: tables and plots in {output}")
    cells = counted(wrong, "cell is", "cells are")
    return [f"{cells} wrong; the tables in {output} say how"] if wrong else []


def scene(
    name: Annotated[str | None, typer.Argument(metavar="[NAME]", help="A scene; none lists them.")] = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="DIR", help="Folder [default: scene-NAME].")
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Some seconds of it, small cases.")] = False,
    as_json: AsJson = False,
) -> None:
    """Run a mechanical scene, as `bench` does: checks, error against run time, extremes, what is left out.

    Scenes are mechanisms of all kinds, not proteins, on the same mechanics. What is wrong fails the command.
    """
    from protochain.core.storage import check_writable
    from protochain.scenes import SCENES, check_name

    if name is None:
        _list(SCENES, as_json)
        raise typer.Exit(CONVERGED)
    check_name(name)
    folder = output or Path(f"scene-{name}")
    check_writable(folder / "checks.csv")
    wrong = _scene(name, folder, quick, as_json)
    raise typer.Exit(fail(wrong[0]) if wrong else CONVERGED)


def _scene(name: str, folder: Path, quick: bool, as_json: bool = False) -> list[str]:
    """Run a scene, write its folder, print what it has found; say what is wrong."""
    from protochain.lab.cases import write
    from protochain.scenes import run

    if not quick:
        print(f"scene {name}: may take two minutes; --quick takes some seconds", file=sys.stderr)
    found = run(name, quick)
    made = write(found, folder)
    if as_json:
        frames = found.frames()
        told = {key: frames[key].to_dict("records") for key in ("checks", "work", "extremes", "left_out")}
        head = {"scene": found.name, "title": found.title, "wrong": list(found.wrong), **told}
        print_json({**head, "error_of": found.error_of, "made": made, "output": str(folder)})
    else:
        _print(found)
        print(f"made by {made['versions']}, commit {made['commit']}, on {made['machine']}, 1 thread")
        print(f"written: tables and work.png in {folder}")
    told_wrong = f"scene {name}: wrong: {'; '.join(found.wrong)}; the tables in {folder} say how"
    return [told_wrong] if found.wrong else []


def _list(lines: dict[str, str], as_json: bool = False) -> None:
    if as_json:
        print_json({"scenes": lines})
        return
    width = max(map(len, lines))
    print("\n".join(f"{name:<{width}}  {line}" for name, line in lines.items()))


def _print(scene: "Scene") -> None:
    """Print what a scene has found: a table each of checks, work, extremes and what is left out."""
    console = printer()
    console.print(f"{scene.name}: {scene.title}", markup=False, highlight=False)
    checks = [
        (c.name, f"{c.value:.6g}", f"{c.oracle:.6g}", f"{c.error:.2g}", f"{c.bound:.2g}", _said(c.right))
        for c in scene.checks
    ]
    _print_table(console, ("check", "value", "oracle", "error", "bound", ""), checks)
    points = scene.work.to_dict("records")
    work = [(w["method"], w["setting"], f"{w['seconds']:.3g}", f"{w['error']:.2g}") for w in points]
    _print_table(console, ("method", "setting", "seconds", scene.error_of), work)
    counts = Counter(each.outcome for each in scene.extremes)
    told = ", ".join(f"{n} {outcome}" for outcome, n in counts.items())
    console.print(f"\n{len(scene.extremes)} extremes{told and f': {told}'}", highlight=False)
    few = len(scene.extremes) <= _FEW
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
