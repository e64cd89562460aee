"""Jobs of a batch: find inputs, assign unique names, and hash them with their settings."""

import csv
import glob
import hashlib
import itertools
import json
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

from protochain.batches.naming import Earlier, NameRequest, absolute, assign_names
from protochain.chains.setup import ALL_MODELS, Setup, parse_models
from protochain.core import checks, defaults
from protochain.core.checks import designs, file_and_record, instance, several
from protochain.core.errors import Argument, ProtochainError, refusal
from protochain.core.settings import Setting, document_fields, setting, settings_of
from protochain.core.storage import as_utf8, regular
from protochain.minimisers.minimise_settings import MinimiseSettings, StartSettings
from protochain.minimisers.minimise_structure import Minimisation
from protochain.minimisers.recipes import recipe_of
from protochain.minimisers.restraints import Hold
from protochain.minimisers.starts import refuse_restraints
from protochain.relaxation.record import METHOD as RELAX
from protochain.relaxation.relax_settings import NAMES as OF_RELAXING
from protochain.relaxation.relax_settings import WITHOUT, RelaxSettings
from protochain.structure.formats.files import format_of
from protochain.structure.ligand_files import has_poses, poses
from protochain.structure.preparation.prepare import user_files
from protochain.structure.preparation.read import model_numbers

_GLOB = frozenset("*?[")


@document_fields
@dataclass(frozen=True)
class BatchSettings(StartSettings, MinimiseSettings):
    """Settings for the preparation and the methods of each structure of a batch.

    By default, each method uses its own tolerance.

    Raises
    ------
    ProtochainError
        If a setting is invalid.
    """

    # Methods of :func:`protochain.minimise`, and ``relax``. Each runs from the same start.
    methods: tuple[str, ...] = setting((defaults.METHOD,), "", several)
    # Settings for preparing the structure. ``threads`` is set by the batch.
    setup: Setup = field(default_factory=Setup)
    # Settings of ``relax``. A tolerance and restraints of the batch, but no springs, replace those here.
    relaxing: RelaxSettings = field(default_factory=RelaxSettings)

    def __post_init__(self) -> None:
        checks.check_fields(
            self, setup=instance(Setup, "protochain.Setup()"),
            relaxing=instance(RelaxSettings, "protochain.relaxation.RelaxSettings()"),
        )  # fmt: skip
        super().__post_init__()
        tolerance = self.relaxing.tolerance if self.tolerance is None else self.tolerance
        object.__setattr__(self, "tolerance", tolerance)
        object.__setattr__(self, "methods", tuple(dict.fromkeys(self.methods)))
        if not self.methods:
            raise ProtochainError("methods: give at least one")
        recipes = [recipe_of(method) for method in self.methods if method != RELAX]
        names = [recipe.name for recipe in recipes] + [RELAX] * (RELAX in self.methods)
        if len(set(names)) < len(names):
            raise ProtochainError(
                f"methods {', '.join(self.methods)}: two have one name, and so would their files"
            )
        for recipe in recipes:
            Minimisation(recipe, **self.minimising)
        if self.n_starts > 1:
            refuse_restraints(self.restraints, self.max_rmsd)
        object.__setattr__(self, "relaxing", replace(self.relaxing, tolerance=tolerance))
        if RELAX in self.methods:
            held = Hold.of(self.restraints)
            if held != Hold() and not held.listed:
                remedy = "springs of a minimisation; for relax give restraints, or ", Argument("stiffness")
                raise refusal("restraints", f"{self.restraints!r}", *remedy)
            restraints = held.listed or self.relaxing.restraints
            object.__setattr__(self, "relaxing", replace(self.relaxing, restraints=restraints))
            _ = self.of_relaxing  # It may raise.

    @property
    def minimising(self) -> dict[str, Any]:
        """Settings of a minimisation by name."""
        return {field.name: getattr(self, field.name) for field in fields(MinimiseSettings)}

    @property
    def of_relaxing(self) -> Setup:
        """Setup of ``relax``. A protocol may set the force field."""
        return self.relaxing.setup(self.setup)

    @property
    def idle(self) -> frozenset[str]:
        """Names of the settings that no method uses."""
        relaxes, minimises = RELAX in self.methods, {*self.methods} != {RELAX}
        without: frozenset[str] = frozenset()
        return (without if minimises else _OF_MINIMISING) | (without if relaxes else _OF_RELAXING)

    def changed(self, **settings: Any) -> "BatchSettings":
        """Return a copy with settings replaced by name, also in the setup and in ``relax``."""
        refuse_unknown(settings, NAMES)
        for group, names in (("setup", _OF_SETUP), ("relaxing", _OF_RELAXING - _SHARED)):
            parts = {name: settings.pop(name) for name in names if name in settings}
            if parts:
                settings[group] = replace(settings.get(group, getattr(self, group)), **parts)
        return replace(self, **settings)

    def read(self, row: Mapping[str, str]) -> "BatchSettings":
        """Return a copy with settings replaced by the cells of a manifest's row. Empty cells are skipped."""
        options = {name: _OF_OPTION.get(name.replace("-", "_"), name.replace("-", "_")) for name in row}
        refuse_unknown((name for name, option in options.items() if option not in _IN_MANIFEST), _COLUMNS)
        cells = {options[name]: text.strip() for name, text in row.items() if text.strip()}
        if ":" in cells.get("methods", ""):
            raise ProtochainError("methods: an import path runs code; give it as an option of the batch")
        try:
            settings = self.changed(**{name: _IN_MANIFEST[name](text) for name, text in cells.items()})
        except ProtochainError:
            raise
        except ValueError as error:
            raise ProtochainError(str(error)) from error
        settings.refuse_idle(cells)
        return settings

    def refuse_idle(self, names: Iterable[str], idle: frozenset[str] | None = None) -> None:
        """Raise for the first setting that no method uses, as it would have no effect."""
        idle = self.idle if idle is None else idle
        name = next((name for name in names if name in idle - _SHARED), None)
        if name is not None:
            raise ProtochainError(
                Argument(name), f": does not apply to {', '.join(self.methods)}; remove it, or choose other ",
                Argument("methods"),
            )  # fmt: skip

    def values(self) -> dict[str, Any]:
        """Return all plain values by name, except ``threads``, which does not change results."""
        setup = self.of_relaxing if self.methods == (RELAX,) else self.setup
        values = asdict(self) | asdict(self.relaxing) | asdict(setup)
        return {name: value for name, value in values.items() if name not in _NO_VALUES}

    def record(self) -> dict[str, Any]:
        """Return the plain values by name on which the results of the methods depend."""
        # Files call the restraints of minimisations ``restraint``, and those of ``relax`` ``restraints``.
        values = self.values() | {"restraint": self.restraints}
        return {name: value for name, value in values.items() if name not in self.idle}


def refuse_unknown(names: Iterable[str], known_names: Sequence[str]) -> None:
    """Raise for the first unknown name, and list the known names."""
    unknown = next((name for name in names if name not in known_names), None)
    if unknown is not None:
        raise ProtochainError(
            f"no setting is called {unknown!r}; choose from {', '.join(dict.fromkeys(known_names))}"
        )


def _truth(text: str) -> bool:
    if text.lower() not in ("true", "false", "yes", "no", "1", "0"):
        raise ValueError(f"{text!r} is neither true nor false")
    return text.lower() in ("true", "yes", "1")


_NO_VALUES = ("setup", "relaxing", "threads")
_OF_SETUP = tuple(field.name for field in fields(Setup))
_SHARED = {"tolerance", "restraints"}
_OF_RELAXING = frozenset(OF_RELAXING) - {"tolerance"}
_OF_MINIMISING = frozenset(field.name for kind in (MinimiseSettings, StartSettings) for field in fields(kind))
_OF_MINIMISING = (_OF_MINIMISING - _SHARED) | {*WITHOUT, "restraint"}
NAMES = tuple(dict.fromkeys((*(field.name for field in fields(BatchSettings)), *OF_RELAXING, *_OF_SETUP)))
"""Settings of a batch's structures, by the names of their fields."""


def _reader(option: Setting) -> Callable[[str], Any]:
    """Reader of a cell of a manifest, whose text is the value of the option."""
    kind = _READERS.get(option.kind, str)
    return lambda text: option.read(kind(text)) if option.read else kind(text)


_READERS: Mapping[Any, Callable[[str], Any]] = {bool: _truth, int: int, float: float}
_SETTINGS = {
    name: option
    for kind in (BatchSettings, RelaxSettings, Setup)
    for name, option in settings_of(kind)
    # A list of structures may not decide that the code in a force-field file is run.
    if name not in (*_NO_VALUES, "trust_forcefield")
}
_IN_MANIFEST = {name: _reader(option) for name, option in _SETTINGS.items()}
"""Columns of a manifest, except ``path``, and readers of their cells. Angles are in degrees."""
_OF_OPTION = {c: n for n, option in _SETTINGS.items() for c in option.columns(n)} | checks.RENAMED_KEYWORDS
"""Fields by the names of their options. A manifest may use both names, and former ones."""
_COLUMNS = tuple(option.columns(name)[0] for name, option in _SETTINGS.items())


@document_fields
@dataclass(frozen=True)
class Job:
    """Structure to minimise, with its settings."""

    name: str  # Unique name in the batch, and stem of its files.
    path: Path  # Absolute path.
    # Settings of the job. The setup's model is a number, or None for the first model.
    settings: BatchSettings
    key: str  # SHA-256 of the file's content, the settings, and the version of protochain.

    @property
    def identity(self) -> tuple[str, str]:
        """Name and key. Rows of an earlier file or with other settings have another key."""
        return self.name, self.key

    def anywhere(self) -> "Job":
        """Copy for a worker in another folder, with absolute paths of files."""
        setup = self.settings.setup
        files = {str(file): str(file.absolute()) for file in _files(setup)}
        force_field = ",".join(files.get(part, part) for part in checks.force_field_parts(setup.forcefield))
        records = [(name, source, *file_and_record(source)) for name, source in setup.ligands]
        ligands = tuple(
            (name, f"{files[str(file)]}#{record}".removesuffix("#0") if str(file) in files else source)
            for name, source, file, record in records
        )
        charges = files.get(setup.ligand_charges, setup.ligand_charges)
        absolute_paths = {"forcefield": force_field, "ligands": ligands, "ligand_charges": charges}
        return replace(self, settings=self.settings.changed(**absolute_paths)) if files else self


@dataclass(frozen=True)
class Row:
    """Result of one method for one structure: its row of ``summary.csv``, and rows of ``traces.csv``."""

    record: dict[str, Any]
    trace: list[dict[str, float]]


def failure(job: Job, method: str, status: str, message: str, seconds: float = 0.0) -> Row:
    """Return the row of a method without a result. ``status`` and ``message`` state the reason."""
    record = origin(job) | {"method": method, "status": status, "message": " ".join(message.split())}
    return Row(record | {"seconds": seconds}, [])


def origin(job: Job) -> dict[str, Any]:
    """Return the columns that identify the structure of a row."""
    model = job.settings.setup.model
    return {
        "structure": job.name,
        "input": as_utf8(str(job.path)),
        "model": "" if model is None else model,
        "key": job.key,
    }


@dataclass(frozen=True)
class _JobInput:
    path: Path
    settings: BatchSettings
    root: Path  # Folder relative to which the structure is named.
    pose: str = ""  # Or name of the design.


def find_jobs(
    inputs: Iterable[str | Path],
    settings: BatchSettings,
    manifest: Path | None = None,
    output: Path | None = None,
    earlier: Sequence[Earlier] = (),
) -> list[Job]:
    """List the jobs of a batch.

    Parameters
    ----------
    inputs : iterable of str or path-like
        Files, folders (all structures below them), patterns, or ``-`` for a list on standard input.
    settings : BatchSettings
        Settings of all jobs. With the model ``all``, each model of a file is a job.
    manifest : Path, optional
        CSV with a column ``path`` and any of the settings. Paths are relative to its folder.
    output : Path, optional
        Output folder. It is not searched, and inputs must not be inside it.
    earlier : sequence of Earlier, optional
        Results in the output folder, whose names are reused.

    Returns
    -------
    list of Job
        Jobs in the order of the inputs, without duplicates. They are named after their files, relative to the
        common folder. A file that is missing or cannot be read is a job that fails.

    Raises
    ------
    ProtochainError
        If there is nothing to do, no file exists, the manifest is invalid, no method uses a setting, or an
        input might be replaced.
    """
    inputs_found = [
        _JobInput(path, settings, root) for source in inputs for path, root in _paths(str(source), output)
    ]
    if manifest:
        inputs_found += _from_manifest(manifest, settings)
    for split in (_poses, _designs, _models):
        inputs_found = [part for whole in inputs_found for part in split(whole)]
    unique: dict[tuple[Path, BatchSettings, str], _JobInput] = {}
    for job_input in inputs_found:
        # Designs with equal letters are separate.
        unique.setdefault((job_input.path.absolute(), job_input.settings, job_input.pose), job_input)
    inputs_found = list(unique.values())
    for path in (*(job_input.path for job_input in inputs_found), *([manifest] if manifest else [])):
        if _is_inside(path, output):
            raise ProtochainError(f"{path}: is inside the output folder; choose another output folder")
    prefix = f"{manifest}: " if manifest else ""
    if not inputs_found:
        raise ProtochainError(f"{prefix}no structures found; give files, folders or patterns")
    if not any(job_input.path.exists() for job_input in inputs_found):
        raise ProtochainError(
            f"{prefix}{inputs_found[0].path}: not found, nor any other structure; check the names"
        )
    default_values = BatchSettings().values()
    settings.refuse_idle(
        (name for name, value in settings.values().items() if value != default_values[name]),
        frozenset.intersection(*(job_input.settings.idle for job_input in inputs_found)),
    )
    jobs = [Job("", i.path.absolute(), i.settings, _key(i.path, i.settings, i.pose)) for i in inputs_found]
    requested = [
        NameRequest(job.path, i.root, job.settings.setup.model, job.key, job.settings.methods, i.pose)
        for i, job in zip(inputs_found, jobs, strict=True)
    ]
    return [replace(job, name=name) for job, name in zip(jobs, assign_names(requested, earlier), strict=True)]


def read_names(by_nul: bool = False) -> list[str]:
    """Names on standard input, separated by line ends, or by NULs, as of ``find -print0``."""
    data = sys.stdin.buffer.read() if hasattr(sys.stdin, "buffer") else sys.stdin.read().encode()
    # Names of files need not be text.
    text = os.fsdecode(data)
    if by_nul or "\0" in text:
        return [name for name in text.split("\0") if name]
    return [line.strip() for line in text.splitlines() if line.strip()]


def _paths(source: str, output: Path | None) -> Iterator[tuple[Path, Path]]:
    """Files of a source, each with the folder relative to which it is named."""
    if source == "-":
        for name in read_names():
            yield from _paths(name, output)
    elif Path(source).is_dir():
        if output and (absolute(Path(source)) == absolute(output) or _is_inside(Path(source), output)):
            raise ProtochainError(
                f"{source}: is the output folder or inside it; choose another output folder"
            )
        candidates = (path for path in Path(source).rglob("*") if format_of(path))
        # A listed path that does not exist is a broken link.
        matches = sorted(path for path in candidates if path.is_file() or not path.exists())
        yield from ((path, Path(source)) for path in matches if not _is_inside(path, output))
    elif not Path(source).exists() and _GLOB & set(source):
        names = sorted(glob.glob(source, recursive=True))  # noqa: PTH207 (a pattern may be absolute)
        if not names:
            raise ProtochainError(f"{source}: matches no file")
        fixed_parts = itertools.takewhile(lambda part: not _GLOB & set(part), Path(source).parts)
        root = Path(*fixed_parts)
        yield from ((Path(path), root) for path in names if not Path(path).is_dir())
    else:
        yield Path(source), Path(source).parent


def _is_inside(path: Path, folder: Path | None) -> bool:
    """Whether a path is inside a folder, before or after resolving links."""
    if folder is None:
        return False
    return absolute(folder) in absolute(path).parents or folder.resolve() in path.resolve().parents


def _from_manifest(manifest: Path, settings: BatchSettings) -> list[_JobInput]:
    if not regular(manifest).exists():
        raise ProtochainError(f"{manifest}: not found; give a CSV file with a column 'path'")
    try:
        with manifest.open(newline="", encoding="utf-8-sig") as file:
            reader = csv.DictReader(file, restkey="", restval="")
            names, rows = reader.fieldnames or (), [(reader.line_num, row) for row in reader]
    except (UnicodeDecodeError, csv.Error) as error:
        raise ProtochainError(f"{manifest}: cannot be read ({error}); write it as CSV in UTF-8") from None
    if "path" not in names:
        raise ProtochainError(f"{manifest}: has no column 'path'")
    candidates = []
    for line, row in rows:
        try:
            if "" in row:
                raise ProtochainError("more cells than columns")
            if any(character < " " for character in row["path"].strip()):
                raise ProtochainError("its path has control characters, as after a quotation mark left open")
            row_settings = settings.read({k: v for k, v in row.items() if k != "path"})
        except ProtochainError as error:
            raise ProtochainError(f"{manifest}: line {line}: ", *error.parts) from error
        path = manifest.parent / row["path"].strip()
        candidates.append(_JobInput(path, row_settings, path.parent))
    return candidates


def _poses(job_input: _JobInput) -> list[_JobInput]:
    """Copies of an input, one for each pose of a folder or file of ligands."""
    ligands = job_input.settings.setup.ligands
    groups = [source for source in job_input.settings.setup.poses if has_poses(source)]
    if not groups:
        return [job_input]
    group, *further = groups
    if further:
        raise ProtochainError(f"{further[0]}: has several poses, as {group}; place all in one file or folder")
    sources = poses(Path(group))
    if not sources:
        raise ProtochainError(
            f"{group}: contains no poses; give a folder of {', '.join(checks.MOLECULE_SUFFIXES)}"
        )
    other_ligands = tuple(part for part in ligands if part != ("", group))
    return [
        replace(
            job_input,
            settings=job_input.settings.changed(ligands=(*other_ligands, ("", pose))),
            pose="_".join(str(part) for part in (file.stem, record) if part),
        )
        for pose in sources
        for file, record in [file_and_record(pose)]
    ]


def _designs(job_input: _JobInput) -> list[_JobInput]:
    """Copies of an input, one for each design of a FASTA file."""
    settings = job_input.settings
    file = settings.relaxing.sequence or settings.setup.sequence
    return [
        replace(
            job_input,
            settings=replace(
                settings, setup=replace(settings.setup, sequence=letters),
                relaxing=replace(settings.relaxing, sequence=settings.relaxing.sequence and letters),
            ),
            pose="_".join(filter(None, (job_input.pose, name))),
        )
        for name, letters in designs(file)
    ] or [job_input]  # fmt: skip


def _models(job_input: _JobInput) -> list[_JobInput]:
    requested = job_input.settings.setup.model
    if not isinstance(requested, str):
        return [job_input]
    models: Sequence[int | None]
    if requested == ALL_MODELS:
        try:
            numbers = model_numbers(job_input.path)
        except (ProtochainError, OSError):
            numbers = []  # The job reports the reason when it runs.
        models = numbers if len(numbers) > 1 else [None]
    else:
        models = parse_models(requested)  # A job without its model reports that.
    return [replace(job_input, settings=job_input.settings.changed(model=model)) for model in models]


def _files(setup: Setup) -> list[Path]:
    """Further files for preparing a structure: force fields, ligands and their charges."""
    sources = (*(file_and_record(source)[0] for _, source in setup.ligands), Path(setup.ligand_charges))
    return [*user_files(setup.forcefield), *(file for file in sources if file.is_file())]


def _hash(path: Path) -> str:
    try:
        with regular(path).open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except (OSError, ProtochainError):  # The job reports the reason.
        return ""


def _key(path: Path, settings: BatchSettings, pose: str) -> str:
    hashes = "".join(map(_hash, _files(settings.setup)))
    parts = [version("protochain"), _hash(path), settings.record(), hashes, *([pose] if pose else [])]
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()
