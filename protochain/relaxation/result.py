"""Result of a relaxation: structure, rounds, measures before and after, and a record for tables and JSON."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from protochain.chains.frame import Frame
from protochain.chains.restraint_list import RestraintValue
from protochain.core import defaults
from protochain.core.arrays import Floats
from protochain.core.markup import facts, plural
from protochain.core.settings import document_fields
from protochain.core.units import ANGSTROM_PER_NM
from protochain.energies.protocol import Energy
from protochain.minimisers.solution import RunEnds
from protochain.minimisers.verdict import Status
from protochain.relaxation.problems import Problems
from protochain.relaxation.record import COLUMNS, INTERFACE_COLUMNS, METHOD
from protochain.relaxation.relax_settings import RelaxSettings
from protochain.relaxation.restraints import PeptideBonds
from protochain.relaxation.rounds import Round
from protochain.results.columns import record
from protochain.results.provenance import remarks
from protochain.structure import Structure, save
from protochain.structure.molecule.repairs import Kind, Repair, summarise
from protochain.structure.select import sides, split_sides
from protochain.validation import MEASURES
from protochain.validation.interface import Interface, as_native, score_sides
from protochain.validation.ligands import LigandFound, describe_motion, findings_of, sdf_properties

TRACE_COLUMNS = ("iteration", "evaluations", "seconds", "energy_kj_mol", "rms_force_kj_mol_nm")


@document_fields
@dataclass(frozen=True, eq=False)
class Relaxation(RunEnds):
    """Result of a relaxation.

    Examples
    --------
    >>> r = pc.relax("structures/ala10.pdb")
    >>> str(r.status), r.energy_end < r.energy_start
    ('converged', True)
    """

    start: Structure  # The prepared input.
    x: Floats  # (na, 3) float, nm: Positions at the end, in the frame of the start.
    settings: RelaxSettings  # Settings of the relaxation.
    energy_function: Energy  # Force field and solvent, without the springs of the run.
    rounds: tuple[Round, ...]  # Minimisations in their order.
    best: int  # Index of the round whose end is the result: the round with the fewest residues with problems.
    status: Status  # Status by the judge, ``violations`` if the run converged and some remain.
    message: str  # Status, remaining problems, and the residual, as text.
    energy_start: float  # kJ/mol: Energy of the force field alone, without springs, by the judge.
    energy_end: float  # kJ/mol: The same at the end.
    rms_force: float  # kJ/mol/nm: At the end, springs included, by the judge.
    judge: str  # Energy that computed them.
    frame: Frame  # Frame of reference of the run.
    seconds: float  # Wall time of all rounds, without preparation and measures.
    # (n, 5) float: A row for each iteration, with columns ``TRACE_COLUMNS``. Energies are without springs.
    trace: Floats
    turned: tuple[Repair, ...] = ()  # Side chains with new rotamers before the first round.
    # kJ/mol: Energies of springs and restraints at start and end, not part of other energies. None without
    # any.
    restraints: tuple[float, float] | None = None
    # Values and violations of the user's restraints at the end.
    restraint_values: tuple[RestraintValue, ...] = ()
    # s: Wall time by part, as of :class:`protochain.Solution`.
    timings: Mapping[str, float | None] = field(default_factory=dict)
    move: str = defaults.MOVE  # Selection of the moving atoms.
    # (na,) bool, optional: Atoms that may move. All others stay in place, bit for bit.
    moving: NDArray[np.bool_] | None = None

    @cached_property
    def structure(self) -> Structure:
        """Structure at the end, with all hydrogens. Its repairs list the turned groups."""
        repairs = (*self.start.repairs, *self.turned, *self.stereocentres_corrected, *self.peptides_turned)
        return replace(self.start, positions=self.x, repairs=repairs)

    @cached_property
    def problems_start(self) -> Problems:
        """Problems at the start."""
        return Problems(self.start, self.start.positions)

    @cached_property
    def problems_end(self) -> Problems:
        """Problems at the end."""
        return Problems(self.start, self.x)

    @cached_property
    def stereocentres_corrected(self) -> tuple[Repair, ...]:
        """Stereocentres that were inverted at the start and are correct at the end."""
        s, index = (self.start, np.setdiff1d(self.problems_start.inversions, self.problems_end.inversions))
        residues = s.atom_residue[index]
        names = {residue: s.atom_name[index[residues == residue]] for residue in np.unique(residues).tolist()}
        return tuple(
            Repair(Kind.HAND_TURNED, {"residue": s.residue(residue), "atoms": (*atoms.tolist(),)})
            for residue, atoms in names.items()
        )

    @cached_property
    def peptides_turned(self) -> tuple[Repair, ...]:
        """Peptide bonds that were twisted at the start and are trans or cis at the end."""
        s, bonds = self.start, PeptideBonds.of(self.start)
        mended = np.setdiff1d(self.problems_start.peptides, self.problems_end.peptides)
        return tuple(
            Repair(Kind.TURNED_CIS if cis else Kind.TURNED_TRANS, {"residue": s.residue(residue)})
            for nitrogen, cis in zip(bonds.atoms[:, 2], bonds.cis, strict=True) if nitrogen in mended
            for residue in s.atom_residue[[nitrogen]].tolist()
        )  # fmt: skip

    @property
    def _structure_at_start(self) -> Structure:
        return self.start

    @cached_property
    def ligands_start(self) -> tuple[LigandFound, ...]:
        """Findings of each ligand at the start."""
        return findings_of(self.start, self.start.positions, posebusters=self.settings.posebusters)[0]

    @cached_property
    def ligands_end(self) -> tuple[LigandFound, ...]:
        """Findings of each ligand at the end."""
        if self.settings.score_only:
            return self.ligands_start
        return findings_of(self.start, self.x, posebusters=self.settings.posebusters)[0]

    @property
    def ligand_properties(self) -> list[dict[str, str]]:
        """Fields of the ligands' records of SDF, as :func:`protochain.save_ligands` writes them."""
        return sdf_properties(self.start, self.x, self.ligand_motion, self.energy_end, str(self.status))

    @cached_property
    def interface_start(self) -> Interface | None:
        """Scores of the settings' interface at the start, None without an interface."""
        return self._score_interface(self.start)

    @cached_property
    def interface_end(self) -> Interface | None:
        """Scores of the settings' interface at the end."""
        return self._score_interface(self.structure)

    def _score_interface(self, structure: Structure) -> Interface | None:
        if not self.settings.interface:
            return None
        pair = split_sides(structure, self.settings.interface)
        return score_sides(structure, as_native(self.energy_function), *pair, sides(structure, *pair))

    @property
    def ca_rmsd_angstrom(self) -> float:
        """C-alpha RMSD to the start, superposed."""
        return self.frame.ca_rmsds(self.x)[0]

    @property
    def farthest_angstrom(self) -> float:
        """Largest displacement of a heavy atom."""
        away = np.linalg.norm(self.x - self.start.positions, axis=1)
        return float(ANGSTROM_PER_NM * np.max(away[self.start.atom_element != "H"]))

    @property
    def n_atoms_moving(self) -> int:
        """Atoms that could move."""
        return int((~self.start.obstacle if self.moving is None else self.moving).sum())

    @property
    def is_usable(self) -> bool:
        """Whether the energy at the end, restraints included, is finite and not above the start's."""
        before, after = (self.restraints if self.restraint_values else None) or (0.0, 0.0)
        above = self.energy_end + after > self.energy_start + before
        return bool(np.isfinite(self.energy_end) and not above)

    def save(self, path: str | Path) -> None:
        """Write the structure with provenance, as PDB or mmCIF by suffix. ``keep_hydrogens`` applies.

        Raises
        ------
        StructureError
            If the suffix is unknown, or the format cannot represent the structure.
        """
        save(self.structure, path, self.provenance(), hydrogens=self.settings.keep_hydrogens)

    def provenance(self) -> Iterable[str]:
        """Provenance of the structure, as remarks for its file."""
        settings = self.settings
        kind = "PROTOCOL" if settings.protocol else "PRESET"
        lines = [f"{kind} {settings.strength.name.upper()}, {plural(len(self.rounds), 'ROUND')}"]
        if self.move != defaults.MOVE:
            fixed = f"MOVED {self.n_atoms_moving} OF {self.start.n_atoms} ATOMS, ALL OTHERS FIXED"
            lines.append(f"{fixed}: {self.move}")
        return remarks(
            self, METHOD.upper(), (self.energy_start, self.energy_end), self.judge,
            (self.ca_rmsd_angstrom, self.frame.ca_rmsds(self.x)[1]), lines,
        )  # fmt: skip

    def record(self, terms: bool = True) -> dict[str, Any]:
        """Flat record behind JSON and tables, with the keys of a solution, and None for missing numbers.

        Without ``terms`` it lacks the energies of single terms, which take longest.
        """
        return record((*COLUMNS, *(INTERFACE_COLUMNS if self.settings.interface else ())), self, terms)

    def ends(self) -> dict[str, Structure]:
        """Start and end, with keys ``input`` and ``relaxed``."""
        return {"input": self.start, "relaxed": self.structure}

    def __repr__(self) -> str:
        before, after = self.measures_start["violations"], self.measures_end["violations"]
        return (
            f"<Relaxation of {self.start.name}: {self.status}, residues with violations {before} -> {after}, "
            f"{self.energy_start:.2f} -> {self.energy_end:.2f} kJ/mol, "
            f"C-alpha RMSD {self.ca_rmsd_angstrom:.3f} angstrom{describe_motion(self.ligand_motion)}>"
        )

    def _repr_html_(self) -> str:
        start, end = self.measures_start, self.measures_end
        rows = {MEASURES[key].what: f"{_format(start[key])} to {_format(end[key])}" for key in MEASURES}
        moved = {"moved": f"{self.n_atoms_moving} of {self.start.n_atoms} atoms"}
        return facts(
            f"{self.start.name} relaxed",
            {
                "status": self.message,
                **(moved if self.move != defaults.MOVE else {}),
                "energy": f"{self.energy_start:.2f} to {self.energy_end:.2f} kJ/mol",
                "C-alpha RMSD to the start": (
                    f"{self.ca_rmsd_angstrom:.3f} angstrom{describe_motion(self.ligand_motion)}"
                ),
                **({"side chains": "; ".join(summarise(self.turned))} if self.turned else {}),
                **rows,
                "work": f"{plural(len(self.rounds), 'round')}, {self.seconds:.2f} s",
            },
        )


def _format(value: Any) -> str:
    return "-" if value is None else f"{value:.2f}" if isinstance(value, float) else str(value)
