"""What a simulation leaves behind: trajectory, log, checkpoints, and at the end a structure and a summary."""

import csv
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from protochain.arrays import Floats, frozen
from protochain.dynamics.loop import Moment
from protochain.dynamics.system import Phase
from protochain.dynamics.thermostats import Bath
from protochain.errors import ProtochainError, StructureError
from protochain.multibody import Frames, Tree
from protochain.multibody.articulated import Articulated
from protochain.storage import check_writable, read_arrays, write_arrays, write_atomically
from protochain.structure import Structure
from protochain.structure.trajectory import TrajectoryFile, check_trajectory
from protochain.structure.write import check_fits

CHECKPOINT = "checkpoint.npz"


def check_folder(path: Path, suffix: str, resume: bool, force: bool) -> None:
    """Refuse a folder that cannot be used, before any work is done.

    Parameters
    ----------
    path : Path
    suffix : str
        ``dcd`` or ``xtc``.
    resume : bool
        Go on with the simulation that is there.
    force : bool
        Replace one that is there.

    Raises
    ------
    ProtochainError
        If the folder holds a simulation and neither is asked for, holds none to go on with, or cannot be
        written to.
    """
    check_trajectory(path / f"trajectory.{suffix}")
    check_writable(path / CHECKPOINT)
    there = [name for name in (CHECKPOINT, "log.csv", "log.part.csv") if (path / name).exists()]
    if there and not (resume or force):
        raise ProtochainError(
            f"{path}: holds a simulation ({there[0]}); --resume goes on with it, --force replaces it"
        )
    if resume and not (path / CHECKPOINT).exists():
        raise ProtochainError(f"{path}: holds no {CHECKPOINT} to go on from; leave out --resume")


class Folder:
    """The files of one simulation, which grow as it runs.

    ``trajectory.dcd`` (or ``.xtc``) and ``log.csv`` are called ``trajectory.part.dcd`` and ``log.part.csv``
    until the run has ended and is sound.

    Parameters
    ----------
    path : Path
    suffix : str
        ``dcd`` or ``xtc``.
    settings : mapping of plain values
        What a checkpoint belongs to.
    """

    def __init__(self, path: Path, suffix: str, settings: Mapping[str, Any]) -> None:
        self.path, self.settings = path, settings
        self.trajectory = path / f"trajectory.{suffix}"
        self.log, self.log_part = path / "log.csv", path / "log.part.csv"

    def open(self, structure: Structure, start: Floats, frame_interval: float, columns: list[str]) -> None:
        """Begin new files, of a simulation that starts at positions (na, 3)."""
        self.start = start
        self.path.mkdir(parents=True, exist_ok=True)
        for stale in (CHECKPOINT, "last.pdb", "last.cif", "summary.json", "log.csv", self.trajectory.name):
            (self.path / stale).unlink(missing_ok=True)
        self._frames = TrajectoryFile(self.trajectory, structure, frame_interval)
        self._file = self.log_part.open("w", newline="", encoding="utf-8")
        self._writer = csv.DictWriter(self._file, columns)
        self._writer.writeheader()

    def reopen(
        self, tree: Tree, structure: Structure, frame_interval: float
    ) -> tuple[Moment, list[dict[str, float]], Floats]:
        """Go on with the files as they were at the last checkpoint.

        Returns
        -------
        Moment, list of dict, (na, 3) float
            Where to go on from, the rows logged before, and the positions of the energy's neighbour lists.
        """
        arrays, values = read_arrays(self.path / CHECKPOINT, self.settings)
        self.start = arrays["start"]
        if not self.log_part.exists() and self.log.exists():
            self.log.replace(self.log_part)
        if not self.log_part.exists() or self.log_part.stat().st_size < values["log_bytes"]:
            raise ProtochainError(f"{self.log_part}: has lost rows that its checkpoint counts; begin anew")
        self._frames = TrajectoryFile(
            self.trajectory, structure, frame_interval, (values["frames"], values["trajectory_bytes"])
        )
        self._file = self.log_part.open("r+", newline="", encoding="utf-8")
        self._file.truncate(values["log_bytes"])
        reader = csv.DictReader(self._file)
        rows = [{name: float(value) for name, value in row.items()} for row in reader]
        self._file.seek(0, os.SEEK_END)
        self._writer = csv.DictWriter(self._file, list(reader.fieldnames or ()))
        return _moment(tree, arrays, values), rows, arrays["lists_at"]

    def append(self, row: Mapping[str, float], x: Floats) -> None:
        """Write a frame and its row."""
        self._frames.append(x)
        self._writer.writerow(row)

    def store(self, now: Moment, lists_at: Floats | None) -> None:
        """Put a checkpoint beside files that are on the disk as far as it counts them."""
        frames, trajectory_bytes = self._frames.stored()
        self._file.flush()
        os.fsync(self._file.fileno())
        values = {
            "step": now.step,
            "potential": now.at.potential,
            "bath_energy": now.bath.energy,
            "frames": frames,
            "trajectory_bytes": trajectory_bytes,
            "log_bytes": self.log_part.stat().st_size,
        }
        at, factors = now.at, now.at.factors
        arrays = {
            "q": at.q, "qd": at.qd, "p": at.p, "torque": at.torque, "memory": now.bath.memory,
            "rotation": factors.frames.rotation, "origin": factors.frames.origin, "inertia": factors.inertia,
            "gain": factors.gain, "pivot": factors.pivot, "root": factors.root,
            "start": self.start, "lists_at": np.empty((0, 3)) if lists_at is None else lists_at,
        }  # fmt: skip
        write_arrays(self.path / CHECKPOINT, arrays, values, self.settings)

    def close(self, sound: bool) -> None:
        """Close the files, and give them their names if the run is sound."""
        self._file.close()
        if sound:
            self.log_part.replace(self.log)
            self._frames.finish()
        else:
            self._frames.close()

    def last(self, structure: Structure) -> Path:
        """Return the name for the last structure: PDB where that can hold it."""
        for name in ("last.pdb", "last.cif"):
            try:
                check_fits(structure, self.path / name)
            except StructureError:
                continue
            return self.path / name
        raise AssertionError("mmCIF holds all structures")

    def summarise(self, record: Mapping[str, Any]) -> None:
        """Write ``summary.json``."""
        text = json.dumps(record, indent=2, allow_nan=False)
        write_atomically(self.path / "summary.json", lambda to: to.write_text(text, encoding="utf-8"))


def _moment(tree: Tree, arrays: Mapping[str, np.ndarray], values: Mapping[str, Any]) -> Moment:
    a = {name: frozen(array) for name, array in arrays.items()}
    frames = Frames(a["rotation"], a["origin"])
    factors = Articulated(tree, frames, a["inertia"], a["gain"], a["pivot"], a["root"])
    at = Phase(a["q"], a["qd"], a["p"], values["potential"], a["torque"], factors)
    return Moment(values["step"], at, Bath(values["bath_energy"], a["memory"]))
