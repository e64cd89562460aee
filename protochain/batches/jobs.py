"""Jobs of a batch: inputs found, given unique names, and hashed with their settings."""

import csv
import glob
import hashlib
import json
import math
import os
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any, Protocol, Self

from protochain import defaults
from protochain.checks import check_fields, flag, integer, number, optional, several, words
from protochain.errors import ProtochainError
from protochain.minimisers.api import Minimisation
from protochain.minimisers.recipes import recipe_of
from protochain.minimisers.starts import check_starts
from protochain.setup import ALL_MODELS, Setup, models_asked
from protochain.structure.files import format_of, split_name
from protochain.structure.prepare import user_files
from protochain.structure.read import model_numbers

_GLOB = frozenset("*?[")


@dataclass(frozen=True)
class BatchSettings:
    """How each structure of a batch is prepared and minimised.

    Parameters
    ----------
    methods : tuple of str
        Run one after the other from the same start, as in :func:`protochain.minimise`.
    tolerance : float, optional
        As in :func:`protochain.minimise`, or of several starts as in :func:`protochain.explore`.
    max_rmsd : float
        As in :func:`protochain.minimise`.
    max_evaluations, seed : int
        As in :func:`protochain.minimise`.
    setup : Setup
        How the structure is prepared; its ``threads`` are those of the batch.
    restraint : str
        As in :func:`protochain.minimise`: strengths in kJ/mol/nm^2, as ``"1000 100 0"``.
    n_starts : int
        With more than 1, each method is run as by :func:`protochain.explore`, and its best end is kept.
    spread : float, rad
        As in :func:`protochain.explore`.
    hop_temperature : float, K, optional
        As in :func:`protochain.explore`.
    curvature : bool
        As in :func:`protochain.minimise`.

    Raises
    ------
    ProtochainError
        If a setting makes no sense.
    """

    methods: tuple[str, ...] = (defaults.METHOD,)
    tolerance: float | None = None
    max_rmsd: float = float("inf")
    max_evaluations: int = defaults.MAX_EVALUATIONS
    seed: int = defaults.SEED
    setup: Setup = field(default_factory=Setup)
    restraint: str = ""
    n_starts: int = 1
    spread: float = defaults.SPREAD
    hop_temperature: float | None = None
    curvature: bool = True

    def __post_init__(self) -> None:
        check_fields(
            self, methods=several, tolerance=optional(number), max_rmsd=number, max_evaluations=integer,
            seed=integer, n_starts=integer, spread=number, hop_temperature=optional(number), curvature=flag,
        )  # fmt: skip
        object.__setattr__(self, "methods", tuple(dict.fromkeys(self.methods)))
        if not self.methods:
            raise ProtochainError("methods: give at least one")
        recipes = [recipe_of(method) for method in self.methods]
        if len({recipe.name for recipe in recipes}) < len(recipes):
            raise ProtochainError(
                f"methods {', '.join(self.methods)}: two have one name; their files would too"
            )
        for recipe in recipes:
            Minimisation(
                recipe, recipe.tolerance(self.tolerance), self.max_evaluations, self.seed,
                restraint=self.restraint, max_rmsd=self.max_rmsd,
            )  # fmt: skip
        if self.hop_temperature is not None and self.n_starts == 1:
            raise ProtochainError("hop_temperature: needs several minima; give n_starts 2 or more")
        held = {} if self.n_starts == 1 else {"restraint": self.restraint, "max_rmsd": self.max_rmsd}
        check_starts(self.n_starts, self.spread, self.hop_temperature, **held)

    def changed(self, **settings: Any) -> "BatchSettings":
        """Return these settings with some replaced, given by the names of their fields or of the setup's."""
        refuse_unknown(settings, NAMES)
        setup = {name: settings.pop(name) for name in _OF_SETUP if name in settings}
        return replace(self, **{"setup": replace(settings.pop("setup", self.setup), **setup)}, **settings)

    def read(self, row: Mapping[str, str]) -> "BatchSettings":
        """Return these settings with the filled cells of a manifest's row in their place."""
        named = {name: _OF_OPTION.get(name.replace("-", "_"), name.replace("-", "_")) for name in row}
        refuse_unknown((name for name, known in named.items() if known not in _IN_MANIFEST), _COLUMNS)
        cells = {named[name]: text.strip() for name, text in row.items() if text.strip()}
        if ":" in cells.get("methods", ""):
            raise ProtochainError("methods: an import path runs code; give it as an option of the batch")
        try:
            return self.changed(**{name: _IN_MANIFEST[name](text) for name, text in cells.items()})
        except ValueError as error:
            raise ProtochainError(str(error)) from error

    def record(self) -> dict[str, Any]:
        """Return plain values by name; ``threads`` change no setting, and each row records them."""
        values = asdict(self) | asdict(self.setup)
        return {name: value for name, value in values.items() if name not in ("setup", "threads")}


class JobSettings(Protocol):
    """Settings of a job: those of a batch, or of a folder to relax."""

    @property
    def methods(self) -> tuple[str, ...]:
        """Names of the runs of each structure; each is a row."""

    @property
    def setup(self) -> Setup:
        """How the structure is prepared."""

    def changed(self, **settings: Any) -> Self:
        """Return these settings with some replaced."""

    def record(self) -> dict[str, Any]:
        """Return plain values by name: all that results depend on."""


def refuse_unknown(given: Iterable[str], known: Sequence[str]) -> None:
    """Refuse the first name that is not known, and list those that are."""
    unknown = next((name for name in given if name not in known), None)
    if unknown is not None:
        raise ProtochainError(
            f"no setting is called {unknown!r}; choose from {', '.join(dict.fromkeys(known))}"
        )


def _truth(text: str) -> bool:
    if text.lower() not in ("true", "false", "yes", "no", "1", "0"):
        raise ValueError(f"{text!r} is neither true nor false")
    return text.lower() in ("true", "yes", "1")


_OF_SETUP = tuple(each.name for each in fields(Setup))
NAMES = (*(each.name for each in fields(BatchSettings)), *_OF_SETUP)
"""Settings of a batch's structures, by the names of their fields."""

_OF_OPTION = {
    "restrain": "restraint",
    "starts": "n_starts",
    "hop": "hop_temperature",
    "chain": "chains",
}
"""Fields of options that the command line calls otherwise; a manifest may use either."""

_READERS: Mapping[type, Callable[[str], Any]] = {bool: _truth, int: int, float: float, tuple: words}
_IN_MANIFEST = {
    each.name: _READERS.get(type(each.default), str)
    for each in (*fields(BatchSettings), *fields(Setup))
    # A list of structures may not decide that the code in a force-field file is run.
    if each.name not in ("setup", "threads", "trust_forcefield")
}
_IN_MANIFEST["spread"] = lambda text: math.radians(float(text))
_IN_MANIFEST["hop_temperature"] = _IN_MANIFEST["tolerance"] = float
"""Columns of a manifest beside ``path``, and how the text of a cell is read; angles are in degrees."""
_COLUMNS = tuple({known: name for name, known in _OF_OPTION.items()}.get(each, each) for each in _IN_MANIFEST)


@dataclass(frozen=True)
class Job:
    """Structure to minimise, with its settings.

    Parameters
    ----------
    name : str
        Unique in the batch; its files are named after it.
    path : Path
        Absolute.
    settings : BatchSettings, or others alike
        The setup's model is a number, or None for the first.
    key : str
        SHA-256 of the file's content, the settings, and the version of protochain.
    """

    name: str
    path: Path
    settings: JobSettings
    key: str

    @property
    def identity(self) -> tuple[str, str]:
        """Name and key: rows of an earlier file or other settings have another."""
        return self.name, self.key


@dataclass(frozen=True)
class Row:
    """Result of one method for one structure.

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
    """Return the row of a method without a result; ``status`` and ``message`` give the reason."""
    record = origin(job) | {"method": method, "status": status, "message": " ".join(message.split())}
    return Row(record | {"seconds": seconds}, [])


def origin(job: Job) -> dict[str, Any]:
    """Return the columns that identify the structure of a row."""
    model = job.settings.setup.model
    return {
        "structure": job.name,
        "input": str(job.path),
        "model": "" if model is None else model,
        "key": job.key,
    }


@dataclass(frozen=True)
class _Found:
    path: Path
    settings: JobSettings
    content: str = field(default="", compare=False)

    @property
    def stem(self) -> str:
        model = self.settings.setup.model
        return split_name(self.path)[0] + ("" if model is None else f".{model}")


def find_jobs(
    inputs: Iterable[str | Path],
    settings: JobSettings,
    manifest: Path | None = None,
    output: Path | None = None,
) -> list[Job]:
    """List the jobs of a batch.

    Parameters
    ----------
    inputs : iterable of str or path-like
        Files, folders (all structures below them), patterns, or ``-`` for a list on standard input.
    settings : BatchSettings
        Of all jobs; with the model ``all``, each model of a file is a job.
    manifest : Path, optional
        CSV with a column ``path`` and any of the settings; paths are relative to its folder.
    output : Path, optional
        Folder for the results: it is not searched, and no input may lie in it.

    Returns
    -------
    list of Job
        In the order given, without duplicates. A file that is missing or cannot be read is a job that fails.

    Raises
    ------
    ProtochainError
        If there is nothing to do, no file exists, the manifest makes no sense, or an input might be replaced.
    """
    found = [_Found(path, settings) for given in inputs for path in _paths(str(given), output)]
    if manifest and isinstance(settings, BatchSettings):
        found += _from_manifest(manifest, settings)
    found = [each for one in dict.fromkeys(found) for each in _models(one)]
    for each in found:
        if _is_inside(each.path, output):
            raise ProtochainError(
                f"{each.path}: lies in the folder for the results; give them a folder of their own"
            )
    if not found:
        raise ProtochainError("no structures found; give files, folders or patterns")
    if not any(each.path.exists() for each in found):
        raise ProtochainError(f"{found[0].path}: not found, nor any other structure; check the names")
    hashed = [replace(each, content=_hash(each.path)) for each in found]
    return _named_apart(hashed)


def listed(by_nul: bool = False) -> list[str]:
    """Names on standard input: one a line, or with NULs between them, as of ``find -print0``."""
    data = sys.stdin.buffer.read() if hasattr(sys.stdin, "buffer") else sys.stdin.read().encode()
    # Names of files need not be text.
    text = os.fsdecode(data)
    if by_nul or "\0" in text:
        return [name for name in text.split("\0") if name]
    return [line.strip() for line in text.splitlines() if line.strip()]


def _paths(given: str, output: Path | None) -> Iterator[Path]:
    if given == "-":
        for name in listed():
            yield from _paths(name, output)
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
    return bool(format_of(path)) and path.is_file()


def _from_manifest(manifest: Path, settings: BatchSettings) -> list[_Found]:
    if not manifest.is_file():
        raise ProtochainError(f"{manifest}: not found; give a CSV file with a column 'path'")
    with manifest.open(newline="", encoding="utf-8-sig") as file:
        reader = csv.DictReader(file, restkey="", restval="")
        if "path" not in (reader.fieldnames or ()):
            raise ProtochainError(f"{manifest}: has no column 'path'")
        found = []
        for row in reader:
            try:
                if "" in row:
                    raise ProtochainError("more cells than columns")
                own = settings.read({k: v for k, v in row.items() if k != "path"})
            except ProtochainError as error:
                raise ProtochainError(f"{manifest}: line {reader.line_num}: {error}") from error
            found.append(_Found(manifest.parent / row["path"].strip(), own))
        return found


def _models(found: _Found) -> list[_Found]:
    asked = found.settings.setup.model
    if not isinstance(asked, str):
        return [found]
    models: Sequence[int | None]
    if asked == ALL_MODELS:
        try:
            numbers = model_numbers(found.path)
        except (ProtochainError, OSError):
            numbers = []  # The job fails, with the reason, when it is run.
        models = numbers if len(numbers) > 1 else [None]
    else:
        models = models_asked(asked)  # A job whose model is not there fails, and says so.
    return [replace(found, settings=found.settings.changed(model=model)) for model in models]


def _hash(path: Path) -> str:
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError:
        return ""


def _key(found: _Found) -> str:
    own = "".join(map(_hash, user_files(found.settings.setup.forcefield)))
    parts = [version("protochain"), found.content, found.settings.record(), own]
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


def _named_apart(found: list[_Found]) -> list[Job]:
    """Name jobs after their files; where names coincide, add the first digits of the key."""
    stems = Counter(each.stem for each in found)
    taken: Counter[str] = Counter()
    jobs = []
    for each in found:
        key = _key(each)
        name = each.stem if stems[each.stem] == 1 else f"{each.stem}-{key[:8]}"
        taken[name] += 1
        # Files of equal name and content have equal keys.
        name = name if taken[name] == 1 else f"{name}-{taken[name]}"
        # A worker may have been started in another folder.
        jobs.append(Job(name, each.path.absolute(), each.settings, key))
    return jobs
