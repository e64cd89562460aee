"""Confidence files that predictors write beside a model: copies of them beside a result, and their ipTM.

They are found by the names that each program gives, never by looking into files or folders.
"""

import json
import re
import shutil
from collections.abc import Sequence, Set
from filecmp import cmp
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple
from zipfile import BadZipFile

import numpy as np

from protochain.core.storage import write_atomically
from protochain.structure.files import split_name

_LARGEST = 1_000_000_000
"""Bytes. AlphaFold 3 writes some 100 MB of aligned errors for 3000 residues."""
_PATTERNS = (
    # AlphaFold 3, RoseTTAFold 3; OpenFold 3.
    (
        r"(.+)_model",
        (r"\1_summary_confidences.json", r"\1_confidences.json", r"\1_confidences_aggregated.json"),
    ),
    # AlphaFold Server.
    (r"(.+)_model_(\d+)", (r"\1_summary_confidences_\2.json", r"\1_full_data_\2.json")),
    # Boltz.
    (r"(.+_model_\d+)", (r"confidence_\1.json", r"pae_\1.npz", r"pde_\1.npz", r"plddt_\1.npz")),
    (r"(.+)_model_\d+", (r"affinity_\1.json",)),
    # Chai.
    (r"pred\.(model_idx_\d+)", (r"scores.\1.npz",)),
    # Protenix.
    (r"(.+)_(sample_\d+)", (r"\1_summary_confidence_\2.json", r"\1_full_data_\2.json")),
    # ColabFold.
    (r"(.+)_(?:un)?relaxed_(rank_.+)", (r"\1_scores_\2.json",)),
    # AlphaFold's database.
    (r"(AF-.+)-model_(v\d+)", (r"\1-confidence_\2.json", r"\1-predicted_aligned_error_\2.json")),
)
"""Stem of a model, and names of what lies beside it."""


class Copied(NamedTuple):
    """What was copied, and what was not, with the reason."""

    written: tuple[Path, ...] = ()
    left: tuple[str, ...] = ()


def confidence_files(model: Path) -> tuple[Path, ...]:
    """Return the confidence files that lie beside a model, by the names that predictors give them."""
    stem = split_name(model)[0]
    names = dict.fromkeys(
        found.expand(name)
        for pattern, beside in _PATTERNS
        if (found := re.fullmatch(pattern, stem))
        for name in beside
    )
    return tuple(path for name in names if (path := model.with_name(name)).is_file())


def copy_confidences(model: Path, result: Path) -> Copied:
    """Copy the confidence files of a model into the folder of a result, byte for byte, under their names.

    Nothing is copied into the model's own folder, and nothing is replaced.

    Parameters
    ----------
    model, result : Path
        Files; of standard input and output, ``-``, nothing is known.

    Raises
    ------
    WriteError
        If one cannot be written.
    """
    if "-" in (str(model), str(result)) or model.resolve().parent == result.resolve().parent:
        return Copied()
    written, left = [], []
    for path in confidence_files(model):
        to = result.with_name(path.name)
        if path.stat().st_size > _LARGEST:
            left.append(f"{path}: is larger than {_LARGEST // 10**9} GB and was not copied beside the result")
        elif not to.exists():
            write_atomically(to, partial(shutil.copyfile, path))
            written.append(to)
        elif not cmp(path, to, shallow=False):
            left.append(f"{path}: was not copied beside the result, because another {to.name} is there")
    return Copied(tuple(written), tuple(left))


class Confidence(NamedTuple):
    """What confidence files say of a complex: ipTM, and that of each pair of chains, or nothing."""

    iptm: float | None
    pairs: tuple[tuple[float, ...], ...] = ()

    def between(self, chains: Sequence[str], one: Set[str], other: Set[str]) -> float | None:
        """IpTM of two sides.

        Parameters
        ----------
        chains : sequence of str
            All of the model, in its order.
        one, other : set of str
            Those of either side.

        Returns
        -------
        float or None
            Mean over the pairs of their chains, either taken as the frame; the whole model's if it has two
            chains and the files do not tell of pairs.
        """
        if len(self.pairs) == len(chains):
            place = {name: k for k, name in enumerate(chains)}
            both = [(place[a], place[b]) for a in one for b in other if a != b]
            values = [self.pairs[i][j] for a, b in both for i, j in ((a, b), (b, a))]
            return sum(values) / len(values) if values else None
        return self.iptm if len(chains) == 2 and not self.pairs else None


def confidence_in(files: Sequence[Path]) -> Confidence | None:
    """Read ipTM from the confidence files of a model; None without files. What cannot be read is left out."""
    found = [each for path in files if (each := _read(path))]
    return max(found, key=lambda each: len(each.pairs)) if found else Confidence(None) if files else None


def _read(path: Path) -> Confidence | None:
    try:
        if path.stat().st_size > _LARGEST_READ:
            return None
        if path.suffix == ".npz":
            with np.load(path) as file:
                told = {name: file[name].squeeze().tolist() for name in file if "iptm" in name}
        else:
            told = json.loads(path.read_text(encoding="utf-8"))
        pairs: Any = next((told[name] for name in _OF_PAIRS if name in told), [])
        if isinstance(pairs, dict):
            names = sorted(pairs, key=int)
            pairs = [[pairs[a][b] for b in names] for a in names]
        matrix = tuple(tuple(map(float, row)) for row in pairs)
        if "iptm" not in told or any(len(row) != len(matrix) for row in matrix):
            return None
        return Confidence(None if told["iptm"] is None else float(told["iptm"]), matrix)
    except (OSError, ValueError, TypeError, KeyError, BadZipFile):
        return None


_OF_PAIRS = ("chain_pair_iptm", "pair_chains_iptm", "per_chain_pair_iptm")
"""Names of what AlphaFold 3 and Protenix, Boltz, and Chai say of pairs of chains."""
_LARGEST_READ = 20_000_000
"""Bytes. Larger ones hold the errors of all pairs of residues."""
