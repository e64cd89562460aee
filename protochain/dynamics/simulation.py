"""Result of a simulation."""

from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from protochain.chains.chain import Chain, place_atoms
from protochain.chains.contacts import overlaps
from protochain.chains.frame import Frame
from protochain.chains.restraint_list import RestraintValue, ViolationsAtEnd, measure_restraints
from protochain.core.arrays import Floats
from protochain.core.lazy_pandas import pd
from protochain.core.markup import plural
from protochain.core.settings import document_fields
from protochain.dynamics.loop import Ending, State
from protochain.dynamics.simulate_settings import SimulationSettings
from protochain.dynamics.thermostats import THERMOSTATS
from protochain.energies.protocol import Energy
from protochain.results.columns import Column, of_energy, of_losses, of_restraints
from protochain.structure import Structure, save, to_mdanalysis, to_mdtraj
from protochain.structure.formats.frames import open_frames

if TYPE_CHECKING:
    import MDAnalysis
    import mdtraj


@document_fields
@dataclass(frozen=True, eq=False)
class Simulation(ViolationsAtEnd):
    """Result of a simulation: final state, log and outcome.

    Examples
    --------
    >>> pc.simulate("structures/ala10.pdb", n_steps=20, every=10).frames.shape
    (3, 103, 3)
    """

    chain: Chain  # Chain as simulated: with a free root, and with repartitioned hydrogen masses if requested.
    energy_function: Energy  # Force field.
    settings: SimulationSettings  # Settings of the simulation.
    # Number of degrees of freedom, without constraints. The six of rigid motion are subtracted if the
    # thermostat conserves momentum and the molecule is not fixed from outside.
    freedoms: int
    state: State  # Last valid state.
    ending: Ending  # Outcome.
    message: str  # Outcome in one line.
    rows: tuple[dict[str, float], ...]  # Rows of the log.
    # Row of the last state, which is not in the log if its step is not a multiple of ``every``.
    last: dict[str, float]
    n_steps: int  # Number of steps done by this call.
    seconds: float  # Wall time of these steps.
    # Whether frames are superposed on the start, and if not, the reason that fixed the chain in space.
    frame: Frame
    # Positions (na, 3), nm, at the rows of the log, for a run without a folder.
    stored_frames: tuple[NDArray[np.float32], ...] = ()
    trajectory: Path | None = None  # File of the frames.

    @cached_property
    def frames(self) -> Any:
        """(n, na, 3) float32, nm: positions at the rows of the log, from the trajectory file if it exists."""
        if self.trajectory is None:
            return np.array(self.stored_frames, dtype=np.float32)
        return np.array([frame.x for frame in open_frames(self.trajectory)], dtype=np.float32)

    def to_mdtraj(self) -> "mdtraj.Trajectory":
        """Convert the frames to an mdtraj trajectory, in nm."""
        return to_mdtraj(self.chain.structure, self.frames)

    def to_mdanalysis(self) -> "MDAnalysis.Universe":
        """Convert the frames to an MDAnalysis Universe in memory, in angstrom."""
        return to_mdanalysis(self.chain.structure, self.frames)

    @property
    def q(self) -> Floats:
        """(n_q,) float: final coordinates."""
        return self.state.at.q

    @property
    def qd(self) -> Floats:
        """(n_v,) float, rad/ps and nm/ps: final velocities."""
        return self.state.at.qd

    @property
    def x(self) -> Floats:
        """(na, 3) float, nm: final positions in the frame of the start. ``q`` is in the frame of the run."""
        return self.frame(place_atoms(self.chain, self.state.at.factors.frames))

    @cached_property
    def restraint_values(self) -> tuple[RestraintValue, ...]:  # type: ignore[override]
        """Values and violations of the restraints at the end."""
        x = place_atoms(self.chain, self.state.at.factors.frames)
        return measure_restraints(self.chain.structure, self.settings.restraints, x)

    @property
    def structure(self) -> Structure:
        """Final structure."""
        return self.chain.structure.with_positions(self.x)

    @property
    def is_sound(self) -> bool:
        """Whether the run remained stable to the end."""
        return self.ending is not Ending.UNSTABLE

    @cached_property
    def trace(self) -> "pd.DataFrame":
        """Log of the simulation. The first row is the start."""
        return pd.DataFrame(self.rows)

    @property
    def ns_per_day(self) -> float:
        """Simulated nanoseconds per day of wall time."""
        return 86.4 * self.n_steps * self.settings.time_step / self.seconds if self.seconds else 0.0

    @property
    def drift(self) -> float:
        """Drift of the conserved energy: least-squares slope, kJ/mol/ps per 100 atoms, NaN for two rows."""
        t, conserved = (
            np.array([row[name] for row in self.rows]) for name in ("time_ps", "conserved_kj_mol")
        )
        return float(100.0 / self.chain.n_atoms * np.polyfit(t, conserved, 1)[0]) if len(t) > 2 else np.nan

    @property
    def accepted(self) -> float | None:
        """Fraction of accepted trajectories of hybrid Monte Carlo."""
        if not THERMOSTATS[self.settings.thermostat].metropolis:
            return None
        _, accepted, tried = self.state.bath.memory[:3]
        return float(accepted / tried) if tried else 0.0

    def save(self, path: str | Path) -> None:
        """Write the final structure with its provenance, as PDB or mmCIF by suffix."""
        s, e = self.settings, self.energy_function
        remarks = [
            f"SPRINGS ON {spring.kind.upper()}: {spring.stiffness:g} KJ/MOL/RAD^2, "
            f"{spring.damping:g} KJ/MOL PS/RAD^2"
            for spring in s.hinge_springs
        ]
        if s.pull is not None:
            remarks.append(f"PULLED {s.pull} BY {s.pull.stiffness:g} KJ/MOL/NM^2 AT {s.pull.speed:g} NM/PS")
        save(self.structure, path, [
            f"PROTOCHAIN {version('protochain')}, CONSTRAINED DYNAMICS, {self.message.upper()}",
            f"FORCE FIELD {e.forcefield}, SOLVENT {e.solvent}, ENGINE {e.engine}",
            f"{s.integrator.upper()}, {1000 * s.time_step:g} FS, {s.thermostat.upper()}, {s.temperature:g} K",
            *remarks,
        ])  # fmt: skip

    def record(self) -> dict[str, Any]:
        """Return the simulation as flat values for JSON."""
        settings = {RECORD_NAMES.get(name, name): value for name, value in self.settings.record().items()}
        settings["time_step_fs"] *= 1000
        return {column.key: column.value(self) for column in RECORD} | settings | self._pull_record()

    def _pull_record(self) -> dict[str, float]:
        """Record of a pull, empty without one."""
        if self.settings.pull is None:
            return {}
        first, last = self.rows[0], self.last
        return {
            "pull_distance_start_nm": first["pull_distance_nm"],
            "pull_distance_end_nm": last["pull_distance_nm"],
            "pull_work_end_kj_mol": last["pull_work_kj_mol"],
            "pull_force_largest_kj_mol_nm": max((row["pull_force_kj_mol_nm"] for row in self.rows), key=abs),
        }

    def __repr__(self) -> str:
        return f"<Simulation of {self.chain.structure.name}: {self.message}>"


def describe_outcome(
    ending: Ending, reason: str, step: int, settings: SimulationSettings, structure: Structure, start: Floats
) -> str:
    """Outcome of a simulation in one line, with a remedy if it has become unstable."""
    progress = f"{plural(step, 'step')}, {step * settings.time_step:g} ps"
    if ending is not Ending.UNSTABLE:
        return f"{ending}: {progress}"
    crowd = len(overlaps(structure, start))
    if crowd:
        pairs = "pair of atoms overlaps" if crowd == 1 else "pairs of atoms overlap"
        return f"unstable after {progress}: {reason}; {crowd} {pairs} at the start: minimise first"
    return (
        f"unstable after {progress}: {reason}; use a time step below {settings.time_step:g} ps "
        f"({1000 * settings.time_step:g} fs) or heavier hydrogens, or minimise first"
        + ("; or pull more slowly, by a softer spring" if settings.pull else "")
    )


RECORD_NAMES = {
    "temperature": "temperature_k", "time_step": "time_step_fs", "friction": "friction_per_ps",
    "hydrogen_mass": "hydrogen_mass_amu", "every": "every_steps",
}  # fmt: skip
"""Settings whose names in a record have units. The unit of the time step differs there."""

RECORD = (
    Column("protochain", lambda r: version("protochain")),
    Column("structure", lambda r: r.chain.structure.name),
    *(column for column in of_energy() if column.key != "protochain"),
    Column("hinges", lambda r: r.chain.opened),
    Column("move", lambda r: r.chain.move),
    Column("n_chains", lambda r: r.chain.structure.n_chains),
    Column("n_residues", lambda r: r.chain.structure.n_residues),
    Column("n_atoms", lambda r: r.chain.structure.n_atoms),
    Column("n_bodies", lambda r: r.chain.n_bodies),
    Column("n_hinges", lambda r: r.chain.n_hinges),
    Column("freedoms", lambda r: r.freedoms, kind=int),
    Column("steps", lambda r: r.state.step, kind=int),
    Column("time_ps", lambda r: r.state.step * r.settings.time_step),
    Column("mean_temperature_second_half_k", lambda r: float(
        np.mean([row["temperature_k"] for row in (r.rows[len(r.rows) // 2 :] if r.rows[1:] else [r.last])])
    )),
    Column("potential_end_kj_mol", lambda r: r.last["potential_kj_mol"]),
    Column(
        "conserved_drift_kj_mol_ps_per_100_atoms",
        lambda r: r.drift if len(r.rows) > 2 else None, kind=float | None,
    ),
    Column("accepted", lambda r: r.accepted, kind=float | None),
    Column("ca_rmsd_angstrom", lambda r: r.last["ca_rmsd_angstrom"]),
    Column("ca_rmsd_input_angstrom", lambda r: Frame(r.chain.structure).ca_rmsds(r.x)[0]),
    Column("ca_rmsd_input_as_filed_angstrom", lambda r: Frame(r.chain.structure).ca_rmsds(r.x)[1]),
    Column("frame", lambda r: str(r.frame)),
    Column("seconds", lambda r: r.seconds),
    Column("ns_per_day", lambda r: r.ns_per_day if r.n_steps else None, kind=float | None),
    Column("status", lambda r: str(r.ending), kind=Ending),
    Column("message", lambda r: r.message),
    *of_restraints(RestraintValue),
    Column("left_out", lambda r: dict(r.chain.structure.left_out), kind=dict[str, int]),
    *of_losses(lambda r: r.chain.structure),
    Column("threads", lambda r: r.energy_function.threads, kind=int | None),
)  # fmt: skip
"""Columns of a record in addition to the settings."""
PULL_COLUMNS = (
    "pull_stiffness_kj_mol_nm2", "pull_speed_nm_ps", "pull_distance_start_nm", "pull_distance_end_nm",
    "pull_work_end_kj_mol", "pull_force_largest_kj_mol_nm",
)  # fmt: skip
"""Additional columns of a run with a pull."""
