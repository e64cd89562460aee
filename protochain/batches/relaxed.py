"""A structure of a folder, relaxed: settings, columns, and the work of one job."""

from collections.abc import Iterator
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

from protochain.batches.jobs import Job, Row, origin
from protochain.batches.thinning import thinned
from protochain.minimisers.record import Column, flat
from protochain.relaxation.names import relaxed_stem, suffix_of
from protochain.relaxation.record import COLUMNS as OF_RECORD
from protochain.relaxation.record import METHOD
from protochain.relaxation.settings import Relaxing
from protochain.setup import Setup

if TYPE_CHECKING:
    from protochain.structure import Structure

COLUMNS = (
    *(key for key in OF_RECORD if key != "rounds"), "seconds_preparation", "input", "model", "output", "key",
)  # fmt: skip
"""Columns of ``relaxed.csv``."""


def _column(key: str, heading: str) -> Column:
    return Column(key, lambda record: record[key], heading)


SHOWN_RELAXED = (
    _column("status", "status"),
    _column("violations_start", "residues with violations at start"),
    _column("violations_end", "at end"),
    _column("overlaps_start", "overlaps at start"),
    _column("overlaps_end", "at end"),
    _column("energy_start_kj_mol", "energy at start"),
    _column("energy_end_reference_kj_mol", "energy at end"),
    _column("ca_rmsd_angstrom", "C-alpha RMSD"),
    _column("n_rounds", "rounds"),
    _column("seconds", "seconds"),
)
"""Columns of the table on a structure's page."""


@dataclass(frozen=True)
class RelaxSettings:
    """How each structure of a folder is prepared and relaxed.

    Parameters
    ----------
    relaxing : Relaxing
    setup : Setup
    """

    relaxing: Relaxing = field(default_factory=Relaxing)
    setup: Setup = field(default_factory=Setup)

    @property
    def methods(self) -> tuple[str, ...]:
        """The one row of each structure."""
        return (METHOD,)

    def changed(self, **settings: Any) -> "RelaxSettings":
        """Return these settings with some of the setup's replaced."""
        return replace(self, setup=replace(self.setup, **settings))

    def record(self) -> dict[str, Any]:
        """Return plain values by name; ``threads`` change no setting, and each row records them."""
        values = asdict(self.relaxing) | asdict(self.setup)
        return {name: value for name, value in values.items() if name not in _NOT_HERE}


_NOT_HERE = ("threads", "hinges", "root")


def relaxed(job: Job, folder: Path, threads: int) -> Iterator[tuple[Row, "Structure"]]:
    """Relax the structure of a job, and write it; yield its row."""
    import pandas as pd

    from protochain.energies.shared import shared_energy
    from protochain.relaxation.api import relax_structure
    from protochain.relaxation.result import TRACE_COLUMNS
    from protochain.structure.write import common_suffix

    s = job.settings
    assert isinstance(s, RelaxSettings)
    began = perf_counter()
    setup = replace(s.setup, threads=threads)
    structure = setup.load(job.path)
    energy = setup.energy(structure, shared_energy)
    preparation = perf_counter() - began
    result = relax_structure(structure, energy, s.relaxing, move=s.setup.move)
    record = {key: flat(value) for key, value in result.record().items()} | origin(job)
    record["seconds_preparation"] = preparation
    if result.is_usable:
        suffix = suffix_of(job.path)
        suffix = common_suffix([structure]) if suffix == ".pdb" else suffix
        output = folder / f"{relaxed_stem(job.name)}{suffix}"
        result.save(output)
        record["output"] = output.name
    trace = pd.DataFrame(result.trace, columns=list(TRACE_COLUMNS)).astype(
        {"iteration": int, "evaluations": int}
    )
    yield Row(record, thinned(trace)), structure
