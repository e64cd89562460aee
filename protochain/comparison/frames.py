"""Minimise or measure every frame of a trajectory, as an analysis of MDAnalysis."""

from typing import Any

import pandas as pd
from MDAnalysis.analysis.base import AnalysisBase

from protochain.chains.setup import Setup
from protochain.core import defaults
from protochain.core.errors import ProtochainError
from protochain.energies.requested import cached_energy
from protochain.minimisers import minimise, recipe_of
from protochain.minimisers.minimise_structure import Minimisation
from protochain.minimisers.start import Start
from protochain.minimisers.verdict import Judgement


class EveryFrame(AnalysisBase):
    """Minimise or measure every frame: ``pc.EveryFrame(universe, "lbfgs").run(step=10).results.table``.

    Parameters
    ----------
    atoms : MDAnalysis.Universe or AtomGroup
        Atoms of the protein. Each frame is prepared like a file. Frames with equal atoms share one energy.
    method : str, optional
        As in :func:`protochain.minimise`. None only measures.
    tolerance : float
        As in :func:`protochain.minimise`.
    max_evaluations : int
        As in :func:`protochain.minimise`.
    **settings
        Fields of :class:`protochain.Setup`: ``hinges``, ``forcefield``, ``solvent`` ...

    Attributes
    ----------
    results.table : pandas.DataFrame
        Row of each frame: ``frame``, ``time_ps``, ``energy_start_kj_mol``, ``max_torque_start_kj_mol_rad``,
        ``rms_force_start_kj_mol_nm``. Minimised frames also have ``energy_end_kj_mol``, ``ca_rmsd_angstrom``,
        ``evaluations``, ``seconds``, ``status`` and ``message``. Energies are by the judge of
        :func:`protochain.minimise`. A frame that cannot be used has only the ``message``, the reason.
    results.structures : list of Structure
        Final structure of each frame, or None if a frame cannot be used.

    Examples
    --------
    >>> atoms = pc.to_mdanalysis(pc.from_sequence("GAG"))
    >>> pc.EveryFrame(atoms, None).run().results.table["frame"].tolist()
    [0]
    """

    def __init__(
        self,
        atoms: Any,
        method: str | None = defaults.FRAME_METHOD,
        *,
        tolerance: float = defaults.TOLERANCE,
        max_evaluations: int = defaults.MAX_EVALUATIONS,
        **settings: Any,
    ) -> None:
        if not hasattr(getattr(atoms, "atoms", None), "universe"):
            raise ProtochainError(
                f"atoms of type {type(atoms).__name__}: give an MDAnalysis Universe or AtomGroup"
            )
        if method is not None:
            Minimisation(recipe_of(method), tolerance=tolerance, max_evaluations=max_evaluations)
        self.atoms = atoms.atoms
        super().__init__(self.atoms.universe.trajectory)
        self.method, self.setup = method, Setup(**settings)
        self.budget: dict[str, Any] = {"tolerance": tolerance, "max_evaluations": max_evaluations}

    def _prepare(self) -> None:
        self._rows: list[dict[str, Any]] = []
        self.results.structures = []

    def _single_frame(self) -> None:
        row: dict[str, Any] = {"frame": self._ts.frame, "time_ps": self._ts.time}
        end = None
        try:
            name = f"frame {self._ts.frame}"
            start, chain, energy = self.setup.prepare(self.atoms, name, cached_energy)
            if self.method is None:
                row |= _measures(Start(chain, energy).judgement)
                end = start
            else:
                solution = minimise(chain, energy, self.method, **self.budget)
                row |= _measures(solution.start) | {
                    "energy_end_kj_mol": solution.end.energy,
                    "ca_rmsd_angstrom": solution.ca_rmsd_angstrom,
                    "evaluations": solution.n_evaluations,
                    "seconds": solution.seconds,
                    "status": str(solution.status),
                    "message": solution.message,
                }
                end = solution.structure
        except ProtochainError as error:
            row["message"] = str(error)
        self._rows.append(row)
        self.results.structures.append(end)

    def _conclude(self) -> None:
        self.results.table = pd.DataFrame(self._rows)


def _measures(start: Judgement) -> dict[str, float]:
    return {
        "energy_start_kj_mol": start.energy,
        "max_torque_start_kj_mol_rad": start.max_torque,
        "rms_force_start_kj_mol_nm": start.rms_force,
    }
