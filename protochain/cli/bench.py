"""``protochain bench``."""

import inspect
from pathlib import Path
from typing import Annotated

import typer

from protochain.cli.options import CONVERGED, fail


def bench(
    name: Annotated[
        str, typer.Argument(metavar="[NAME]", help="A study, or all; an unknown name lists them.")
    ] = "all",
    inputs: Annotated[
        list[Path] | None,
        typer.Argument(metavar="[IN...]", help="Structures for precision [default: peptides]."),
    ] = None,
    output: Annotated[Path, typer.Option("-o", "--output", metavar="DIR", help="Folder.")] = Path("bench"),
    quick: Annotated[bool, typer.Option("--quick", help="Of stability: two minutes of it.")] = False,
    rows: Annotated[str, typer.Option(help="Of stability: rows of its grid, with commas between.")] = "",
    threads: Annotated[int, typer.Option(help="Of stability: threads of each process.")] = 1,
) -> None:
    """Measure error against run time, and numerical stability in stiff and extreme cases.

    Stability is a grid of cases, each right, refused or wrong; one that is wrong fails the command.
    """
    from protochain.analysis.studies import STUDIES, study
    from protochain.storage import check_writable

    chosen = [study(each) for each in (STUDIES if name == "all" else (name,))]
    check_writable(output / "any.csv")
    given = {"quick": quick, "rows": rows.split(",") if rows else None, "threads": threads}
    wrong = 0
    for each in chosen:
        own = {key: given[key] for key in inspect.signature(each.run).parameters if given.get(key)}
        for table in each.run(output, inputs or (), **own):
            if len(table):
                print(table.to_string(index=False), end="\n\n", flush=True)
            wrong += int((table["verdict"] == "wrong").sum()) if "verdict" in table else 0
    print(f"written: tables and plots in {output}")
    if wrong:
        raise typer.Exit(fail(f"{wrong} cells are wrong; {output / 'cells.csv'} says how"))
    raise typer.Exit(CONVERGED)
