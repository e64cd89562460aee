"""What a batch has to do: inputs found, named apart, and hashed with their settings."""

import csv
import glob
import hashlib
import json
import sys
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

from protochain.errors import ProtochainError
from protochain.minimisers.api import check_settings
from protochain.minimisers.stages import Hold
from protochain.structure.files import SUFFIXES
from protochain.structure.prepare import PH, user_file
from protochain.structure.read import model_numbers

_GLOB = frozenset("*?[")


@dataclass(frozen=True)
class Settings:
    """How a structure is minimised; a manifest's columns are these names.

    Parameters
    ----------
    methods : tuple of str
        As of :func:`protochain.minimise`, one after the other from the same start.
    forcefield, solvent, engine
        As of :func:`protochain.energy`.
    hinges, move
        As of :func:`protochain.build_chain`.
    tolerance, max_evaluations, max_rmsd, seed
        As of :func:`protochain.minimise`.
    model : str
        A model's number, ``all``, or empty for the first.
    altloc, keep, ph, strict
        As of :func:`protochain.load`; ``keep`` with commas between.

    Raises
    ------
    ProtochainError
        If a setting makes no sense.
    """

    methods: tuple[str, ...] = ("hybrid",)
    forcefield: str = "amber14"
    solvent: str = "obc2"
    engine: str = "auto"
    hinges: str = "phi psi chi"
    move: str = "all"
    tolerance: float = 1.0
    max_evaluations: int = 5000
    max_rmsd: float = float("inf")
    seed: int = 0
    model: str = ""
    altloc: str = ""
    keep: str = ""
    ph: float = PH
    strict: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "methods", tuple(dict.fromkeys(self.methods)))
        if not self.methods:
            raise ProtochainError("methods: give at least one")
        for method in self.methods:
            check_settings(method, self.tolerance, self.max_evaluations, Hold(max_rmsd=self.max_rmsd))
        if self.model not in ("", "all") and not self.model.lstrip("-").isdigit():
            raise ProtochainError(f"model {self.model!r}: give its number, or all")

    def overridden(self, row: Mapping[str, str]) -> "Settings":
        """Return these with what a row of a manifest says, empty cells aside."""
        kinds = {each.name: type(getattr(self, each.name)) for each in fields(self)}
        unknown = [name for name in row if name not in kinds]
        if unknown:
            raise ProtochainError(f"no setting is called {unknown[0]!r}; choose from {', '.join(kinds)}")
        try:
            changed = {name: _read(kinds[name], text.strip()) for name, text in row.items() if text.strip()}
        except ValueError as error:
            raise ProtochainError(str(error)) from error
        return replace(self, **changed)


def _read(kind: type, text: str) -> Any:
    if kind is bool:
        if text.lower() not in ("true", "false", "yes", "no", "1", "0"):
            raise ValueError(f"{text!r} is neither true nor false")
        return text.lower() in ("true", "yes", "1")
    if kind is tuple:
        return tuple(word.strip() for word in text.split(",") if word.strip())
    return kind(text)


@dataclass(frozen=True)
class Job:
    """One structure to minimise.

    Parameters
    ----------
    name : str
        Unlike all others of the batch: what its files are called.
    path : Path
        Absolute.
    settings : Settings
        ``model`` is a number or empty.
    key : str
        SHA-256 of the file's content, the settings, and the version of protochain.
    """

    name: str
    path: Path
    settings: Settings
    key: str

    @property
    def identity(self) -> tuple[str, str]:
        """What makes its rows its own: a changed file or setting makes others."""
        return self.name, self.key


@dataclass(frozen=True)
class Row:
    """What one method made of one structure.

    Parameters
    ----------
    record : dict
        A line of ``summary.csv``.
    trace : list of dict
        Lines of ``traces.csv``, thinned.
    """

    record: dict[str, Any]
    trace: list[dict[str, float]]


def failure(job: Job, method: str, status: str, message: str, seconds: float = 0.0) -> Row:
    """Return the row of a method that made nothing: why stands in ``status`` and ``message``."""
    record = origin(job) | {"method": method, "status": status, "message": " ".join(message.split())}
    return Row(record | {"seconds": seconds}, [])


def origin(job: Job) -> dict[str, Any]:
    """Columns that say which structure a row is of."""
    return {"structure": job.name, "input": str(job.path), "model": job.settings.model, "key": job.key}


@dataclass(frozen=True)
class _Found:
    path: Path
    settings: Settings
    content: str = field(default="", compare=False)

    @property
    def stem(self) -> str:
        inner = Path(self.path.stem) if self.path.suffix.lower() == ".gz" else self.path
        return inner.stem + (f".{self.settings.model}" if self.settings.model else "")


def find_jobs(
    inputs: Iterable[str | Path],
    settings: Settings,
    manifest: Path | None = None,
    output: Path | None = None,
) -> list[Job]:
    """List the jobs of a batch.

    Parameters
    ----------
    inputs : iterable of str or path-like
        Files, folders (all structures below them), patterns, or ``-`` for a list on standard input.
    settings : Settings
        Of all; ``model="all"`` makes a job of each model.
    manifest : Path, optional
        CSV with a column ``path`` and any of the settings; paths are relative to its folder.
    output : Path, optional
        Where results will go: folders are not searched there, and nothing in it may be an input.

    Returns
    -------
    list of Job
        In the order given, each once. A file that is missing or cannot be read is a job too, which fails.

    Raises
    ------
    ProtochainError
        If there is nothing to do, the manifest makes no sense, or a result might replace an input.
    """
    found = [_Found(path, settings) for given in inputs for path in _paths(str(given), output)]
    if manifest:
        found += _from_manifest(manifest, settings)
    found = [each for one in dict.fromkeys(found) for each in _models(one)]
    for each in found:
        if _is_inside(each.path, output):
            raise ProtochainError(
                f"{each.path}: lies in the folder for the results; give them a folder of their own"
            )
    if not found:
        raise ProtochainError("no structures found; give files, folders or patterns")
    hashed = [replace(each, content=_hash(each.path)) for each in found]
    return _named_apart(hashed)


def _paths(given: str, output: Path | None) -> Iterator[Path]:
    if given == "-":
        for line in sys.stdin:
            if line.strip():
                yield from _paths(line.strip(), output)
    elif Path(given).is_dir():
        found = sorted(path for path in Path(given).rglob("*") if _is_structure(path))
        yield from (path for path in found if not _is_inside(path, output))
    elif not Path(given).exists() and _GLOB & set(given):
        matched = sorted(glob.glob(given, recursive=True))  # noqa: PTH207 (a pattern may be absolute)
        if not matched:
            raise ProtochainError(f"{given}: matches no file")
        yield from (Path(path) for path in matched if not Path(path).is_dir())
    else:
        yield Path(given)


def _is_inside(path: Path, folder: Path | None) -> bool:
    return folder is not None and folder.resolve() in path.resolve().parents


def _is_structure(path: Path) -> bool:
    inner = path.with_suffix("") if path.suffix.lower() == ".gz" else path
    return inner.suffix.lower() in SUFFIXES and path.is_file()


def _from_manifest(manifest: Path, settings: Settings) -> list[_Found]:
    with manifest.open(newline="", encoding="utf-8-sig") as file:
        reader = csv.DictReader(file, restkey="", restval="")
        if "path" not in (reader.fieldnames or ()):
            raise ProtochainError(f"{manifest}: has no column 'path'")
        found = []
        for row in reader:
            try:
                if "" in row:
                    raise ProtochainError("more cells than columns")
                own = settings.overridden({k: v for k, v in row.items() if k != "path"})
            except ProtochainError as error:
                raise ProtochainError(f"{manifest}: line {reader.line_num}: {error}") from error
            found.append(_Found(manifest.parent / row["path"].strip(), own))
        return found


def _models(found: _Found) -> list[_Found]:
    if found.settings.model != "all":
        return [found]
    try:
        numbers: Sequence[int] = model_numbers(found.path)
    except (ProtochainError, OSError):
        numbers = ()  # It fails when its turn comes.
    models = [str(number) for number in numbers] if len(numbers) > 1 else [""]
    return [replace(found, settings=replace(found.settings, model=model)) for model in models]


def _hash(path: Path) -> str:
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError:
        return ""


def _key(found: _Found) -> str:
    own = user_file(found.settings.forcefield)
    said = [version("protochain"), found.content, asdict(found.settings), _hash(own) if own else ""]
    return hashlib.sha256(json.dumps(said, sort_keys=True).encode()).hexdigest()


def _named_apart(found: list[_Found]) -> list[Job]:
    """Name jobs after their files; those that share a name get their key's beginning too."""
    stems = Counter(each.stem for each in found)
    taken: Counter[str] = Counter()
    jobs = []
    for each in found:
        key = _key(each)
        name = each.stem if stems[each.stem] == 1 else f"{each.stem}-{key[:8]}"
        taken[name] += 1
        # The same content twice.
        name = name if taken[name] == 1 else f"{name}-{taken[name]}"
        # A worker may have been started in another folder.
        jobs.append(Job(name, each.path.absolute(), each.settings, key))
    return jobs
