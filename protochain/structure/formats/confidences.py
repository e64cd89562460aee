"""Confidence files that predictors write beside a model: copies of them beside a result, and what they say.

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

import gemmi
import numpy as np

from protochain.core.arrays import Floats
from protochain.core.storage import write_atomically
from protochain.structure.formats.files import split_name

_LARGEST = 1_000_000_000
"""Bytes. AlphaFold 3 writes some 100 MB of aligned errors for 3000 residues."""
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
    """Copy the confidence files of a model into another folder, that of a result, replacing none."""
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
    """What confidence files say of a complex."""

    iptm: float | None  # Of the whole model.
    pairs: Any = ()  # IpTM of pairs of chains: rows by the place of the chains, or by their names.
    # (nt, nt): Predicted error of every token, its column, aligned on another, its row.
    pae: Floats | None = None
    order: tuple[str, ...] = ()  # Chains in the order of the tokens; that of the model file if empty.

    def between(self, chains: Sequence[str], one: Set[str], other: Set[str]) -> float | None:
        """IpTM of two sides."""
        if not self.pairs:
            return self.iptm if len(chains) == 2 else None
        chains = self.order or chains
        if isinstance(self.pairs, dict):
            noted = {tuple(re.findall(r"[^(),\s-]+", key)): value for key, value in self.pairs.items()}
        else:
            noted = {
                (a, b): value
                for a, row in zip(chains, self.pairs, strict=False)
                for b, value in zip(chains, row, strict=False)
            } if len(self.pairs) == len(chains) else {}  # fmt: skip
        both = [pair for a in one for b in other if a != b for pair in ((a, b), (b, a))]
        values = [float(noted[pair]) for pair in both if noted.get(pair) is not None]
        return sum(values) / len(values) if values else None

    def tokens(self, atoms: Sequence[str]) -> dict[tuple[str, str], int]:
        """Token of each residue, by chain and number: its only one, or that of its CA or C1'."""
        if self.pae is None:
            return {}
        residues: dict[str, dict[tuple[str, str], list[str]]] = {name: {} for name in self.order}
        for atom in atoms:
            chain, number, residue, name = atom.split("/")[:4]
            its = residues.setdefault(chain, {}).setdefault((number, residue), [])
            if name == residue or not name.lstrip("0123456789").startswith("H"):
                its.append(name)
        found, n = {}, 0
        for chain, each in residues.items():
            for (number, residue), names in each.items():
                single = gemmi.find_tabulated_residue(residue).is_standard()
                place = next((names.index(name) for name in ("CA", "C1'") if name in names), 0)
                found[chain, number] = n + (0 if single else place)
                n += 1 if single else len(names)
        return found if n == len(self.pae) else {}


def confidence_in(files: Sequence[Path]) -> Confidence | None:
    """Read the confidence files of a model; None without files. What cannot be read is left out."""
    if not files:
        return None
    noted: dict[str, Any] = {}
    for path in files:
        noted = _read(path) | noted
    try:
        iptm, pairs = noted.get("iptm"), next((noted[name] for name in _OF_PAIRS if name in noted), ())
        if isinstance(pairs, dict) and all(isinstance(row, dict) for row in pairs.values()):
            # Boltz tells places, not names.
            pairs = [[pairs[a][b] for b in sorted(pairs, key=int)] for a in sorted(pairs, key=int)]
        rows = [pairs.values()] if isinstance(pairs, dict) else pairs
        if any(value is not None and not isinstance(value, int | float) for row in rows for value in row):
            return Confidence(None)
        if not isinstance(pairs, dict) and any(len(row) != len(pairs) for row in pairs):
            return Confidence(None)
        errors = next((noted[name] for name in _OF_ERRORS if name in noted), None)
        pae = None if errors is None else np.array(errors, dtype=float)
        if pae is not None and pae.shape != (len(pae), len(pae)):
            return Confidence(None)
        order = tuple(dict.fromkeys(map(str, noted.get("token_chain_ids", ()))))
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
                return {name: file[name].squeeze().tolist() for name in {*file} & {"iptm", *_OF_PAIRS, "pae"}}
        noted = json.loads(path.read_text(encoding="utf-8"))
        noted = noted[0] if isinstance(noted, list) and noted else noted
        return noted if isinstance(noted, dict) else {}
    except (OSError, ValueError, TypeError, BadZipFile, RecursionError, MemoryError):
        return {}


_OF_PAIRS = ("chain_pair_iptm", "pair_chains_iptm", "per_chain_pair_iptm", "pairwise_iptm")
"""Names of what AlphaFold 3, OpenFold 3 and Protenix, Boltz, Chai, and ColabFold say of pairs of chains."""
_OF_ERRORS = ("pae", "token_pair_pae", "predicted_aligned_error")
"""Names of the errors of pairs of tokens: of most, of Protenix, and of AlphaFold 2."""
_LARGEST_READ = 200_000_000
"""Bytes, unpacked: some 4000 tokens."""
