"""``protochain bench``."""

from inspect import signature
from pathlib import Path
from typing import Annotated, Any

import typer

from protochain.checks import words
from protochain.cli.options import CONVERGED, fail

_OF_STABILITY, _OF_KCM, _OF_PRECISION = "Of stability: ", "Of kcm: ", "Of precision: "


def bench(
    name: Annotated[
        str, typer.Argument(metavar="[NAME]", help="A study, or all; an unknown name lists them.")
    ] = "all",
    inputs: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="[IN...]", help="Structures for precision, scenes and kcm [default: peptides]."
        ),
    ] = None,
    output: Annotated[Path, typer.Option("-o", "--output", metavar="DIR", help="Folder.")] = Path("bench"),
    quick: Annotated[bool, typer.Option("--quick", help="A few minutes of it, small cases.")] = False,
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
    """Measure error against run time, stability in extreme cases, what is left out, KCM against dynamics.

    Cases of stability are right, refused or wrong, and so are scenes; one that is wrong fails the command.
    """
    from protochain.analysis.studies import STUDIES, study
    from protochain.errors import ProtochainError
    from protochain.markup import counted
    from protochain.storage import check_writable

    chosen = {each: study(each) for each in (STUDIES if name == "all" else (name,))}
    check_writable(output / "any.csv")
    inside = next((each for each in inputs or () if output.resolve() in each.resolve().parents), None)
    if inside is not None:
        raise ProtochainError(
            f"{inside}: lies in the folder for the results; give them a folder of their own"
        )
    given: dict[str, Any] = {
        "quick": quick or None, "rows": words(rows) if rows else None,
        "only": words(only) if only else None, "threads": threads, "minutes": minutes, "jobs": jobs,
        "starts": starts, "evaluations": evaluations,
    }  # fmt: skip
    given = {option: value for option, value in given.items() if value is not None}
    wrong = 0
    for each, module in chosen.items():
        taken = {option: given[option] for option in given if option in signature(module.run).parameters}
        if len(taken) < len(given) and name != "all":
            other = next(option for option in given if option not in taken)
            raise ProtochainError(f"{other}: study {each!r} has no such option")
        # Each has a report of the same name.
        for table in module.run(output / each if name == "all" else output, inputs or (), **taken):
            if len(table):
                print(table.to_string(index=False), end="\n\n", flush=True)
            wrong += int((table["verdict"] == "wrong").sum()) if "verdict" in table else 0
    print(f"written: tables and plots in {output}")
    if wrong:
        raise typer.Exit(
            fail(f"{counted(wrong, 'cell is', 'cells are')} wrong; the tables in {output} say how")
        )
    raise typer.Exit(CONVERGED)
