"""What tables and pages show of structures that are relaxed."""

from protochain.relaxation.record import COLUMNS as OF_RECORD
from protochain.relaxation.record import INTERFACE_COLUMNS
from protochain.results.columns import Column

COLUMNS = (
    *(column.key for column in OF_RECORD if column.key not in ("rounds", "ligands")),
    "seconds_preparation", "input", "model", "output", "confidences", "key",
)  # fmt: skip
"""Columns of ``relaxed.csv``."""
OF_INTERFACE = tuple(column.key for column in INTERFACE_COLUMNS)
"""And those of an interface that is scored."""


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
