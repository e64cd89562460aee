"""The folder of a comparison: check before a run, and files of an earlier comparison."""

import json
from collections.abc import Iterable
from pathlib import Path

from protochain.core.errors import Argument, ProtochainError
from protochain.core.storage import check_writable
from protochain.results.run_folder import remove_files

TABLES = (
    "summary", "equal_cost", "work", "spread", "displacement", "traces", "differences",
    "residue_differences", "bonds_changed", "quality",
)  # fmt: skip
FIGURES = ("energy", "work_precision", "torque", "rmsd", "displacement", "differences", "ramachandran")
_PAGE, _SUMMARY = "report.html", "summary.json"
_SUFFIXES = (".pdb", ".cif")
_OF_OTHERS = ("pages", "summary.parquet", "checkpoint.npz", "log.csv", "log.part.csv")
"""Files in the folders of batches and simulations."""


def check_folder(folder: Path, force: bool) -> None:
    """Check the folder of a comparison before any work is done."""
    check_writable(folder / _PAGE)
    foreign_files = [name for name in _OF_OTHERS if (folder / name).exists()]
    if foreign_files:
        raise ProtochainError(
            f"{folder}: contains a batch or simulation ({foreign_files[0]}); give another folder"
        )
    existing = [name for name in (_PAGE, *names()) if (folder / name).exists()]
    if existing and not force:
        raise ProtochainError(
            f"{folder}: contains a comparison ({existing[0]}); give another folder, or ",
            Argument("force", True),
            " to replace it",
        )


def files_of(folder: Path, name: str, methods: Iterable[str]) -> list[Path]:
    """Files that a comparison of a structure of this name may write or delete in its folder."""
    ends = [f"{name}.{method}{suffix}" for method in ("start", *methods) for suffix in _SUFFIXES]
    return [folder / file_name for file_name in dict.fromkeys([_PAGE, *_structures(folder), *ends, *names()])]


def clear(folder: Path) -> None:
    """Delete the files of an earlier comparison, and no others, so that all files belong together."""
    remove_files(folder / name for name in (_PAGE, *_structures(folder), *names()))


def names() -> list[str]:
    """Names of all files of each comparison, except its structures and its page."""
    # The summary last: it names the structures.
    return [*(f"{stem}.csv" for stem in TABLES), *(f"{stem}.png" for stem in FIGURES), _SUMMARY]


def _structures(folder: Path) -> list[str]:
    """Names of the structure files in the summary of a comparison, all in this folder."""
    try:
        summary = json.loads((folder / _SUMMARY).read_text(encoding="utf-8"))
        ends = [Path(row["output"]) for row in summary["results"] if row["output"]]
        starts = [Path(f"{summary['structure']}.start{suffix}") for suffix in _SUFFIXES]
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return []
    return [path.name for path in (*ends, *starts) if path.suffix in _SUFFIXES]
