"""What a scene does not need is left out: representative runs, each with its proof and its saving.

:mod:`.energies` and :mod:`.runs` have the tables of scenes, :mod:`.features` what a feature costs a run that
does not use it; a new one is a line in them.
"""

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path

import pandas as pd
from threadpoolctl import threadpool_limits

from protochain.analysis.studies.scenes import energies, runs
from protochain.analysis.studies.scenes.cells import Material, Row, run_scene
from protochain.analysis.studies.scenes.features import FEATURES, Cost, costs
from protochain.analysis.studies.scenes.page import plot, write_page
from protochain.storage import write_atomically
from protochain.structure import from_sequence, load

SEQUENCE = (
    "KVFGRCELAAAMKRHGLDNYRGYSLGNWVCAAKFESNFNTQATNRNTDGSTDYGILQINSRWWCNDGRTPGSRNLCNIPCSALLSSDITASVNCAKKIVSDGNGMNAWV"
    "AWRNRCKGTDVQAWIRGCRL"
)  # fmt: skip
"""Hen egg-white lysozyme, as an extended chain of some 2000 atoms, for use without files."""
SHORT = "NLYIQWLKDGGPSSGRPPPS"
"""Trp-cage, for --quick."""
_SECONDS, _SECONDS_OF_FEATURES = (3.0, 0.2), (8.0, 0.4)
"""Of each timing, in full and with --quick."""


def run(output: Path, inputs: Sequence[Path] = (), quick: bool = False) -> Iterator[pd.DataFrame]:
    """Run all scenes; write ``scenes.csv``, ``features.csv``, ``scenes.png`` and ``report.html``.

    Parameters
    ----------
    output : Path
        Folder.
    inputs : sequence of Path
        Structures; an extended chain by default, which has neither disulfides nor waters.
    quick : bool
        Some scenes, timed for less long: under a minute.

    Yields
    ------
    pandas.DataFrame
        The scenes of each structure; finally costs of features that are not used. Their column ``verdict`` is
        ``right`` or ``wrong``.
    """
    rows: list[Row] = []
    spent: list[Cost] = []
    features = [each for each in FEATURES if each.in_quick or not quick]
    with threadpool_limits(1, "blas"):
        for material in _materials(inputs, quick):
            own = []
            for scene in (*energies.SCENES, *runs.SCENES):
                row = run_scene(scene, material, _SECONDS[quick]) if scene.in_quick or not quick else None
                own += [] if row is None else [row]
            rows += own
            yield _shown(own)
            spent += costs(material, _SECONDS_OF_FEATURES[quick], features)
    scenes, unused = table_of(rows, Row), table_of(spent, Cost)
    for stem, table in (("scenes", scenes), ("features", unused)):
        write_atomically(output / f"{stem}.csv", partial(table.to_csv, index=False))
    write_atomically(output / "scenes.png", partial(plot(scenes).savefig, dpi=110))
    write_page(scenes, unused, output / "report.html")
    yield unused.round(3)


def _materials(inputs: Sequence[Path], quick: bool) -> Iterator[Material]:
    if not inputs:
        yield Material(from_sequence(SHORT if quick else SEQUENCE))
    yield from (Material(load(path), path) for path in inputs)


def table_of(rows: Sequence[Row] | Sequence[Cost], kind: type[Row] | type[Cost]) -> pd.DataFrame:
    """Rows as a table, with its columns even of none."""
    return pd.DataFrame([asdict(row) for row in rows], columns=list(kind.__annotations__))


def _shown(rows: Sequence[Row]) -> pd.DataFrame:
    columns = ["scene", "against", "everything_ms", "left_out_ms", "ratio", "error", "verdict"]
    return table_of(rows, Row)[columns]
