"""Output files of a simulation: trajectory, log, checkpoint, final structure and summary."""

import csv
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from protochain.core.arrays import Floats, freeze
from protochain.core.checkpoints import Checkpoint, checkpoint, write_checkpoint
from protochain.core.errors import Argument, ProtochainError, WriteError
from protochain.core.storage import check_writable, writing
from protochain.dynamics.loop import State
from protochain.dynamics.thermostats import Bath
from protochain.mechanics.motion.system import Phase
from protochain.mechanics.multibody import Frames, Tree, pose
from protochain.mechanics.multibody.articulated import Articulated, articulate
from protochain.results.run_folder import GrowingTable, refuse_earlier, remove_files
from protochain.structure import Structure
from protochain.structure.formats.trajectory import TrajectoryFile, check_trajectory

CHECKPOINT = "checkpoint.npz"
_OUTPUTS = (CHECKPOINT, "last.pdb", "last.cif", "summary.json", "log.csv", "report.html")
_PART = "log.part.csv"
_END = "\r\n"
"""End of a line of the log, as in the csv module."""


def files_of(path: Path, suffix: str) -> list[Path]:
    """Files that a simulation may write or delete in its folder."""
    return [path / name for name in (*_OUTPUTS, _PART, f"trajectory.{suffix}", f"trajectory.part.{suffix}")]


def check_folder(path: Path, suffix: str, resume: bool, force: bool) -> None:
    """Check the output folder before any work is done."""
    check_trajectory(path / f"trajectory.{suffix}")
    check_writable(path / CHECKPOINT)
    existing = [name for name in (CHECKPOINT, "log.csv", _PART) if (path / name).exists()]
    if existing and not (resume or force):
        raise refuse_earlier(path, f"a simulation ({existing[0]})")
    if resume and not (path / CHECKPOINT).exists():
        raise ProtochainError(
            f"{path}: contains no {CHECKPOINT} to resume from; remove ", Argument("resume", True)
        )


def _open_checkpoint(path: Path, settings: Mapping[str, Any]) -> AbstractContextManager[Checkpoint]:
    return checkpoint(path / CHECKPOINT, settings, "simulation", *_RESTART)


_RESTART = "start again with ", Argument("force", True)

CONSTANTS = ("loop_lengths", "pull_start", "hinge_rest")
"""Constants that a run measures at its start: distances at closed loops, nm, the distance between the places
of a pull, nm, and values of hinges with springs, rad."""


def constants_of(path: Path) -> dict[str, Floats]:
    """Constants that the simulation in a folder measured at its start, by name."""
    with _open_checkpoint(path, {}) as contents:
        return dict(contents.arrays)


class Folder:
    """Files of one simulation, which are extended during the run.

    ``trajectory.dcd`` (or ``.xtc``) and ``log.csv`` are named ``trajectory.part.dcd`` and ``log.part.csv``
    until the run has ended without becoming unstable. A resumed run must have the settings of the checkpoint.
    """

    def __init__(
        self, path: Path, suffix: str, settings: Mapping[str, Any], constants: Mapping[str, Floats]
    ) -> None:
        self.path, self.settings, self.constants = path, settings, constants
        self.trajectory = path / f"trajectory.{suffix}"
        self.log, self.log_part = path / "log.csv", path / _PART
        self.stored: dict[str, Any] = {}
        """Counts of the last checkpoint: step, frames, and bytes of the files."""

    def open(self, structure: Structure, start: Floats, frame_interval: float, columns: list[str]) -> None:
        """Create the files of a simulation that starts at positions (na, 3)."""
        self.start = start
        self.path.mkdir(parents=True, exist_ok=True)
        remove_files(self.path / name for name in (*_OUTPUTS, self.trajectory.name))
        self._frames = TrajectoryFile(self.trajectory, structure, frame_interval)
        with writing(self.log):
            self._rows = GrowingTable(self.log_part, columns, end=_END)

    def resume(
        self, tree: Tree, structure: Structure, frame_interval: float, first: Callable[[Phase], Bath],
        columns_of: Callable[[State, Floats], list[str]],
    ) -> tuple[State, list[dict[str, float]], Floats]:  # fmt: skip
        """Open the files of an earlier run and truncate them to its last checkpoint: frame_interval ps."""
        with _open_checkpoint(self.path, self.settings) as contents:
            state = _state(tree, contents)
            contents.array("memory", first(state.at).memory.shape)
            self.start = contents.array("start", (structure.n_atoms, 3))
            for name, constant in self.constants.items():
                contents.array(name, constant.shape)
            n_listed = len(contents.arrays["lists_at"])
            lists_at = contents.array("lists_at", (structure.n_atoms if n_listed else 0, 3))
            counted = ("step", "frames", "trajectory_bytes", "log_bytes")
            self.stored = values = {name: contents.count(name) for name in counted}
        # All is read before any file is changed, so that a refused run does not change its folder.
        log = self.log_part if self.log_part.exists() else self.log
        text = log.read_bytes()[: values["log_bytes"]] if log.exists() else b""
        if len(text) < values["log_bytes"]:
            raise ProtochainError(f"{log}: rows before the checkpoint are missing; ", *_RESTART)
        columns = columns_of(state, self.start)
        try:
            reader = csv.DictReader(text.decode().splitlines())
            rows = [{name: float(value) for name, value in row.items()} for row in reader]
            if list(reader.fieldnames or ()) != columns:
                raise ValueError("other columns")
        except (TypeError, ValueError, csv.Error) as error:
            raise ProtochainError(f"{log}: damaged log ({error}); ", *_RESTART) from None
        self._frames = TrajectoryFile(
            self.trajectory, structure, frame_interval, (values["frames"], values["trajectory_bytes"])
        )
        log.replace(self.log_part)
        self._rows = GrowingTable(self.log_part, columns, values["log_bytes"], _END)
        return state, rows, lists_at

    def append(self, row: Mapping[str, float], x: Floats) -> None:
        """Write a frame and its row of the log."""
        self._frames.append(x)
        with writing(self.log):
            self._rows.append(row)

    def store(self, state: State, lists_at: Floats | None) -> None:
        """Write a checkpoint, after flushing to disk the frames and rows that it counts."""
        frames, trajectory_bytes = self._frames.sync()
        with writing(self.log):
            log_bytes = self._rows.sync()
        values = {
            "step": state.step, "potential": state.at.potential, "bath_energy": state.bath.energy,
            "damped": state.damped, "time": state.at.time, "frames": frames,
            "trajectory_bytes": trajectory_bytes, "log_bytes": log_bytes,
        }  # fmt: skip
        at, factors = state.at, state.at.factors
        arrays = {
            "q": at.q, "qd": at.qd, "p": at.p, "torque": at.torque, "memory": state.bath.memory,
            "rotation": factors.frames.rotation, "origin": factors.frames.origin, "inertia": factors.inertia,
            "gain": factors.gain, "pivot": factors.pivot, "root": factors.root,
            "start": self.start, "lists_at": np.empty((0, 3)) if lists_at is None else lists_at,
            "work": at.work, "loads": np.empty((0, len(at.qd))) if at.loads is None else at.loads,
            **{name: self.constants.get(name, np.empty(0)) for name in CONSTANTS},
        }  # fmt: skip
        write_checkpoint(self.path / CHECKPOINT, arrays, values, self.settings)
        self.stored = values

    def close(self, sound: bool) -> None:
        """Close the files, and rename them to their final names if the run is stable."""
        self._rows.close()
        if sound:
            self.log_part.replace(self.log)
            self._frames.finish()
        else:
            self._frames.close()

    def rescue(self) -> str:
        """Give the files of the last checkpoint their final names, after one could not be written."""
        if hasattr(self, "_rows"):
            with suppress(OSError):  # The buffer may contain data that a full disk did not accept.
                self._rows.close()
        if not self.stored:
            if hasattr(self, "_frames"):
                self._frames.discard()
            self.log_part.unlink(missing_ok=True)
            return ""
        if self.log_part.exists():
            os.truncate(self.log_part, self.stored["log_bytes"])
            self.log_part.replace(self.log)
        if hasattr(self, "_frames") and self._frames.part.exists():
            self._frames.finish_at(self.stored["frames"], self.stored["trajectory_bytes"])
        return f"{self.stored['frames']} frames, and the state to resume from step {self.stored['step']}"


@contextmanager
def rescue_on_failure(folder: Folder | None) -> Iterator[None]:
    """Save the files of a simulation if one cannot be written, and report them and how to continue."""
    try:
        yield
    except WriteError as error:
        saved = folder.rescue() if folder else ""
        if not saved:
            raise error.with_saved("nothing") from error
        raise error.with_saved(saved, "continue with ", Argument("resume", True)) from error


def _state(tree: Tree, contents: Checkpoint) -> State:
    """State of a checkpoint. Raise a ValueError unless all shapes fit the tree, as kernels require."""
    arrays, q = contents.arrays, contents.array("q", (tree.n_q,))
    fresh = articulate(tree, pose(tree, q))
    shapes = {
        "q": (tree.n_q,), "qd": (tree.n_v,), "p": (tree.n_v,), "torque": (tree.n_v,),
        "rotation": fresh.frames.rotation.shape, "origin": fresh.frames.origin.shape,
        "inertia": fresh.inertia.shape, "gain": fresh.gain.shape, "pivot": fresh.pivot.shape,
        "root": fresh.root.shape, "memory": (arrays["memory"].size,), "work": (arrays["work"].size,),
        "loads": (len(arrays["loads"]), tree.n_v),
    }  # fmt: skip
    a = {name: freeze(contents.array(name, shape)) for name, shape in shapes.items()}
    if len(a["loads"]) and len(a["loads"]) != len(a["work"]):
        raise ValueError(f"work of {len(a['work'])} loads, not {len(a['loads'])}")
    factors = Articulated(
        tree, Frames(a["rotation"], a["origin"]), a["inertia"], a["gain"], a["pivot"], a["root"]
    )
    potential, time, bath, damped = map(contents.number, ("potential", "time", "bath_energy", "damped"))
    loads = a["loads"] if len(a["loads"]) else None
    at = Phase(a["q"], a["qd"], a["p"], potential, a["torque"], factors, time, a["work"], loads)
    return State(contents.count("step"), at, Bath(bath, a["memory"]), damped)
