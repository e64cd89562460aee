"""Every frame of a trajectory, minimised or measured, the way MDAnalysis analyses trajectories."""

from typing import Any

import pandas as pd
from MDAnalysis.analysis.base import AnalysisBase

from protochain.articulate import build_chain
from protochain.chain import pose
from protochain.energies.shared import shared_energy
from protochain.errors import ProtochainError
from protochain.minimisers import minimise
from protochain.minimisers.verdict import Judgement, judge
from protochain.structure import as_structure


class EveryFrame(AnalysisBase):
    """Minimise or measure every frame: ``pc.EveryFrame(universe, "lbfgs").run(step=10).results.table``.

    Parameters
    ----------
    atoms : MDAnalysis.Universe or AtomGroup
        Each frame is prepared as a file would be; frames whose atoms are the same share one energy.
    method : str, optional
        As in :func:`protochain.minimise`; None only measures.
    hinges : str
        As in :func:`protochain.build_chain`.
    forcefield, solvent : str
        As in :func:`protochain.energy`.
    tolerance, max_evaluations
        As in :func:`protochain.minimise`.
    **settings
        Of the preparation, as of :func:`protochain.load`.

    Attributes
    ----------
    results.table : pandas.DataFrame
        A row a frame: ``frame``, ``time_ps``, ``energy_start_kj_mol``, ``max_torque_start_kj_mol_rad``,
        ``rms_force_start_kj_mol_nm``; of a minimised one also ``energy_end_kj_mol``, ``ca_rmsd_angstrom``,
        ``evaluations``, ``seconds``, ``status`` and ``message``. Energies are the judge's. Of a frame that
        cannot be used there is the message alone, which says why.
    results.structures : list of Structure
        The end of each frame; None where a frame cannot be used.
    """

    def __init__(
        self,
        atoms: Any,
        method: str | None = "lbfgs",
        *,
        hinges: str = "phi psi chi",
        forcefield: str = "amber14",
        solvent: str = "obc2",
        tolerance: float = 1.0,
        max_evaluations: int = 5000,
        **settings: Any,
    ) -> None:
        self.atoms = atoms.atoms
        super().__init__(self.atoms.universe.trajectory)
        self.method, self.hinges = method, hinges
        self.energy_settings = {"forcefield": forcefield, "solvent": solvent}
        self.budget: dict[str, Any] = {"tolerance": tolerance, "max_evaluations": max_evaluations}
        self.settings = settings

    def _prepare(self) -> None:
        self._rows: list[dict[str, Any]] = []
        self.results.structures = []

    def _single_frame(self) -> None:
        row: dict[str, Any] = {"frame": self._ts.frame, "time_ps": self._ts.time}
        end = None
        try:
            start = as_structure(self.atoms, f"frame {self._ts.frame}", **self.settings)
            chain, energy = build_chain(start, self.hinges), shared_energy(start, **self.energy_settings)
            if self.method is None:
                row |= _measured(judge(chain, energy, pose(chain, chain.q0)))
                end = start
            else:
                solution = minimise(chain, energy, self.method, **self.budget)
                row |= _measured(solution.start) | {
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


def _measured(start: Judgement) -> dict[str, float]:
    return {
        "energy_start_kj_mol": start.energy,
        "max_torque_start_kj_mol_rad": start.max_torque,
        "rms_force_start_kj_mol_nm": start.rms_force,
    }
