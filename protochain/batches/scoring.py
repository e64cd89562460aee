"""Scores of the interfaces of many complexes, in this process or several."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from protochain.batches.cluster import Processes, reason, run_jobs
from protochain.chains.setup import Setup
from protochain.core.errors import ProtochainError
from protochain.relaxation.relax_settings import RelaxSettings
from protochain.relaxation.relax_structure import relax_structure
from protochain.structure import Structure
from protochain.structure.formats.confidences import confidence_files, read_scores
from protochain.structure.select import sides, split_sides, touching_chains
from protochain.validation.interface import Interface, as_native, score_sides

Scored = tuple[str, Interface | str]
"""Name of a complex, and the scores of an interface, or the reason for their absence."""


@dataclass(frozen=True)
class ScoreJob:
    """Complex whose interfaces are scored."""

    name: str
    path: Path  # ``-`` is standard input.
    setup: Setup
    interfaces: tuple[str, ...] = ()  # Sides, as ``A,B:C``. By default, all chains in contact.
    relax: bool = False  # Before scoring.
    reference: Structure | None = None  # Complex from which its sides deviate.

    @property
    def label(self) -> str:
        """Name, and model of the file."""
        return self.name if self.setup.model is None else f"{self.name}, model {self.setup.model}"

    def run(self, threads: int | None) -> Iterator[Scored]:
        """Score each interface."""
        from protochain.comparison.docking import Pairing, docking

        setup = self.setup if threads is None else replace(self.setup, threads=threads)
        try:
            structure = setup.load(self.path)
            pairs = [split_sides(structure, pair_name) for pair_name in self.interfaces]
            pairs = pairs or touching_chains(structure)
            if not pairs:
                raise ProtochainError(f"{self.label}: no two of its chains are in contact; give a complex")
            energy, confidences = as_native(setup.energy(structure)), read_scores(confidence_files(self.path))
            if self.relax:
                structure = relax_structure(structure, energy, RelaxSettings()).structure
            pairing = Pairing.of(self.reference, structure) if self.reference else None
            for pair in pairs:
                interface = score_sides(structure, energy, *pair, sides(structure, *pair), confidences)
                deviations = docking(pairing, *pair) if pairing else {}
                yield self.label, replace(interface, scores={**interface.scores, **deviations})
        except Exception as error:
            message = reason(error, self.path)[1]
            has_name = message.startswith((self.label, str(self.path)))
            yield self.label, message if has_name else f"{self.label}: {message}"

    def lost(self, finished_rows: Sequence[Any], status: str, message: str, seconds: float) -> list[Scored]:
        """Reason for missing interfaces, if the process ended."""
        return [(self.label, f"{self.label}: {message}")]


def score_files(jobs: Sequence[ScoreJob], processes: Processes | None) -> list[Scored]:
    """Score the interfaces of complexes, in order. Without ``processes``, this process scores them."""
    results = {id(job): rows for job, rows in run_jobs(jobs, processes)}
    return [row for job in jobs for row in results[id(job)]]
