"""Pieces of a search: steps of one walker from one state to the next, in a process that may be killed.

A step is a pure function of the previous state, and its random numbers depend on its number alone. So lost
pieces are repeated bit for bit, and the division into pieces does not change the result.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from time import perf_counter
from typing import Any, Protocol

import numpy as np

from protochain.batches.cluster import load_shared
from protochain.core.arrays import Floats, Value, read_only
from protochain.core.checkpoints import checkpoint, write_checkpoint
from protochain.core.errors import Argument
from protochain.core.interrupts import held_interrupts
from protochain.core.processors import one_blas_thread
from protochain.searching.landscape import Landscape

SECONDS = 5.0
"""Length of a piece, and so the largest loss by a kill. Starting a piece costs a thousandth of it."""
_STREAMS = 1 << 16  # Streams of random numbers of a walker: one for each of its replicas and one for itself.


def stream(walker: int, replica: int = -1) -> int:
    """Stream of random numbers of a walker, or of one of its replicas."""
    return walker * _STREAMS + replica + 1


@dataclass(frozen=True, eq=False)
class Finding(Value):
    """Minima and samples of a walker's steps."""

    # (m, n + 2): For each descent: evaluations of the walker so far, energy in kJ/mol, torsions.
    minima: Floats
    # (k, r, n + 1): For each round of replicas: energy in kJ/mol and torsions at each temperature.
    samples: Floats

    @classmethod
    def empty(cls, n: int, r: int = 0) -> "Finding":
        """Empty finding of n torsions and r replicas."""
        return cls(np.empty((0, n + 2)), np.empty((0, r, n + 1)))

    @classmethod
    def minimum(cls, q: Floats, energy: float, n_evaluations: int, r: int = 0) -> "Finding":
        """Finding with one minimum."""
        return cls(np.array([[n_evaluations, energy, *q]]), np.empty((0, r, len(q) + 1)))

    @classmethod
    def concatenate(cls, parts: "Sequence[Finding]") -> "Finding":
        """Join findings in their order."""
        return cls(
            read_only(np.concatenate([part.minima for part in parts])),
            read_only(np.concatenate([part.samples for part in parts])),
        )


class Method(Protocol):
    """Method of search of one walker: pure functions of a landscape and a state."""

    @property
    def state(self) -> type:
        """Frozen dataclass: ``n_done``, ``n_evaluations``, ``energy``, ``acceptance``, arrays and numbers."""

    def begin(self, landscape: Landscape) -> tuple[Any, Finding]:
        """State at the start."""

    def step(self, landscape: Landscape, state: Any) -> tuple[Any, Finding]:
        """State one step later."""


def advance(
    landscape: Landscape, method: Method, state: Any | None, budget: float, seconds: float = SECONDS
) -> tuple[Any | None, Finding]:
    """Run steps until the time or the evaluations of the walker are spent, at least one for long steps."""
    # A step that is interrupted does not count: the state before it is returned.
    began, findings = perf_counter(), list[Finding]()
    with one_blas_thread(), held_interrupts() as interrupts:
        while state is None or (
            state.n_evaluations < budget and not (findings and perf_counter() - began >= seconds)
        ):
            after, finding = method.begin(landscape) if state is None else method.step(landscape, state)
            if interrupts:
                break
            state = after
            findings.append(finding)
    return state, Finding.concatenate(findings) if findings else Finding.empty(landscape.chain.n_hinges)


@dataclass(frozen=True, eq=False)
class PieceEnd(Value):
    """Result of a piece from its process. ``message`` is the reason if there is none."""

    walker: int
    state: Any | None
    finding: Finding | None
    message: str = ""


@dataclass(frozen=True, eq=False)
class Piece(Value):
    """A piece for a process."""

    task: Path  # Pickled landscape and methods of all walkers.
    walker: int
    state: Any | None  # Initial state of the piece, None at the start of the walk.
    budget: float  # Total evaluations of the walker.
    seconds: float = SECONDS  # Time after which no further step begins.

    def run(self, threads: int) -> Iterator[PieceEnd]:
        """Run the piece on one thread."""
        landscape, methods = load_shared(self.task)
        yield PieceEnd(
            self.walker, *advance(landscape, methods[self.walker], self.state, self.budget, self.seconds)
        )

    def lost(self, results: Sequence[PieceEnd], status: str, message: str, seconds: float) -> list[PieceEnd]:
        """Report why the piece has no result."""
        return [] if results else [PieceEnd(self.walker, self.state, None, message)]


def write_piece(path: Path, state: Any, finding: Finding, settings: Mapping[str, Any]) -> None:
    """Write the state after a piece, and its finding, atomically."""
    values = {name: getattr(state, name) for name in _names(state)}
    arrays = {f"state_{name}": value for name, value in values.items() if isinstance(value, np.ndarray)}
    numbers = {name: value for name, value in values.items() if not isinstance(value, np.ndarray)}
    write_checkpoint(path, arrays | {"minima": finding.minima, "samples": finding.samples}, numbers, settings)


def read_piece(path: Path, kind: type, settings: Mapping[str, Any]) -> tuple[Any, Finding]:
    """Read a piece, and check that the settings of its search are the same."""
    with checkpoint(path, settings, "search", "search again with ", Argument("force", True)) as stored:
        arrays = stored.arrays
        if any(a.dtype.kind not in "fiub" for a in arrays.values()) or arrays["minima"].ndim != 2:
            raise ValueError("arrays of no numbers")
        of_state = {name: arrays[f"state_{name}"] for name in _names(kind) if f"state_{name}" in arrays}
        state = kind(
            **{name: read_only(value, value.dtype.type) for name, value in of_state.items()},
            **{name: stored.number(name) for name in _names(kind) if name not in of_state},
        )
        return state, Finding(read_only(arrays["minima"]), read_only(arrays["samples"]))


def _names(kind: Any) -> list[str]:
    return [field.name for field in fields(kind)]
