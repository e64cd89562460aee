"""Confidence files that structure predictors write next to a model, identified by their names."""

import json
import re
import shutil
from collections.abc import Sequence, Set
from filecmp import cmp
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple
from zipfile import BadZipFile

import gemmi
import numpy as np

from protochain.core.arrays import Floats
from protochain.core.storage import write_atomically
from protochain.structure.formats.files import split_name

_LARGEST = 1_000_000_000  # Bytes. AlphaFold 3 writes some 100 MB of aligned errors for 3000 residues.
_LARGEST_READ = 200_000_000  # Bytes, unpacked: some 4000 tokens.
_PATTERNS = (
    # AlphaFold 3, RoseTTAFold 3; OpenFold 3.
    (
        r"(.+_)?model",
        (r"\1summary_confidences.json", r"\1confidences.json", r"\1confidences_aggregated.json"),
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
    # AlphaFold 2, ColabFold.
    (r"(?:un)?relaxed_(model_.+)", (r"confidence_\1.json", r"pae_\1.json")),
    (r"(.+)_(?:un)?relaxed_(rank_.+)", (r"\1_scores_\2.json",)),
    # AlphaFold's database.
    (r"(AF-.+)-model_(v\d+)", (r"\1-confidence_\2.json", r"\1-predicted_aligned_error_\2.json")),
)
"""Pattern of the stem of a model file, and names of its confidence files in the same folder."""
_IPTM_KEYS = ("chain_pair_iptm", "pair_chains_iptm", "per_chain_pair_iptm", "pairwise_iptm")
"""Keys of the ipTM of chain pairs of AlphaFold 3, OpenFold 3 and Protenix, Boltz, Chai, and ColabFold."""
_PAE_KEYS = ("pae", "token_pair_pae", "predicted_aligned_error")
"""Keys of the predicted aligned errors: most programs, Protenix, AlphaFold 2."""


class CopyResult(NamedTuple):
    """Files that were copied, and messages about files that were not."""

    written: tuple[Path, ...] = ()
    left: tuple[str, ...] = ()


def confidence_files(model: Path) -> tuple[Path, ...]:
    """Return the confidence files in the folder of a model, by the names that predictors use."""
    stem = split_name(model)[0]
    names = dict.fromkeys(
        match.expand(name)
        for pattern, templates in _PATTERNS
        if (match := re.fullmatch(pattern, stem))
        for name in templates
    )
    return tuple(path for name in names if (path := model.with_name(name)).is_file())


def copy_confidences(model: Path, result: Path) -> CopyResult:
    """Copy the confidence files of a model into the folder of a result, without replacing files."""
    if "-" in (str(model), str(result)) or model.resolve().parent == result.resolve().parent:
        return CopyResult()
    written, left = [], []
    for path in confidence_files(model):
        target = result.with_name(path.name)
        if path.stat().st_size > _LARGEST:
            left.append(f"{path}: is larger than {_LARGEST // 10**9} GB and was not copied beside the result")
        elif not target.exists():
            write_atomically(target, partial(shutil.copyfile, path))
            written.append(target)
        elif not cmp(path, target, shallow=False):
            left.append(f"{path}: was not copied beside the result, because another {target.name} is there")
    return CopyResult(tuple(written), tuple(left))


class Confidence(NamedTuple):
    """Predicted confidence of a complex, from its confidence files."""

    iptm: float | None  # Of the whole model.
    pairs: Any = ()  # IpTM of chain pairs: rows by chain index, or a dict by chain ids.
    # (nt, nt): Predicted aligned error of the token of the column, aligned on the token of the row.
    pae: Floats | None = None
    order: tuple[str, ...] = ()  # Chains in the order of the tokens. If empty, the order of the model file.

    def mean_iptm(self, chains: Sequence[str], first: Set[str], second: Set[str]) -> float | None:
        """Return the mean ipTM of the chain pairs between two groups of chains."""
        if not self.pairs:
            return self.iptm if len(chains) == 2 else None
        chains = self.order or chains
        if isinstance(self.pairs, dict):
            iptms = {tuple(re.findall(r"[^(),\s-]+", key)): value for key, value in self.pairs.items()}
        else:
            iptms = {
                (a, b): value
                for a, row in zip(chains, self.pairs, strict=False)
                for b, value in zip(chains, row, strict=False)
            } if len(self.pairs) == len(chains) else {}  # fmt: skip
        pairs = [pair for a in first for b in second if a != b for pair in ((a, b), (b, a))]
        values = [float(iptms[pair]) for pair in pairs if iptms.get(pair) is not None]
        return sum(values) / len(values) if values else None

    def tokens(self, atoms: Sequence[str]) -> dict[tuple[str, str], int]:
        """Return the token index of each residue, by chain and number: its only token, or its CA or C1'."""
        if self.pae is None:
            return {}
        residues: dict[str, dict[tuple[str, str], list[str]]] = {name: {} for name in self.order}
        for atom in atoms:
            chain, number, residue, name = atom.split("/")[:4]
            names_of_residue = residues.setdefault(chain, {}).setdefault((number, residue), [])
            if name == residue or not name.lstrip("0123456789").startswith("H"):
                names_of_residue.append(name)
        token_of, n = {}, 0
        for chain, chain_residues in residues.items():
            for (number, residue), names in chain_residues.items():
                single = gemmi.find_tabulated_residue(residue).is_standard()
                place = next((names.index(name) for name in ("CA", "C1'") if name in names), 0)
                token_of[chain, number] = n + (0 if single else place)
                n += 1 if single else len(names)
        return token_of if n == len(self.pae) else {}


def read_scores(files: Sequence[Path]) -> Confidence | None:
    """Read the confidence files of a model. Unreadable files are skipped. Return None without files."""
    if not files:
        return None
    data: dict[str, Any] = {}
    for path in files:
        data = _read(path) | data
    try:
        iptm, pairs = data.get("iptm"), next((data[name] for name in _IPTM_KEYS if name in data), ())
        if isinstance(pairs, dict) and all(isinstance(row, dict) for row in pairs.values()):
            # Boltz writes chain indices, not ids.
            pairs = [[pairs[a][b] for b in sorted(pairs, key=int)] for a in sorted(pairs, key=int)]
        rows = [pairs.values()] if isinstance(pairs, dict) else pairs
        if any(value is not None and not isinstance(value, int | float) for row in rows for value in row):
            return Confidence(None)
        if not isinstance(pairs, dict) and any(len(row) != len(pairs) for row in pairs):
            return Confidence(None)
        errors = next((data[name] for name in _PAE_KEYS if name in data), None)
        pae = None if errors is None else np.array(errors, dtype=float)
        if pae is not None and pae.shape != (len(pae), len(pae)):
            return Confidence(None)
        order = tuple(dict.fromkeys(map(str, data.get("token_chain_ids", ()))))
        return Confidence(None if iptm is None else float(iptm), pairs, pae, order)
    except (ValueError, TypeError, KeyError, OverflowError):
        return Confidence(None)


def _read(path: Path) -> dict[str, Any]:
    try:
        if path.stat().st_size > _LARGEST_READ:
            return {}
        if path.suffix == ".npz":
            with np.load(path) as file:
                if sum(member.file_size for member in file.zip.infolist()) > _LARGEST_READ:
                    return {}
                return {key: file[key].squeeze().tolist() for key in {*file} & {"iptm", *_IPTM_KEYS, "pae"}}
        data = json.loads(path.read_text(encoding="utf-8"))
        data = data[0] if isinstance(data, list) and data else data
        return data if isinstance(data, dict) else {}
    except (OSError, ValueError, TypeError, BadZipFile, RecursionError, MemoryError):
        return {}
