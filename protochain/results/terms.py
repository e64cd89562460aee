"""Energies of a start and its ends, term by term, as a table."""

from collections.abc import Mapping
from typing import Any

import pandas as pd

from protochain.results.columns import heading


def energies_by_term(records: Mapping[str, Mapping[str, Any]]) -> pd.DataFrame:
    """Energy of each term at the start and at each end, from records by the names of ends."""
    rows = []
    for key in dict.fromkeys(key for record in records.values() for key in record):
        name = key.removeprefix("energy_").removesuffix("_start_kj_mol")
        if key != f"energy_{name}_start_kj_mol":
            continue
        # A run that failed has no numbers.
        start = next((record[key] for record in records.values() if record.get(key) is not None), None)
        ends = {f"{end}_kj_mol": record.get(f"energy_{name}_end_kj_mol") for end, record in records.items()}
        if start or any(ends.values()):
            rows.append({"term": heading(name), "start_kj_mol": start, **ends})
    columns = ["term", "start_kj_mol", *(f"{end}_kj_mol" for end in records)]
    return pd.DataFrame(rows, columns=columns)
