"""Result of a search: its minima, and populations from replicas."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from protochain.chains.articulate import build_chain, transfer_coordinates
from protochain.chains.chain import log_det_mass, pose
from protochain.comparison.hessian import hessian
from protochain.core.arrays import Floats, Integers, Value
from protochain.core.checks import integer
from protochain.core.errors import refusal
from protochain.core.lazy_pandas import pd
from protochain.core.settings import document_fields
from protochain.core.units import MOLAR_GAS
from protochain.energies import Energy
from protochain.searching import conformers
from protochain.searching.landscape import Landscape
from protochain.searching.minima import SAME_ENERGY, SAME_TORSION, clusters, free_energy, unique
from protochain.searching.search_settings import SearchSettings
from protochain.searching.statistics import WARM_UP, blocks_of, drop_warm_up, mean_and_error, slope
from protochain.searching.walker_steps import Finding
from protochain.structure.superpose import rmsd_angstrom

if TYPE_CHECKING:
    from protochain.structure import Structure

N_LISTED = 200
"""Number of lowest minima in tables: clusters need the RMSD of all their pairs."""
N_FREE_ENERGIES = 10
"""Number of lowest minima with free energies: each requires a Hessian."""
N_NAMED = 12
"""Number of most frequent conformers in tables."""


@document_fields
@dataclass(frozen=True, eq=False)
class Search(Value):
    """Minima of a search, and samples of its replicas.

    Examples
    --------
    >>> found = pc.search("structures/ala10.pdb", method="hopping", evaluations=50)
    >>> found.structure(1).n_atoms
    103
    """

    landscape: Landscape  # Chain, with a fixed root, and energy.
    settings: SearchSettings  # Settings of the search.
    states: tuple[Any, ...]  # State of each walk.
    findings: tuple[Finding, ...]  # Findings of each walk.
    seconds: float  # Wall time of this run.
    interrupted: bool  # Whether the run was stopped before evaluations or time were spent.

    @property
    def chain(self) -> Any:
        """The chain of the search."""
        return self.landscape.chain

    @property
    def energy_function(self) -> Energy:
        """The energy of all terms."""
        return self.landscape.energy

    @property
    def n_evaluations(self) -> int:
        """Energy evaluations of all walks."""
        return sum(state.n_evaluations for state in self.states if state is not None)

    @cached_property
    def _descents(self) -> tuple[Integers, Floats]:
        """Walker of each descent, and a row for each descent as in :class:`Finding`."""
        walker = np.repeat(np.arange(len(self.findings)), [len(finding.minima) for finding in self.findings])
        return walker, np.concatenate([finding.minima for finding in self.findings])

    @cached_property
    def _unique(self) -> Integers:
        rows = self._descents[1]
        return unique(rows[:, 2:], rows[:, 1], self.landscape.symmetry)

    @property
    def q(self) -> Floats:
        """(m, n) float, rad: torsions of the different minima, the lowest first."""
        return np.asarray(self._descents[1][self._unique, 2:])

    @property
    def energies(self) -> Floats:
        """(m,) float, kJ/mol: energies of the different minima, the lowest first."""
        return np.asarray(self._descents[1][self._unique, 1])

    @property
    def energy(self) -> float:
        """Lowest energy, kJ/mol."""
        return float(self.energies[0])

    @property
    def n_walks_at_lowest(self) -> int:
        """Number of walks that reached the lowest minimum. If only one did, it may not be the lowest."""
        walker, rows = self._descents
        is_lowest = self.landscape.symmetry.farthest(rows[:, 2:], self.q[0]) <= SAME_TORSION
        return len(np.unique(walker[is_lowest & (rows[:, 1] <= self.energy + SAME_ENERGY)]))

    @property
    def agreement(self) -> str:
        """How many walks reached the lowest minimum, with remarks on one walk and on missing populations."""
        n, total = self.n_walks_at_lowest, len(self.findings)
        text = f"{n} of {total} walks reached it" if total > 1 else "one walk, not confirmed by another"
        text = text if n > 1 else f"{text}: continue it with more evaluations before you rely on it"
        if self.settings.method == "tempering" and not self._sampling:
            text += "; no populations, as too few rounds followed the pilot: continue it"
        return text

    def structure(self, number: int = 1) -> Structure:
        """Structure of a minimum, numbered from 1, superposed on the lowest."""
        from protochain.results.viewer import superpose

        number = integer(number, "number")
        if not 1 <= number <= len(self.q):
            raise refusal("number", number, f"give 1 to {len(self.q)}")
        lowest, minimum = (
            self.chain.structure.with_positions(pose(self.chain, self.q[k]).x) for k in (0, number - 1)
        )
        return superpose(minimum, lowest)

    @cached_property
    def frames(self) -> Floats:
        """(m, na, 3) float, nm: positions of the different minima, the lowest first, superposed on it."""
        return np.array([self.structure(number).positions for number in range(1, len(self.q) + 1)])

    @cached_property
    def minima(self) -> pd.DataFrame:
        """Table of the lowest minima, with their clusters and harmonic free energies.

        At the lowest temperature of the search, ``free_energy_kj_mol`` is for stiff bonds, as sampled with
        Fixman's potential, and ``free_energy_rigid_kj_mol`` for rigid bonds, which depends on masses. Both
        are relative to the lowest minimum, for only a few of the lowest minima.
        """
        walker, descents = self._descents
        rows = self._unique[:N_LISTED]
        q, energy = descents[rows, 2:], descents[rows, 1]
        alpha = self.chain.structure.alpha_carbons
        at = [pose(self.chain, torsions).x[alpha] for torsions in q]
        phi, psi = conformers.backbone(self.chain, q)
        free_energies = np.full((len(rows), 2), np.nan)
        for k, torsions in enumerate(q[:N_FREE_ENERGIES]):
            free_energies[k] = self._free(torsions, float(energy[k]))
        return pd.DataFrame(
            {
                "minimum": np.arange(1, len(rows) + 1),
                "energy_kj_mol": energy,
                "above_lowest_kj_mol": energy - energy[0],
                "ca_rmsd_to_lowest_angstrom": [rmsd_angstrom(x, at[0]) for x in at],
                "cluster": clusters(at),
                "conformer": conformers.names(phi, psi),
                "helix_share": conformers.helix(phi, psi),
                "free_energy_kj_mol": free_energies[:, 0] - free_energies[0, 0],
                "free_energy_rigid_kj_mol": free_energies[:, 1] - free_energies[0, 1],
                "walker": walker[rows],
                "evaluations_of_walker": descents[rows, 0].astype(np.int64),
            }
        )

    def _free(self, q: Floats, energy: float) -> tuple[float, float]:
        """Free energies with stiff and with rigid bonds, kJ/mol, NaN with restraints."""
        if self.landscape.restraints:
            return np.nan, np.nan
        chain, temperature = self.chain, self.settings.temperatures[0]
        free = build_chain(chain, root="free")
        matrix = hessian(chain, self.energy_function, q)
        mass = log_det_mass(free, pose(free, transfer_coordinates(chain, free, q)))
        return free_energy(energy, matrix, temperature), free_energy(energy, matrix, temperature, mass)

    @cached_property
    def _sampling(self) -> list[tuple[Any, Floats]]:
        """State and samples (k, r, n + 1) of each walk of replicas after the pilot."""
        walks = zip(self.states, self.findings, strict=True)
        return [(state, finding.samples) for state, finding in walks if len(finding.samples) > 1 / WARM_UP]

    @property
    def _samples(self) -> list[Floats]:
        return [samples for _, samples in self._sampling]

    @property
    def temperatures(self) -> Floats:
        """(r,) float, K: temperatures of the replicas from the pilot, empty without replicas."""
        return self._sampling[0][0].temperatures if self._sampling else np.empty(0)

    @cached_property
    def populations(self) -> pd.DataFrame:
        """Means by temperature from tempering, with standard errors from blocks of all walks.

        ``exchanges`` is the mean probability of exchanges with the next temperature. ``slope`` is the slope
        of the energy histograms of the two, relative to the canonical slope, with ``slope_error``.
        """
        rows = []
        states = [state for state, _ in self._sampling]
        odds, rounds = sum(state.odds for state in states), sum(state.n_counted for state in states)
        for k, temperature in enumerate(self.temperatures):
            energy = mean_and_error([walk[:, k, 0] for walk in self._samples])
            helix_share = mean_and_error(
                [conformers.helix(*conformers.backbone(self.chain, walk[:, k, 1:])) for walk in self._samples]
            )
            row = {
                "temperature_k": float(temperature),
                "energy_kj_mol": float(energy[0]),
                "energy_error_kj_mol": float(energy[1]),
                "helix_share": float(helix_share[0]),
                "helix_share_error": float(helix_share[1]),
                "exchanges": np.nan,
                "slope": np.nan,
                "slope_error": np.nan,
            }
            if k + 1 < len(self.temperatures):
                row["exchanges"] = float(odds[k] / rounds)
                row["slope"], row["slope_error"] = self._slope(k)
            rows.append(row)
        return pd.DataFrame(rows)

    @cached_property
    def conformers(self) -> pd.DataFrame:
        """Share of each conformer by temperature from tempering, with the standard error."""
        if not self._samples:
            return pd.DataFrame(columns=["temperature_k", "conformer", "share", "share_error"])
        names = [conformers.names(*conformers.backbone(self.chain, walk[:, :, 1:])) for walk in self._samples]
        unique_names, counts = np.unique(np.concatenate([walk.ravel() for walk in names]), return_counts=True)
        frequent = unique_names[np.argsort(-counts, kind="stable")][:N_NAMED]
        rows = []
        for k, temperature in enumerate(self.temperatures):
            for name in frequent:
                share = mean_and_error([(walk[:, k] == name).astype(float) for walk in names])
                rows.append((float(temperature), str(name), float(share[0]), float(share[1])))
        return pd.DataFrame(rows, columns=["temperature_k", "conformer", "share", "share_error"])

    def _slope(self, k: int) -> tuple[float, float]:
        """Slope of the histograms at two temperatures relative to the canonical slope, and its error."""
        pairs = [drop_warm_up(samples)[:, k : k + 2, 0] for samples in self._samples]
        beta = 1.0 / (MOLAR_GAS * self.temperatures[[k, k + 1]])
        canonical = float(beta[0] - beta[1])
        parts = [part for pair in pairs for part in blocks_of(pair)]
        # Jackknife over blocks.
        n = len(parts)
        resampled = [slope(*np.concatenate(parts[:i] + parts[i + 1 :]).T) for i in range(n)]
        error = np.sqrt((n - 1) * np.var(resampled)) if n > 1 else np.nan
        return slope(*np.concatenate(pairs).T) / canonical, float(error) / canonical

    def record(self) -> dict[str, Any]:
        """Flat record of ``summary.json``."""
        from protochain.results.provenance import of_run

        states = [state for state in self.states if state is not None]
        settings = {name: value for name, value in self.settings.record().items() if name != "temperatures"}
        return {
            "structure": self.chain.structure.name,
            "energy_lowest_kj_mol": self.energy,
            "n_minima": len(self._unique),
            "n_walks_at_lowest": self.n_walks_at_lowest,
            "agreement": self.agreement,
            "evaluations": self.n_evaluations,
            "steps": sum(state.n_done for state in states),
            "acceptance": sum(state.acceptance for state in states) / len(states),
            "round_trips": sum(state.n_trips for state, _ in self._sampling) if self._sampling else None,
            "seconds": self.seconds,
            "interrupted": self.interrupted,
            **settings,
            "temperature_lowest_k": self.settings.temperatures[0],
            "temperature_highest_k": self.settings.temperatures[1],
            "temperatures_k": self.temperatures.tolist(),
            "n_hinges": self.chain.n_hinges,
            "hinges": self.chain.opened,
            "forcefield": self.energy_function.forcefield,
            "solvent": self.energy_function.solvent,
            "engine": self.energy_function.engine,
            "device": self.energy_function.device,
            "engine_reason": self.energy_function.reason,
            **of_run("openmm", "numpy", "scipy", "numba"),
        }

    def save(self, folder: str | Path) -> None:
        """Write tables, the lowest minima as PDB files, ``summary.json`` and the page ``report.html``."""
        from protochain.searching.folder import draw_minima, write_search

        figure = draw_minima(self.minima, [finding.minima for finding in self.findings], self.energy)
        populations = self.populations if len(self.temperatures) else None
        write_search(
            Path(folder), self.record(), self.minima, self.structure, self.ends(), figure, populations,
            self.conformers,
        )  # fmt: skip

    def ends(self) -> dict[str, Structure]:
        """The lowest minima by name, for :func:`protochain.view`."""
        return {f"minimum {number}": self.structure(number) for number in range(1, min(len(self.q), 5) + 1)}

    def __repr__(self) -> str:
        return (
            f"<Search of {self.chain.structure.name} by {self.settings.method}: {self.energy:.2f} kJ/mol, "
            f"lowest of {len(self._unique)} minima by {self.n_evaluations} evaluations>"
        )
