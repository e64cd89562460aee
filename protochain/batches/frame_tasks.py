"""Tasks on the frames of an ensemble, and their jobs for processes."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from time import perf_counter
from typing import Any, Protocol

import numpy as np

from protochain.batches.cluster import load_shared, reason
from protochain.chains.setup import Setup
from protochain.core import defaults
from protochain.core.arrays import Floats, Value
from protochain.core.errors import Argument, ProtochainError
from protochain.core.markup import plural
from protochain.core.units import ANGSTROM_PER_NM
from protochain.energies import Energy
from protochain.energies.decomposed import TERMS, energy_terms
from protochain.energies.on_device import choose_device
from protochain.minimisers.verdict import Status
from protochain.relaxation.record import INTERFACE_COLUMNS, OF_FRAMES
from protochain.relaxation.relax_settings import RelaxSettings
from protochain.relaxation.relax_structure import relax_structure
from protochain.results.columns import Column, flat, record
from protochain.structure import Structure
from protochain.structure.ensemble import Ensemble
from protochain.structure.formats.frames import Frame, Reading, open_frames
from protochain.structure.select import sides, split_sides, touching_chains
from protochain.validation.findings import MEASURES, Findings
from protochain.validation.interface import MAKEUP, RESIDUES, SCORES, as_native, score_sides
from protochain.validation.likeness import LIKENESS, likeness

Act = Callable[[Structure], tuple[dict[str, Any], Floats | None]]
"""Function of a frame: its structure -> values of its row, and changed positions (na, 3), nm, or None."""


class Task(Protocol):
    """Task on every frame, a frozen value. It is pickled once for each process."""

    @property
    def name(self) -> str: ...  # noqa: D102 (of a protocol)
    @property
    def columns(self) -> tuple[str, ...]:
        """Columns of a row, except ``frame``, ``time_ps`` and ``message``."""

    @property
    def at_a_time(self) -> int:
        """Frames of a job."""

    def begin(self, structure: Structure, threads: int | None) -> Act:
        """Prepare the values that all frames of a structure share."""

    def settings(self) -> dict[str, Any]:
        """Plain values on which the rows depend."""
        options = dict[str, Any]()
        for name, value in vars(self).items():
            if isinstance(value, Setup | RelaxSettings):
                options |= {key: option for key, option in vars(value).items() if key != "threads"}
            elif isinstance(value, Structure):
                options[name] = value.name
                options[f"atoms of the {name}"] = value.fingerprint
                options[f"positions of the {name}"] = value.positions_fingerprint
            elif name != "energy":
                options[name] = value
        return options


@dataclass(frozen=True)
class RelaxFrames(Task):
    """Relax each frame: :func:`protochain.relax`, with one energy for all."""

    relaxing: RelaxSettings
    setup: Setup
    energy: Energy | None = None  # Replaces the energy of the setup.
    name = "relax"
    at_a_time = 1

    @property
    def _columns(self) -> tuple[Column, ...]:
        return (*OF_FRAMES, *(INTERFACE_COLUMNS if self.relaxing.interface else ()))

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns of a relaxation that may differ between frames, and scores of the interface."""
        return tuple(column.key for column in self._columns)

    def begin(self, structure: Structure, threads: int | None) -> Act:
        """Build the energy, if there is none."""
        energy = self.energy or _with_threads(_for_many(self.setup, structure), threads).energy(structure)

        def act(frame: Structure) -> tuple[dict[str, Any], Floats | None]:
            _begin_anew(energy, frame.positions)
            relaxation = relax_structure(frame, energy, self.relaxing, move=self.setup.move)
            if relaxation.status is Status.INTERRUPTED:
                raise KeyboardInterrupt
            row = {key: flat(value) for key, value in record(self._columns, relaxation).items()}
            return row, relaxation.x if relaxation.is_usable else None

        return act


@dataclass(frozen=True)
class ValidateFrames(Task):
    """Errors and outliers of each frame, and similarity to a reference, as :func:`protochain.validate`."""

    setup: Setup
    reference: Structure | None = None
    name = "validate"
    at_a_time = 8

    @property
    def columns(self) -> tuple[str, ...]:
        """Measures of errors, and of similarity."""
        return (*MEASURES, *(LIKENESS if self.reference else ()))

    def begin(self, structure: Structure, threads: int | None) -> Act:
        """Return the function. Validation needs no preparation."""

        def act(frame: Structure) -> tuple[dict[str, Any], Floats | None]:
            row = Findings(frame, frame.positions).measures()
            if self.reference is not None:
                row |= likeness(frame, self.reference).measures
            return row, None

        return act


@dataclass(frozen=True)
class EnergyFrames(Task):
    """Energy of each frame by term, as :func:`protochain.energy_terms`."""

    setup: Setup
    between: str | None = None  # Two parts, for their interaction energy.
    energy: Energy | None = None  # Replaces the energy of the setup.
    whole: bool = False  # Only the total energy, and the forces.
    name = "energy"
    at_a_time = 8

    @property
    def columns(self) -> tuple[str, ...]:
        """Terms of the energy. For two parts, terms of their interaction and desolvation."""
        if self.whole:
            return ("energy_kj_mol", "rms_force_kj_mol_nm")
        totals = (*TERMS, "total")
        if self.between is None:
            return tuple(f"{term}_kj_mol" for term in totals)
        return tuple(f"{part}_{term}_kj_mol" for part in _OF_PARTS for term in totals)

    def begin(self, structure: Structure, threads: int | None) -> Act:
        """Build the energy, if there is none."""
        energy = self.energy or _with_threads(self.setup, threads).energy(structure)

        def act(frame: Structure) -> tuple[dict[str, Any], Floats | None]:
            _begin_anew(energy, frame.positions)
            if self.whole:
                value, forces = energy(frame.positions)
                return dict(zip(self.columns, (value, float(np.sqrt(np.mean(forces**2)))), strict=True)), None
            table = energy_terms(frame, between=self.between, energy=energy)
            prefixes = {"whole": ""} if self.between is None else {part: f"{part}_" for part in _OF_PARTS}
            rows = table.to_dict("index")
            return {
                f"{stem}{term}_kj_mol": e for part, stem in prefixes.items() for term, e in rows[part].items()
            }, None

        return act


@dataclass(frozen=True)
class ScoreFrames(Task):
    """Score an interface of each frame, as :func:`protochain.score_interface`."""

    setup: Setup
    interface: str | None = None  # Its sides, as ``A,B:C``. By default, the only two chains in contact.
    relax: bool = False  # Before scoring.
    reference: Structure | None = None  # Complex from which the sides of a frame deviate.
    name = "score"
    at_a_time = 1

    @property
    def columns(self) -> tuple[str, ...]:
        """The sides, their scores, and RMSDs from the reference."""
        from protochain.comparison.docking import DOCKING

        return ("interface", *SCORES, *MAKEUP, *RESIDUES, *(DOCKING if self.reference else ()))

    def begin(self, structure: Structure, threads: int | None) -> Act:
        """Find the sides, and build the energy."""
        from protochain.comparison.docking import Pairing, docking

        pairs = [split_sides(structure, self.interface)] if self.interface else touching_chains(structure)
        if len(pairs) != 1:
            problem = f"{plural(len(pairs), 'pair')} of its chains are in contact; give "
            raise ProtochainError(f"{structure.name}: {problem}", Argument("interface"))
        parts = sides(structure, *pairs[0])
        energy = as_native(_with_threads(self.setup, threads).energy(structure))

        def act(frame: Structure) -> tuple[dict[str, Any], Floats | None]:
            _begin_anew(energy, frame.positions)
            if self.relax:
                frame = relax_structure(frame, energy, RelaxSettings()).structure
            row = score_sides(frame, energy, *pairs[0], parts).record()
            row |= docking(Pairing.of(self.reference, frame), *pairs[0]) if self.reference else {}
            return {key: row[key] for key in self.columns}, None

        return act


@dataclass(frozen=True)
class RmsdFrames(Task):
    """Measure the deviation of each frame from a reference, as :func:`protochain.deviation`."""

    reference: Structure
    align: str  # align, measure: Selections of atoms.
    measure: str
    name = "rmsd"
    at_a_time = 8

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns of a deviation."""
        from protochain.comparison.deviation import COLUMNS

        return tuple(column.key for column in COLUMNS)

    def begin(self, structure: Structure, threads: int | None) -> Act:
        """Return the function of a frame."""
        from protochain.comparison.deviation import deviation

        return lambda frame: (deviation(self.reference, frame, self.align, self.measure).record(), None)


_OF_PARTS = ("interaction", "desolvation", "sum")


def _with_threads(setup: Setup, threads: int | None) -> Setup:
    return setup if threads is None else replace(setup, threads=threads)


def _for_many(setup: Setup, structure: Structure) -> Setup:
    """Setup for many frames, which share one device context. A device pays off for fewer atoms."""
    fewest = defaults.DEVICE_FROM_IN_FRAMES
    device = "cpu" if setup.engine == "native" else choose_device(setup.device, structure.n_atoms, fewest)
    return replace(setup, device=device)


def _begin_anew(energy: Energy, x: Floats) -> None:
    """Build neighbour lists for a frame, so that its results do not depend on earlier frames."""
    for level in (energy, getattr(energy, "coarse", None)):
        if level is not None and level.lists_at is not None:
            level.list_at(x)


@dataclass(frozen=True, eq=False)
class FrameRow(Value):
    """Row and positions (na, 3), nm, of a frame from a process, and whether the process ended at it."""

    index: int
    record: Mapping[str, Any]
    x: Floats | None
    process_ended: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "record", dict(self.record))


@dataclass(frozen=True)
class FrameJob:
    """Frames for a process."""

    task: Path  # Pickled ensemble, task and file of the frames.
    frames: tuple[Frame | int, ...]  # Or indices in the file: reading a damaged one may end the process.

    @property
    def indices(self) -> tuple[int, ...]:
        """Indices of the frames."""
        return tuple(frame if isinstance(frame, int) else frame.index for frame in self.frames)

    def run(self, threads: int) -> Iterator[FrameRow]:
        """Run the task on each frame."""
        ensemble, act, reading = prepare_task(self.task, threads)
        for frame in self.frames:
            yield row_of(ensemble, act, reading.at(frame) if isinstance(frame, int) else frame)

    def lost(self, finished_rows: Sequence[Any], status: str, message: str, seconds: float) -> list[FrameRow]:
        """Row of the frame at which the process ended, the first unfinished one."""
        lost_frame = self.frames[len(finished_rows)]
        frame = Frame(lost_frame, None) if isinstance(lost_frame, int) else lost_frame
        row = origin(frame) | failure_columns(frame, status, message) | {"seconds": seconds}
        return [FrameRow(frame.index, row, None, status == "killed")]


@lru_cache(maxsize=1)
def prepare_task(path: Path, threads: int) -> tuple[Ensemble, Act, Any]:
    """Ensemble, prepared task and frames of a pickled file."""
    ensemble, task, source = load_shared(path)
    reading = None if source is None else Reading(open_frames(source))
    return ensemble, task.begin(ensemble.structure, threads), reading


def row_of(ensemble: Ensemble, act: Act, frame: Frame) -> FrameRow:
    """Run the task on a frame. Errors are reported in its row."""
    row, began = origin(frame), perf_counter()
    try:
        structure = ensemble.at(frame)
        gap = ensemble.gap(structure.positions)
        row[GAP] = None if gap is None else ANGSTROM_PER_NM * gap
        values, x = act(structure)
        values["seconds"] = perf_counter() - began
        row |= {"status": "measured", "message": ""} | values
        return FrameRow(frame.index, row, structure.positions if x is None else x)
    except Exception as error:
        failure = failure_columns(frame, *reason(error))
    return FrameRow(frame.index, row | failure | {"seconds": perf_counter() - began}, None)


GAP = "largest_gap_angstrom"
"""Largest distance of a molecule from the molecules that it touches in the structure."""


def origin(frame: Frame) -> dict[str, Any]:
    """Columns that identify the frame of a row."""
    return {"frame": frame.index, "time_ps": frame.time}


def failure_columns(frame: Frame, status: str, message: str) -> dict[str, Any]:
    """Columns of an unusable frame."""
    return {"status": status, "message": f"frame {frame.index}: {' '.join(message.split())}"}
