"""Unique names of structures in a batch, with their folders. Names of earlier results are reused."""

import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path, PurePosixPath

from protochain.core.storage import as_utf8
from protochain.minimisers.recipes import recipe_of
from protochain.relaxation.names import relaxed_stem
from protochain.relaxation.record import METHOD as RELAX
from protochain.structure.formats.files import split_name


@dataclass(frozen=True)
class NameRequest:
    """Structure without a name."""

    path: Path  # Absolute.
    root: Path  # Input folder, or folder of the file. The name has the path relative to it.
    model: int | str | None
    key: str  # Hash of content and settings.
    methods: tuple[str, ...]  # Each writes a file.
    pose: str = ""  # Name of the pose of an added ligand or of the design, if there are several.

    @property
    def source(self) -> tuple[str, str]:
        """Path and model, as in tables."""
        return as_utf8(str(self.path)), "" if self.model is None else str(self.model)

    @cached_property
    def place(self) -> Path:
        """Path without ``..``."""
        return absolute(self.path)

    def name(self, home: Path, level: int, position: int) -> str:
        """Name relative to a folder. Each level adds a more specific ending."""
        stem, suffix, packing = split_name(self.place)
        ending = f"{suffix}{packing}" if level == _WITH_ENDING else ""
        model = "" if self.model is None else f".{self.model}"
        model += f".{self.pose}" if self.pose else ""
        tag = ("", "", f"-{self.key[:8]}", f"-{self.key}-{position}")[level]
        return as_utf8((self.place.parent.relative_to(home) / f"{stem}{ending}{model}{tag}").as_posix())


_WITH_ENDING, _LAST = 1, 3
"""Levels of names: stem of the file, with its suffix, with the key, and with the index in the list."""


@dataclass(frozen=True)
class Earlier:
    """Row of an earlier batch in the same folder, and whether its input was removed."""

    structure: str
    input: str
    model: str
    key: str
    output: str
    is_gone: bool = False

    @property
    def source(self) -> tuple[str, str]:
        """Path and model."""
        return self.input, self.model

    @property
    def claims(self) -> frozenset[str]:
        """Names in use."""
        return frozenset({self.structure, self.output.rpartition(".")[0]})


def absolute(path: Path) -> Path:
    """Absolute path, without ``..``. Links are not followed."""
    return Path(os.path.abspath(path))  # noqa: PTH100 (resolve would follow links, absolute keeps ..)


def poses_name(name: str, method: str = RELAX) -> str:
    """Path of the SDF file of poses of a result, in the folder of a batch."""
    return f"{output_stem(name, method)}.sdf"


def output_stem(name: str, method: str) -> str:
    """Path of the result of a method in the folder of a batch, without its suffix."""
    if method != RELAX:
        return f"{name}.{recipe_of(method).name}"
    path = PurePosixPath(name)
    return str(path.with_name(relaxed_stem(path.name)))


def assign_names(requests: Sequence[NameRequest], earlier: Sequence[Earlier] = ()) -> list[str]:
    """Name structures after their files, relative to their common folder."""
    if not requests:
        return []
    folders = [folder for request in requests for folder in (absolute(request.root), request.place.parent)]
    home = Path(os.path.commonpath(folders))
    earlier_names, used = _reuse(requests, earlier)
    levels = [0] * len(requests)
    while True:
        names = [
            old or request.name(home, level, k)
            for k, (old, request, level) in enumerate(zip(earlier_names, requests, levels, strict=True))
        ]
        claims = [
            {name, *(output_stem(name, method) for method in request.methods)}
            for name, request in zip(names, requests, strict=True)
        ]
        count = used + Counter(claim for group in claims for claim in group)
        clashing = [
            k for k, group in enumerate(claims)
            if not earlier_names[k] and levels[k] < _LAST and any(count[claim] > 1 for claim in group)
        ]  # fmt: skip
        if not clashing:
            return names
        for k in clashing:
            levels[k] += 1


def _reuse(requests: Sequence[NameRequest], earlier: Sequence[Earlier]) -> tuple[list[str], Counter[str]]:
    """Reused names, empty if there is none, and the names in use by results of other files."""
    sources = Counter(request.source for request in requests)
    same = {(row.source, row.key): row.structure for row in earlier}
    changed = {row.source: row.structure for row in earlier if sources[row.source] == 1}
    other_rows = {row.structure: row for row in earlier if row.source not in sources}
    moved = {(row.key, Path(row.input).name): row.structure for row in other_rows.values() if row.is_gone}
    names = []
    for request in requests:
        name = same.get((request.source, request.key)) or changed.get(request.source, "")
        name = name or moved.pop((request.key, request.path.name), "")
        names.append(name)
    left = other_rows.keys() - {*names}
    claims = (row.claims for row in earlier if row.structure in left)
    return names, Counter(dict.fromkeys((claim for group in claims for claim in group), 1))
