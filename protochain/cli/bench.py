"""``protochain bench``."""

from pathlib import Path
from typing import Annotated

import typer

from protochain.cli.options import CONVERGED


def bench(
    name: Annotated[
        str, typer.Argument(metavar="[NAME]", help="A study, or all; an unknown name lists them.")
    ] = "all",
    inputs: Annotated[
        list[Path] | None,
        typer.Argument(metavar="[IN...]", help="Structures for precision [default: peptides]."),
    ] = None,
    output: Annotated[Path, typer.Option("-o", "--output", metavar="DIR", help="Folder.")] = Path("bench"),
) -> None:
    """Measure error against run time, and numerical stability in stiff and extreme cases."""
    from protochain.analysis.studies import STUDIES, study
    from protochain.storage import check_writable

    chosen = [study(each) for each in (STUDIES if name == "all" else (name,))]
    check_writable(output / "any.csv")
    for each in chosen:
        for table in each.run(output, inputs or ()):
            print(table.to_string(index=False), end="\n\n", flush=True)
    print(f"written: tables and plots in {output}")
    raise typer.Exit(CONVERGED)
