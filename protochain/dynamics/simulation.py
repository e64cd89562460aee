"""The result of a simulation: a value that can be saved, tabled and written as JSON."""

from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from protochain.arrays import Floats
from protochain.chain import Chain, place_atoms
from protochain.dynamics.loop import Ending, Moment
from protochain.dynamics.settings import Settings
from protochain.energies.protocol import Energy
from protochain.structure import Structure, save

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, eq=False)
class Simulation:
    """Where a simulation ended, and what it was on the way.

    Parameters
    ----------
    chain : Chain
        As it was simulated: with a free root, and heavy hydrogens if they were asked for.
    energy_function : Energy
    settings : Settings
    freedoms : int
        Velocities that share the kinetic energy: less the six of everything as one where they are kept at
        zero, and less constraints.
    now : Moment
        The last sound moment.
    ending : Ending
    message : str
    rows : tuple of dict
        The log.
    n_steps : int
        Done by this call.
    seconds : float
        Wall time of these steps.
    """

    chain: Chain
    energy_function: Energy
    settings: Settings
    freedoms: int
    now: Moment
    ending: Ending
    message: str
    rows: tuple[dict[str, float], ...]
    n_steps: int
    seconds: float

    @property
    def q(self) -> Floats:
        """(n_q,) float: coordinates at the end."""
        return self.now.at.q

    @property
    def qd(self) -> Floats:
        """(n_v,) float, rad/ps and nm/ps: velocities at the end."""
        return self.now.at.qd

    @property
    def x(self) -> Floats:
        """(na, 3) float, nm: positions at the end."""
        return place_atoms(self.chain, self.now.at.factors.frames)

    @property
    def structure(self) -> Structure:
        """The structure at the end."""
        return self.chain.structure.with_positions(self.x)

    @property
    def is_sound(self) -> bool:
        """Whether the run kept its energy to the end."""
        return self.ending is not Ending.UNSTABLE

    @cached_property
    def trace(self) -> "pd.DataFrame":
        """The log: a row every so many steps, the first at the start."""
        import pandas as pd

        return pd.DataFrame(self.rows)

    @property
    def ns_per_day(self) -> float:
        """Simulated nanoseconds a day of wall time."""
        return 86.4 * self.n_steps * self.settings.time_step / self.seconds if self.seconds else 0.0

    @property
    def drift(self) -> float:
        """Slope of the conserved energy by least squares, kJ/mol/ps for 100 atoms."""
        t, conserved = (
            np.array([row[name] for row in self.rows]) for name in ("time_ps", "conserved_kj_mol")
        )
        return float(100.0 / self.chain.n_atoms * np.polyfit(t, conserved, 1)[0]) if len(t) > 2 else 0.0

    @property
    def accepted(self) -> float | None:
        """Share of hybrid Monte Carlo's trajectories that were kept."""
        if self.settings.thermostat != "hmc":
            return None
        _, kept, tried = self.now.bath.memory[:3]
        return float(kept / tried) if tried else 0.0

    def save(self, path: str | Path) -> None:
        """Write the final structure, PDB or mmCIF by suffix, with where it came from."""
        s, e = self.settings, self.energy_function
        save(self.structure, path, [
            f"PROTOCHAIN {version('protochain')}, CONSTRAINED DYNAMICS, {self.message.upper()}",
            f"FORCE FIELD {e.forcefield}, SOLVENT {e.solvent}, ENGINE {e.engine}",
            f"{s.integrator.upper()}, {1000 * s.time_step:g} FS, {s.thermostat.upper()}, {s.temperature:g} K",
        ])  # fmt: skip

    def record(self) -> dict[str, Any]:
        """Return the flat record that JSON shows."""
        chain, e, s = self.chain, self.energy_function, self.chain.structure
        warm = [row["temperature_k"] for row in self.rows[len(self.rows) // 2 :]]
        settings = self.settings.record()
        return {
            "protochain": version("protochain"),
            "structure": s.name,
            "engine": e.engine,
            "engine_reason": e.reason,
            "forcefield": e.forcefield,
            "solvent": e.solvent,
            "hinges": chain.opened,
            "move": chain.move,
            "n_chains": s.n_chains,
            "n_residues": s.n_residues,
            "n_atoms": s.n_atoms,
            "n_bodies": chain.n_bodies,
            "n_hinges": chain.n_hinges,
            "freedoms": self.freedoms,
            "temperature_k": settings.pop("temperature"),
            "time_step_fs": 1000 * settings.pop("time_step"),
            "friction_per_ps": settings.pop("friction"),
            "hydrogen_mass_amu": settings.pop("hydrogen_mass"),
            "every_steps": settings.pop("every"),
            **settings,
            "steps": self.now.step,
            "time_ps": self.now.step * self.settings.time_step,
            "mean_temperature_second_half_k": float(np.mean(warm)),
            "potential_end_kj_mol": self.rows[-1]["potential_kj_mol"],
            "conserved_drift_kj_mol_ps_per_100_atoms": self.drift,
            "accepted": self.accepted,
            "ca_rmsd_angstrom": self.rows[-1]["ca_rmsd_angstrom"],
            "seconds": self.seconds,
            "ns_per_day": self.ns_per_day,
            "status": str(self.ending),
            "message": self.message,
            "left_out": dict(s.left_out),
            "repairs": list(s.repairs),
            "threads": e.threads,
        }

    def __repr__(self) -> str:
        return f"<Simulation of {self.chain.structure.name}: {self.message}>"
