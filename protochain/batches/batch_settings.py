"""Settings of a batch, stored in its folder. A batch is resumed with the same settings only."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from itertools import islice
from pathlib import Path
from typing import Any

from protochain.batches.jobs import BatchSettings, Job
from protochain.chains.setup import Setup
from protochain.core.errors import ProtochainError
from protochain.core.storage import json_text, write_text
from protochain.structure.preparation.prepare import user_files

NAME = "settings.json"


def store_settings(
    folder: Path, common: BatchSettings, jobs: Sequence[Job], table: str = "summary.csv"
) -> None:
    """Write the settings of a batch to its folder, or raise if the folder has other settings."""
    path = folder / NAME
    settings, records = _plain(common), _structure_settings(common, jobs)
    if path.exists():
        before, recorded = _read(path)
        _refuse_others(folder, "", before, settings)
        for structure in recorded.keys() & records.keys():
            for record in recorded[structure]:
                if record not in records[structure]:
                    now = before | records[structure][0]
                    _refuse_others(folder, f" for {structure}", before | record, now)
        records = recorded | records
    elif _holds_results(folder / table):
        raise ProtochainError(
            f"{folder}: contains results without {NAME}: their settings are unknown; give another folder"
        )
    write_text(path, json.dumps({"settings": settings, "structures": records}, indent=1, allow_nan=False))


def _holds_results(table: Path) -> bool:
    """Whether a table of a batch has a row below its headings."""
    try:
        with table.open("rb") as file:
            lines = [*islice(file, 2)]
            return len(lines) > 1 and b"key" in lines[0].strip().split(b",")
    except FileNotFoundError:
        return False


def _plain(settings: BatchSettings) -> dict[str, Any]:
    """Settings as JSON reads them back, with the version and the hash of force-field files."""
    plain: dict[str, Any] = json.loads(json_text(settings.record() | run_settings(settings.setup)))
    return plain


def run_settings(setup: Setup | None) -> dict[str, str]:
    """Version, and hash of force-field files if there are any, on which all results depend."""
    values, files = {"protochain": version("protochain")}, user_files(setup.forcefield if setup else None)
    if files:
        content = b"".join(file.read_bytes() for file in files)
        values["content of the force field"] = hashlib.sha256(content).hexdigest()[:12]
    return values


def _structure_settings(common: BatchSettings, jobs: Sequence[Job]) -> dict[str, list[dict[str, Any]]]:
    """Settings of each structure that differ from the common ones. A manifest may name a structure twice."""
    usual = _plain(common)
    records: dict[str, list[dict[str, Any]]] = {}
    for job in jobs:
        model = job.settings.setup.model
        name = str(job.path) if model is None else f"{job.path}, model {model}"
        values = {} if job.settings is common else _plain(job.settings)
        changes = {key: value for key, value in values.items() if key != "model" and value != usual.get(key)}
        records.setdefault(name, []).append(changes)
    return records


def _read(path: Path) -> tuple[dict[str, Any], dict[str, list[dict[str, Any]]]]:
    try:
        text = json.loads(path.read_text(encoding="utf-8"))
        settings, structures = dict(text["settings"]), dict(text["structures"])
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise ProtochainError(
            f"{path}: contains no settings of a batch ({error}); give another folder"
        ) from None
    return settings, structures


def _refuse_others(folder: Path, whose: str, before: Mapping[str, Any], now: Mapping[str, Any]) -> None:
    for name in ("methods", *before, *now):
        old, new = before.get(name), now.get(name)
        if old != new or (name in before) != (name in now):
            raise ProtochainError(
                f"{folder}: contains results{whose} {_difference(name, old, new)}; repeat the settings, or "
                "give another folder"
            )


def _difference(name: str, old: Any, new: Any) -> str:
    if old in (None, ""):
        return f"without {name}, which is {_text_of(new)} now"
    return f"with {name} {_text_of(old)}, " + (
        "which is not given now" if new in (None, "") else f"not {_text_of(new)}"
    )


def _text_of(value: Any) -> str:
    """Setting as text. An empty list is `none`, so that it differs from a setting that is absent."""
    if isinstance(value, list):
        return ",".join(map(_text_of, value)) or "none"
    return str(value)
