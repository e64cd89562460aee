"""``protochain search``."""

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from protochain.chains.setup import OF_ENERGY, Setup
from protochain.cli import options
from protochain.cli.terminal import print_search, search_progress
from protochain.core.processors import processors
from protochain.core.settings import settings_of
from protochain.core.storage import claim_folder
from protochain.searching.search_settings import SearchRunSettings, SearchSettings

Source = Annotated[
    Path, typer.Argument(metavar="IN", help="PDB or mmCIF file, or a sequence of one-letter codes.")
]
Output = Annotated[
    Path | None, typer.Option("-o", "--output", metavar="DIR", help="Folder [default: NAME-search].")
]
Workers = Annotated[int | None, typer.Option(help="Processes, with one thread each [default: all cores].")]


@options.with_settings(setup="threads root")
def search(
    context: typer.Context,
    source: Source,
    output: Output = None,
    workers: Workers = None,
    scheduler: options.Scheduler = None,
    as_json: options.AsJson = False,
    *,
    searching: SearchSettings,
    running: SearchRunSettings,
    setup: Setup,
) -> None:
    """Search for low minima of one chain, or sample its torsions."""
    from protochain.searching import search as run
    from protochain.searching.search_chain import check_folder
    from protochain.structure import from_sequence

    title = str(source) if is_sequence(source) else options.named_after(source)[0]
    output = output or Path(f"{title}-search")
    if searching.method == "csa":
        options.refuse(context, "temperatures", "does not apply to csa")
    if searching.method != "tempering":
        options.refuse(context, "n_replicas pilot", "applies to tempering only")
    check_folder(output, running.resume, running.force)
    context.with_resource(claim_folder(output, "search", running.resume))
    setup = replace(setup, threads=1)
    if is_sequence(source):
        for name, setting in settings_of(Setup):
            if name not in (*OF_ENERGY, "hinges", "move"):
                names = f"{name} {setting.word[0] if setting.word else ''}"
                options.refuse(context, names, "applies to files, but the input is a sequence")
        structure = from_sequence(str(source))
        chain, energy = setup.chain(structure), setup.energy(structure)
    else:
        files = [output / "summary.json", output / "report.html"]
        options.check_outputs([source], files, setup, replaces=not running.resume)
        chain, energy, _ = options.prepare(source, setup)
    count = min(processors(), searching.n_walkers) if workers is None else workers
    with search_progress(title) as watch:
        result = run(
            chain, energy, output=output, workers=count, scheduler=scheduler, watch=watch,
            **vars(running), **vars(searching),
        )  # fmt: skip
    status = options.INTERRUPTED if result.interrupted else options.CONVERGED
    options.end_folder(output, partial(print_search, result, output), as_json, result.interrupted, status)


def is_sequence(source: Path) -> bool:
    """Whether the input is not a file, but could be one-letter codes."""
    from protochain.structure.molecule.residues import STANDARD

    if not {*str(source)} <= {*STANDARD.values()}:
        return False
    # A longer name cannot be a file, and the system would raise an error.
    return len(str(source)) > 255 or not source.exists()
