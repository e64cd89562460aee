"""Error against run time of everything that approximates or iterates: one curve each.

Each kind is a file with ``measure``, which yields the points of its curve, and a row of ``KINDS``; runner,
tables, pictures and page are common. Minimisers have tables and a picture of their own besides.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path

import pandas as pd
from threadpoolctl import threadpool_limits

from bench.page import Section, write_report
from bench.provenance import made
from bench.studies.precision import (
    closures,
    energies,
    fixman,
    hessians,
    integrators,
    minimisers,
    sampling,
    solvers,
)  # fmt: skip
from bench.studies.precision.curves import Kind, plot, points_of, said
from protochain.core.errors import ProtochainError
from protochain.core.processors import processors
from protochain.results.tables import save

KINDS = {
    "solvers": Kind(
        "Solving with the mass matrix",
        "M x = tau of random serial chains with a free root, in random poses.",
        solvers.measure,
    ),
    "energies": Kind(
        "Energy kernels",
        "Forces of extended peptides in ff14SB: of pairs in decimal digits, by engine, cutoff and list.",
        energies.measure,
    ),
    "minimisers": Kind(
        "Minimisers",
        "Median cost over the structures until the energy is first so near to the lowest end known.",
        lambda quick: (),
    ),
    "integrators": Kind(
        "Integrators",
        "A small peptide at constant energy, from its minimum: the angles at the end, and the total energy.",
        integrators.measure,
    ),
    "sampling": Kind(
        "Sampling",
        "Two hinges at 300 K, against exact values: root mean square errors over several seeds.",
        sampling.measure,
    ),
    "closures": Kind(
        "Constraints and closed loops",
        "A loop of polyglycine kept by three distances: in a step, in a run, and in accelerations.",
        closures.measure,
    ),
    "fixman": Kind(
        "Fixman's potential",
        "The logarithm of det M of random serial chains with a free root, and its gradient.",
        fixman.measure,
    ),
    "hessians": Kind(
        "Products with the torsional Hessian",
        "Differences of torques at a minimum of a small peptide, along a random direction.",
        hessians.measure,
    ),
}
"""The one table of kinds."""


def run(
    output: Path, inputs: Sequence[Path] = (), quick: bool = False, only: Sequence[str] = tuple(KINDS)
) -> Iterator[pd.DataFrame]:
    """Measure; write ``curves.csv``, a CSV and a picture for each kind, and ``report.html``."""
    for name in only:
        if name not in KINDS:
            raise ProtochainError(f"precision: there is no kind {name!r}; choose from {', '.join(KINDS)}")
    if inputs and "minimisers" not in only:
        raise ProtochainError("precision: only minimisers read files; give none, or add minimisers to --only")
    tables: dict[str, pd.DataFrame] = {}
    for name in only:
        kind = KINDS[name]
        if name == "minimisers":
            needed = pd.DataFrame()
            for needed in minimisers.run(output, inputs, quick):
                yield needed
            structures = len(inputs) or (1 if quick else len(minimisers.PEPTIDES))
            tables[name] = points_of(name, minimisers.points(needed, structures))
        else:
            # BLAS on one thread, as in runs.
            with threadpool_limits(1, "blas"):
                tables[name] = points_of(name, kind.measure(quick))
            yield tables[name].drop(columns=["kind", "source", "n"])
            save(output, {f"{name}.png": plot(tables[name], kind.title)})
        every = pd.concat(tables.values(), ignore_index=True)
        save(output, {f"{name}.csv": tables[name], "curves.csv": every})
        parts = [
            Section(
                KINDS[each].title, {"points": points.drop(columns="kind")},
                (KINDS[each].measured, *said(points)),
                "precision.png" if each == "minimisers" else f"{each}.png",
            )
            for each, points in tables.items()
        ]  # fmt: skip
        write_report(output, "Error against run time", parts, made(f"1, of minimisers {processors()}"))
