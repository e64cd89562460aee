"""``protochain scan``."""

import re
from pathlib import Path
from typing import Annotated

import typer

from protochain.chains.setup import Setup
from protochain.cli import options
from protochain.cli.terminal import count_progress
from protochain.core.errors import ProtochainError


@options.with_settings()
def scan(
    source: options.Input,
    grids: Annotated[
        list[str],
        typer.Argument(metavar="'phi A:3=-180:180:10'...", help="Hinges with first, last and step, degrees."),
    ],
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="CSV to write [default: NAME.scan.csv].")
    ] = None,
    report: options.Report = None,
    relax: Annotated[bool, typer.Option(help="Minimise all other hinges at each point.")] = False,
    as_json: options.AsJson = False,
    *,
    setup: Setup,
) -> None:
    """Compute the energy against dihedrals. Write a table, and a page with a curve or a Ramachandran map."""
    from protochain.comparison.dihedral_scan import ENERGY, energy_map
    from protochain.comparison.dihedral_scan import scan as run
    from protochain.core.storage import write_atomically
    from protochain.results.page import write_scan

    read = [_read(axis) for axis in grids]
    axes = dict(read)
    if len(axes) < len(read):
        raise ProtochainError(f"{' '.join(map(repr, grids))}: give each hinge once")
    table = output or Path(f"{options.named_after(source)[0]}.scan.csv")
    options.check_page(report)
    files = [table, *([report] if report else [])]
    options.check_outputs([source], files, setup)
    chain, energy, _ = options.prepare(source, setup)
    with count_progress("scan") as watch:
        points = run(chain, energy, axes, relax=relax, watch=watch)
    write_atomically(table, lambda to: points.to_csv(to, index=False))
    lowest: dict[str, float] = points.nsmallest(1, ENERGY)[[*axes, ENERGY]].to_dict("records")[0]  # type: ignore[assignment]  # of texts
    if report:
        method = "minimised in all other hinges" if relax else "with all other hinges as they are"
        text = f"Energy of {chain.structure.name} against its dihedrals, {method}."
        numbers = {"points": f"{len(points)}", "lowest energy, kJ/mol": f"{lowest[ENERGY]:.2f}"}
        numbers |= {f"at {name}, degrees": f"{lowest[name]:g}" for name in axes}
        write_scan(report, f"Scan of {chain.structure.name}", text, numbers, energy_map(points), points)
    if as_json:
        record = {"input": str(source), "n_points": len(points), "lowest": lowest}
        options.print_json(record | {"files": [*map(str, files)]})
    else:
        at = ", ".join(f"{name} {lowest[name]:g}" for name in axes)
        print(f"{len(points)} points; the lowest, {lowest[ENERGY]:.2f} kJ/mol, at {at} degrees")
        options.print_files(*files)


def _read(axis_text: str) -> tuple[str, list[float]]:
    """Name and values of ``phi A:3=-180:180:10``, the last included, or ``phi A:3=-60,60``."""
    name, sign, values = axis_text.rpartition("=")
    parts = re.split(r"[:,]", values)
    try:
        numbers = [float(part) for part in parts]
    except ValueError:
        numbers = []
    if ":" in values and len(numbers) == 3:
        first, last, step = numbers
        n = (last - first) / step if step > 0.0 else -1.0
        numbers = [first + k * step for k in range(int(n + 1e-9) + 1)] if 0.0 <= n < _MOST else []
    elif ":" in values:
        numbers = []
    if not sign or not numbers:
        how = "give a hinge and its values, as 'phi A:3=-180:180:10' or 'phi A:3=-60,60'"
        raise ProtochainError(f"{axis_text!r}: {how}")
    return name.strip(), numbers


_MOST = 1e6  # Most values of a hinge. Larger numbers are errors.
