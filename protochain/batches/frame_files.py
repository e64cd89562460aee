"""Files of a run over frames: a table, a trajectory, and a checkpoint from which the run is resumed."""

import csv
import hashlib
import json
import os
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from time import monotonic
from typing import Any

from protochain.batches.batch_settings import run_settings
from protochain.batches.cluster import Processes
from protochain.batches.frame_tasks import GAP, Task
from protochain.batches.frames import FrameResult, over_frames
from protochain.batches.table import read_table
from protochain.core.checkpoints import Checkpoint, checkpoint, write_checkpoint
from protochain.core.errors import Argument, ProtochainError
from protochain.core.interrupts import held_interrupts
from protochain.core.lazy_pandas import pd
from protochain.core.storage import check_writable, claimed_files, writing
from protochain.results.run_folder import GrowingTable, checkpoint_of, refuse_earlier, refuse_existing, saving
from protochain.structure.ensemble import Ensemble
from protochain.structure.formats.files import format_of
from protochain.structure.formats.frames import Frames, open_frames
from protochain.structure.formats.trajectory import TrajectoryFile, check_trajectory, part_of
from protochain.structure.write import common_suffix, save

_KEEP_EVERY = 10.0  # s between checkpoints. Frames after the last checkpoint are computed again.
_MOST_IN_TEXT = 20_000_000  # Atoms of all models of a text file, which is built in memory.
_NOTHING: Mapping[str, Any] = {"rows": 0, "sound": 0, "bytes": 0, "trajectory": None, "counts": {}}
"""Checkpoint of a new run."""
FIRST = ("frame", "time_ps", "status", "message", GAP)

Watch = Callable[[int, int, FrameResult], None]
"""Called after each frame with the number of frames so far, the failures among them, and the frame."""


@dataclass(frozen=True)
class FramesRun:
    """Output of a run over frames."""

    csv: Path  # A row for each frame.
    trajectory: Path | None = None  # Usable frames, in their order.
    topology: Path | None = None  # Structure with the atoms of the trajectory.
    counts: Mapping[str, int] = field(default_factory=dict)  # Number of frames by status.
    written: int = 0  # Frames in the trajectory.
    interrupted: bool = False  # Whether the run ended before the last frame.
    was_complete: bool = False  # Whether an earlier run was complete.

    @cached_property
    def table(self) -> "pd.DataFrame":
        """The rows."""
        return read_table(self.csv, dict.fromkeys(("structure", "status", "message"), "string"))


def files_of(table: Path, trajectory: Path | None) -> list[Path]:
    """Files that a run writes."""
    files = [table, checkpoint_of(table)]
    if trajectory is None:
        return files
    if _in_text(trajectory):
        return [*files, trajectory, part_of(trajectory.with_suffix(".dcd"))]
    return [*files, trajectory, part_of(trajectory), _topology_path(trajectory)]


def check_output(trajectory: Path) -> None:
    """Refuse an unknown suffix of the output."""
    if not format_of(trajectory):
        check_trajectory(trajectory)


def run_frames(
    ensemble: Ensemble,
    frames: Frames,
    task: Task,
    table: Path,
    trajectory: Path | None = None,
    *,
    hydrogens: bool = True,
    processes: Processes | None = None,
    resume: bool = False,
    force: bool = False,
    watch: Watch | None = None,
) -> FramesRun:
    """Run a task on every frame. Write a row for each frame, and the changed frames."""
    if resume and not force and table.exists() and not checkpoint_of(table).exists():
        return _complete(ensemble, frames, task, table, trajectory)
    settings = _settings(ensemble, frames, task, hydrogens)
    interrupted = False
    with (
        claimed_files(*files_of(table, trajectory)),
        closing(_Files(ensemble, task, table, trajectory, hydrogens, settings, resume, force)) as files,
    ):
        try:
            left = frames.without_first(files.n_rows)
            for result in over_frames(ensemble, left, task, processes) if len(left) else ():
                with held_interrupts() as signals:
                    files.append(result)
                if watch:
                    watch(files.n_rows, files.n_rows - files.n_sound, result)
                if signals:
                    raise KeyboardInterrupt
        except KeyboardInterrupt:
            interrupted = True
        with held_interrupts():
            files.save_checkpoint()
            if not interrupted:
                files.finish()
    n_written = files.trajectory.n_frames if files.trajectory else 0
    return FramesRun(table, trajectory, files.topology, files.counts, n_written, interrupted)


def _columns(task: Task, trajectory: Path | None) -> tuple[str, ...]:
    return (*dict.fromkeys((*FIRST, *task.columns, "seconds")), *(("output_frame",) if trajectory else ()))


def _complete(
    ensemble: Ensemble, frames: Frames, task: Task, table: Path, trajectory: Path | None
) -> FramesRun:
    """Output of a complete run. Raise if the table has other frames or columns."""
    with table.open(newline="", encoding="utf-8", errors="replace") as file:
        reader = csv.DictReader(file)
        matches = tuple(reader.fieldnames or ()) == _columns(task, trajectory)
        rows = [(row["frame"], row["status"], row.get("output_frame")) for row in reader] if matches else []
    written = sum(bool(place) for *_, place in rows)
    has_frames = [frame for frame, *_ in rows] == [*map(str, frames.chosen)]
    if not has_frames or (written and trajectory and not trajectory.exists()):
        raise ProtochainError(
            f"{table}: belongs to another run, or is incomplete; give another output, or start again with ",
            Argument("force", True),
        )
    topology = None if trajectory is None or _in_text(trajectory) else _topology_path(trajectory, ensemble)
    counts = Counter(status for _, status, _ in rows)
    return FramesRun(table, trajectory, topology, counts, written, was_complete=True)


class _Files:
    """Table and trajectory, which grow together, and a checkpoint with their valid lengths."""

    def __init__(
        self, ensemble: Ensemble, task: Task, table: Path, trajectory: Path | None, hydrogens: bool,
        settings: Mapping[str, Any], resume: bool, force: bool,
    ) -> None:  # fmt: skip
        self.ensemble, self.table, self.output, self.hydrogens = ensemble, table, trajectory, hydrogens
        self.settings = settings
        self.checkpoint = checkpoint_of(table)
        self._saved = partial(saving, table, "the frames done before")
        check_writable(table)
        state = self._read_checkpoint(resume, force)
        self.counts: Counter[str] = Counter(state["counts"])
        self.n_rows, self.n_sound = state["rows"], state["sound"]
        self.trajectory: TrajectoryFile | None = None
        self.topology: Path | None = None
        if trajectory is not None and not _in_text(trajectory):
            self.topology = _topology_path(trajectory, ensemble)
        if trajectory is not None and not (force or self.checkpoint.exists()):
            refuse_existing([table, self.topology])
        table.parent.mkdir(parents=True, exist_ok=True)
        if trajectory is not None:
            binary = trajectory.with_suffix(".dcd") if _in_text(trajectory) else trajectory
            place = tuple(state["trajectory"]) if state["trajectory"] else None
            self.trajectory = TrajectoryFile(
                binary, ensemble.structure, resume_at=place, hydrogens=hydrogens or _in_text(trajectory)
            )
            if self.topology is not None:
                save(ensemble.structure, self.topology, hydrogens=hydrogens)
        with writing(table):
            self.rows = GrowingTable(table, _columns(task, trajectory), state["bytes"])
        self.saved_at = monotonic()
        self.save_checkpoint()

    def _read_checkpoint(self, resume: bool, force: bool) -> Mapping[str, Any]:
        """State of an interrupted run, or of a new run."""
        if self.checkpoint.exists() and resume:
            remedy = "give another output, or start again with ", Argument("force", True)
            with checkpoint(self.checkpoint, self.settings, "run over frames", *remedy) as read:
                state: dict[str, Any] = {name: read.count(name) for name in ("rows", "sound", "bytes")}
                state |= {name: read.values[name] for name in ("trajectory", "counts")}
                if sum(map(Checkpoint({}, state["counts"]).count, state["counts"])) != state["rows"]:
                    raise ValueError("inconsistent numbers")
            if not state["rows"]:
                return _NOTHING
            content = b""
            if self.table.exists():
                with self.table.open("rb") as file:
                    content = file.read(state["bytes"])
            if not content.endswith(b"\n") or content.count(b"\n") != state["rows"] + 1:
                raise ProtochainError(f"{self.table}: its rows differ from its checkpoint; ", *remedy)
            return state
        if self.checkpoint.exists() and not force:
            anew = ", ", Argument("force", True), " starts again"
            raise refuse_earlier(self.table, "an interrupted run", *anew)
        return _NOTHING

    def append(self, result: FrameResult) -> None:
        """Add a row, and the frame if it is usable."""
        row = dict(result.record)
        if result.structure is not None:
            self.n_sound += 1
            if self.trajectory:
                row["output_frame"] = self.trajectory.n_frames
                with self._saved():
                    self.trajectory.append(result.structure.positions)
        with self._saved():
            self.rows.append(row)
        self.counts[str(row["status"])] += 1
        self.n_rows += 1
        if monotonic() - self.saved_at > _KEEP_EVERY:
            self.save_checkpoint()

    def save_checkpoint(self) -> None:
        """Write the buffers and the checkpoint to the disk."""
        with self._saved():
            n_bytes = self.rows.sync()
            place = self.trajectory.sync() if self.trajectory else None
        state = {
            "rows": self.n_rows, "sound": self.n_sound, "bytes": n_bytes, "trajectory": place,
            "counts": dict(self.counts),
        }  # fmt: skip
        write_checkpoint(self.checkpoint, {}, state, self.settings)
        self.saved_at = monotonic()

    def finish(self) -> None:
        """Rename the trajectory, or convert it to models. Remove the checkpoint."""
        if self.trajectory and self.output:
            if self.trajectory.n_frames and not _in_text(self.output):
                self.trajectory.finish()
            elif self.trajectory.n_frames:
                self.trajectory.close()
                save(self._models(), self.output, hydrogens=self.hydrogens)
            self.trajectory.discard()
        self.checkpoint.unlink(missing_ok=True)

    def _models(self) -> list[Any]:
        assert self.trajectory
        s, n = self.ensemble.structure, self.trajectory.n_frames
        if n * s.n_atoms > _MOST_IN_TEXT:
            raise ProtochainError(
                f"{self.output}: {n} models of {s.n_atoms} atoms do not fit in memory; give .xtc or .dcd"
            )
        return [
            s.with_positions(frame.x) for frame in open_frames(self.trajectory.part) if frame.x is not None
        ]

    def close(self) -> None:
        self.rows.close()
        if self.trajectory:
            self.trajectory.close()


def _in_text(path: Path) -> bool:
    return bool(format_of(path))


def _topology_path(trajectory: Path, ensemble: Ensemble | None = None) -> Path:
    return trajectory.with_suffix(common_suffix([ensemble.structure]) if ensemble else ".pdb")


def _content(path: Path) -> str:
    """Hash of the size and of both ends of a file, as trajectories are large. Empty if there is no file."""
    if not path.is_file():
        return ""
    with path.open("rb") as file:
        size = file.seek(0, os.SEEK_END)
        ends = [str(size).encode()]
        for place in (0, max(0, size - _HASHED_BYTES)):
            file.seek(place)
            ends.append(file.read(_HASHED_BYTES))
    return hashlib.sha256(b"".join(ends)).hexdigest()[:12]


_HASHED_BYTES = 1 << 20  # Bytes of each end of a file of frames that are compared on resuming.


def _settings(ensemble: Ensemble, frames: Frames, task: Task, hydrogens: bool) -> dict[str, Any]:
    """Settings on which the files depend, as JSON reads them back."""
    record = {
        "task": task.name, "frames": frames.source, "content of frames": _content(Path(frames.source)),
        "selection": str(frames.chosen), "hydrogens": hydrogens, "structure": ensemble.structure.name,
        "atoms": ensemble.structure.fingerprint, "start": ensemble.structure.positions_fingerprint,
        **run_settings(getattr(task, "setup", None)), **task.settings(),
    }  # fmt: skip
    plain: dict[str, Any] = json.loads(json.dumps(record, default=str))
    return plain
