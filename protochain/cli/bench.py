"""``protochain bench``."""

from inspect import signature
from pathlib import Path
from typing import Annotated, Any

import typer

from protochain.checks import words
from protochain.cli.options import CONVERGED, fail

_OF_STABILITY, _OF_KCM = "Of stability: ", "Of kcm: "


def bench(
    name: Annotated[
        str, typer.Argument(metavar="[NAME]", help="A study, or all; an unknown name lists them.")
    ] = "all",
    inputs: Annotated[
        list[Path] | None,
        typer.Argument(metavar="[IN...]", help="Structures for precision and kcm [default: peptides]."),
    ] = None,
    output: Annotated[Path, typer.Option("-o", "--output", metavar="DIR", help="Folder.")] = Path("bench"),
    quick: Annotated[
        bool, typer.Option("--quick", help="Of stability and kcm: a few minutes of it, two peptides.")
    ] = False,
    rows: Annotated[
        str | None, typer.Option(help=f"{_OF_STABILITY}rows of its grid, with commas between.")
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
    """Measure error against run time, stability in extreme cases, and whether KCM and dynamics agree.

    Stability is a grid of cases, each right, refused or wrong; one that is wrong fails the command.
    """
    from protochain.analysis.studies import STUDIES, study
    from protochain.errors import ProtochainError
    from protochain.storage import check_writable

    chosen = {each: study(each) for each in (STUDIES if name == "all" else (name,))}
    check_writable(output / "any.csv")
    given: dict[str, Any] = {
        "quick": quick or None, "rows": words(rows) if rows else None, "threads": threads, "minutes": minutes,
        "jobs": jobs, "starts": starts, "evaluations": evaluations,
    }  # fmt: skip
    given = {option: value for option, value in given.items() if value is not None}
    wrong = 0
    for each, module in chosen.items():
        taken = {option: given[option] for option in given if option in signature(module.run).parameters}
        if len(taken) < len(given) and name != "all":
            other = next(option for option in given if option not in taken)
            raise ProtochainError(f"{other}: study {each!r} has no such option")
        for table in module.run(output, inputs or (), **taken):
            if len(table):
                print(table.to_string(index=False), end="\n\n", flush=True)
            wrong += int((table["verdict"] == "wrong").sum()) if "verdict" in table else 0
    print(f"written: tables and plots in {output}")
    if wrong:
        raise typer.Exit(fail(f"{wrong} cells are wrong; {output / 'cells.csv'} says how"))
    raise typer.Exit(CONVERGED)
