"""Faults of a structure at some positions. They are measured on first use, counted and listed."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from protochain.core.arrays import Floats, Integers, Value
from protochain.core.markup import abridge, plural
from protochain.core.timings import part
from protochain.core.units import ANGSTROM_PER_NM
from protochain.structure.molecule.chirality import atom_names, wrong_centres
from protochain.structure.molecule.model import Structure
from protochain.structure.molecule.repairs import Kind
from protochain.validation.cbeta import cbeta_deviations
from protochain.validation.clashes import clashes
from protochain.validation.fixed import fixed_faults, fixed_residues
from protochain.validation.ligands import describe_double_bonds, inverted_double_bonds, ligand_findings
from protochain.validation.nucleic import nucleotides
from protochain.validation.omega import omegas
from protochain.validation.ramachandran import CLASSES, REGIONS, ramachandran
from protochain.validation.rings import threaded_rings
from protochain.validation.rotamers import side_chains
from protochain.validation.stereocentres import expected_stereocentres, inverted_stereocentres
from protochain.validation.strain import bond_lines, strain
from protochain.validation.violations import violations

if TYPE_CHECKING:
    import pandas as pd

_T = TypeVar("_T")


def _measure(measure: Callable[[Structure, Floats], _T]) -> cached_property[_T]:
    """Attribute of :class:`Findings`, measured at first use."""
    return cached_property(lambda findings: measure(findings.structure, findings.x))


@dataclass(frozen=True, eq=False)
class Findings(Value):
    """Faults of a structure at some positions."""

    structure: Structure
    x: Floats  # (na, 3) nm.

    violations = _measure(violations)
    clashes = _measure(clashes)
    ramachandran = _measure(ramachandran)
    side_chains = _measure(side_chains)
    cbeta = _measure(cbeta_deviations)
    peptides = _measure(omegas)
    inverted_stereocentres = _measure(lambda structure, x: wrong_centres(structure, x, structure.mirrored))
    rings = _measure(threaded_rings)
    fixed = _measure(fixed_faults)
    strain = _measure(strain)
    nucleotides = _measure(nucleotides)
    double_bonds = _measure(inverted_double_bonds)
    # Findings of each ligand, without PoseBusters' tests.
    ligands = cached_property(lambda self: ligand_findings(self.structure, self.x, self.clashes))

    def measures(self) -> dict[str, Any]:
        """Values of all ``MEASURES``, None if there is nothing to measure."""
        values = {key: measure.value(self) for key, measure in MEASURES.items()}
        return {key: value if np.isfinite(value) else None for key, value in values.items()}

    def remains(self) -> dict[str, list[str]]:
        """Places of all ``REMAINS``, the first in the file first."""
        return {key: remaining.places(self) for key, remaining in REMAINS.items()}

    def table(self) -> "pd.DataFrame":
        """Return a row for each residue of the protein, see :attr:`Validation.residues`."""
        import pandas as pd

        s = self.structure
        columns = {name: value(self) for name, value in RESIDUE_COLUMNS.items()}
        return pd.DataFrame(columns).loc[np.unique(s.atom_residue[~s.kept])]

    def per_residue(self, atoms: Integers | NDArray[np.bool_]) -> Integers:
        """(nr,) int: how many of some atoms each residue has."""
        return np.bincount(self.structure.atom_residue[atoms], minlength=self.structure.n_residues)

    def count(self, atoms: Integers) -> Integers:
        """(nr,) int: how many rows of atoms touch each residue."""
        residues = np.sort(self.structure.atom_residue[atoms], axis=1)
        first = np.diff(residues, axis=1, prepend=-1) > 0
        return np.bincount(residues[first], minlength=self.structure.n_residues)

    def spread(self, residue: Integers, values: Any) -> Any:
        """(nr,): values of some residues, empty text or NaN for the others."""
        is_float = values.dtype.kind == "f"
        of_all = np.full(self.structure.n_residues, np.nan if is_float else "", float if is_float else object)
        of_all[residue] = values
        return of_all

    def listing(self) -> Iterator[tuple[int, str]]:
        """Residues and their faults, in words, by kind of finding."""
        s, of = self.structure, self.structure.atom_residue
        faults = self.violations
        kinds = {"bond": faults.bonds, "angle": np.vstack([faults.angles_ca_c_n, faults.angles_c_n_ca]),
                 "clash": faults.clashes, "distance": faults.within}  # fmt: skip
        concerned = {name: set(of[atoms].ravel().tolist()) for name, atoms in kinds.items()}
        for r in faults.residues.tolist():
            if violated := [name for name in kinds if r in concerned[name]]:
                yield r, f"violation ({', '.join(violated)})"
        # Bonds outside the protein are listed with the other faults there.
        covalent = faults.covalent[~s.kept[faults.covalent].all(axis=1)]
        for pair, line in zip(covalent.tolist(), bond_lines(s, self.x, covalent), strict=True):
            yield int(of[pair[0]]), f"violation: {line}"
        # The deepest clash of each pair of residues.
        worst: dict[tuple[int, int], float] = {}
        for (i, j), overlap in zip(of[self.clashes.pairs], self.clashes.overlap_angstrom, strict=True):
            worst.setdefault((min(i, j), max(i, j)), overlap)
        for (i, j), overlap in worst.items():
            partner = "within it" if i == j else f"with {s.describe_residue(j)}"
            yield int(i), f"clash {partner} ({overlap:.1f} angstrom)"
        rama = self.ramachandran
        for k in np.flatnonzero(rama.region == 0).tolist():
            yield int(rama.residue[k]), f"Ramachandran outlier (phi {rama.phi[k]:.0f}, psi {rama.psi[k]:.0f})"
        for r in self.side_chains.outliers.tolist():
            yield r, "rotamer outlier"
        places = {s.residue(r): r for r in range(s.n_residues)}
        for repair in s.repairs:
            if repair.kind in (Kind.RING_TURNED, Kind.AMIDE_TURNED):
                yield places[repair.facts["residue"]], "side chain flipped in the file, turned by 180 degrees"
        for r, off in zip(*self.cbeta, strict=True):
            if r in self.cbeta.outliers:
                yield int(r), f"C-beta {off:.2f} angstrom from its place"
        for r, omega, proline, cis, twisted in zip(*self.peptides, strict=True):
            if twisted or (cis and not proline):
                yield int(r), f"{'cis' if cis else 'twisted'} peptide bond before it (omega {omega:.0f})"
        for atom in self.inverted_stereocentres.tolist():
            yield int(of[atom]), f"{s.atom_name[atom]} inverted"
        for pair in self.double_bonds:
            yield int(of[pair[0]]), f"{'='.join(s.atom_name[pair])} has the other E/Z than its chemistry"
        for term, atoms in (("bond", self.strain.bonds), ("angle", self.strain.angles)):
            first, counts = np.unique(of[atoms].min(axis=1), return_counts=True)
            for r, count in zip(first.tolist(), counts.tolist(), strict=True):
                yield r, f"{plural(count, term)} strained"
        sugars = self.nucleotides
        for k in np.flatnonzero(sugars.outlier).tolist():
            yield int(sugars.residue[k]), f"sugar {sugars.pucker[k]} with delta {sugars.delta[k]:.0f}"
        for ring in self.rings:
            yield ring.residue, str(ring)
        for fault, pairs in (("broken", self.fixed.bonds), ("a clash", self.fixed.clashes)):
            for i, j in pairs.tolist():
                distance = ANGSTROM_PER_NM * np.linalg.norm(self.x[i] - self.x[j])
                partner = "" if of[i] == of[j] else f" of {s.describe_residue(int(of[j]))}"
                ends = f"{s.atom_name[i]} to {s.atom_name[j]}{partner}"
                yield int(of[i]), f"{ends} {fault} ({distance:.2f} angstrom)"


RESIDUE_COLUMNS: Mapping[str, Callable[[Findings], Any]] = {
    "chain": lambda f: f.structure.residue_chain,
    "residue": lambda f: np.char.add(f.structure.residue_number, f.structure.residue_insertion_code),
    "name": lambda f: f.structure.residue_name,
    "violation": lambda f: f.violations.per_residue,
    "clashes": lambda f: f.count(f.clashes.pairs),
    "phi_degrees": lambda f: f.spread(f.ramachandran.residue, f.ramachandran.phi),
    "psi_degrees": lambda f: f.spread(f.ramachandran.residue, f.ramachandran.psi),
    "ramachandran_class": lambda f: f.spread(f.ramachandran.residue, np.array(CLASSES)[f.ramachandran.kind]),
    "ramachandran_percent": lambda f: f.spread(f.ramachandran.residue, 100.0 * f.ramachandran.score),
    "ramachandran": lambda f: f.spread(f.ramachandran.residue, np.array(REGIONS)[f.ramachandran.region]),
    "omega_degrees": lambda f: f.spread(f.peptides.residue, f.peptides.omega),
    "peptide_bond": lambda f: f.spread(
        f.peptides.residue, np.where(f.peptides.cis, "cis", np.where(f.peptides.twisted, "twisted", "trans"))
    ),
    "rotamer": lambda f: f.spread(f.side_chains.residue, f.side_chains.rotamer),
    "rotamer_outlier": lambda f: np.isin(np.arange(f.structure.n_residues), f.side_chains.outliers),
    "cbeta_deviation_angstrom": lambda f: f.spread(f.cbeta.residue, f.cbeta.deviation),
    "inverted_stereocentres": lambda f: f.per_residue(f.inverted_stereocentres),
    "bond_outliers": lambda f: f.count(f.strain.bonds),
    "angle_outliers": lambda f: f.count(f.strain.angles),
    "threaded_rings": lambda f: np.bincount(
        [ring.residue for ring in f.rings], minlength=f.structure.n_residues
    ),
    "atoms_added": lambda f: f.per_residue(f.structure.built),
}
"""Columns of :meth:`Findings.table`."""


class Measure(NamedTuple):
    """A number by which structures are compared."""

    what: str  # What it is, in words.
    heading: str  # In tables of a terminal; without one it is not in them.
    value: Callable[[Findings], Any]  # Its value of a :class:`Findings`.
    whole: bool = True  # Whether it is a whole number.


MEASURES = {
    "violations": Measure("residues with violations", "viol", lambda f: len(f.violations.residues)),
    "clashscore_per_1000_atoms": Measure(
        "clashes per 1000 atoms", "clash", lambda f: f.clashes.per_1000_atoms, False
    ),
    "ramachandran_outliers": Measure("Ramachandran outliers", "rama", lambda f: len(f.ramachandran.outliers)),
    "ramachandran_favoured_percent": Measure(
        "Ramachandran favoured, per cent", "fav%", lambda f: f.ramachandran.favoured_percent, False
    ),
    "rotamer_outliers": Measure(
        "side chains far from every rotamer", "rota", lambda f: len(f.side_chains.outliers)
    ),
    "cbeta_outliers": Measure("C-beta outliers", "C-b", lambda f: len(f.cbeta.outliers)),
    "cis_peptides": Measure(
        "cis peptide bonds but those before proline",
        "cis",
        lambda f: int(np.sum(f.peptides.cis & ~f.peptides.proline)),
    ),
    "cis_prolines": Measure(
        "cis peptide bonds before proline", "", lambda f: int(np.sum(f.peptides.cis & f.peptides.proline))
    ),
    "twisted_peptides": Measure("twisted peptide bonds", "twist", lambda f: int(f.peptides.twisted.sum())),
    "inverted_stereocentres": Measure(
        "inverted stereocentres", "inv", lambda f: len(f.inverted_stereocentres)
    ),
    "other_double_bonds": Measure(
        "double bonds of ligands with the other E/Z", "", lambda f: len(f.double_bonds)
    ),
    "bond_outliers": Measure(
        "bonds beyond 4 sigma of the force field's", "bond", lambda f: len(f.strain.bonds)
    ),
    "angle_outliers": Measure(
        "angles beyond 4 sigma of the force field's", "angle", lambda f: len(f.strain.angles)
    ),
    "pucker_outliers": Measure(
        "sugars of nucleotides with a rare pucker", "", lambda f: int(f.nucleotides.outlier.sum())
    ),
    "base_pairs": Measure(
        "base pairs", "", lambda f: np.nan if f.nucleotides.pairs is None else len(f.nucleotides.pairs)
    ),
    "threaded_rings": Measure("rings that a bond goes through", "ring", lambda f: len(f.rings)),
    "ligand_clashes": Measure(
        "clashes of ligands with the protein", "", lambda f: sum(ligand.clashes for ligand in f.ligands)
    ),
    "fixed_broken_bonds": Measure("broken bonds outside the protein", "", lambda f: len(f.fixed.bonds)),
    "fixed_clashes": Measure(
        "overlaps of what is fixed, by 1.5 angstrom", "", lambda f: len(f.fixed.clashes)
    ),
}
"""All that :func:`measures` returns, by key."""


class Remaining(NamedTuple):
    """Fault of a result that a biologist may reject."""

    what: str  # What it is, in words.
    places: Callable[[Findings], list[str]]  # Places in a :class:`Findings`.


def _residues(findings: Findings, residues: Any) -> list[str]:
    return [str(findings.structure.residue(int(r))) for r in np.unique(residues)]


def _at_interfaces(findings: Findings) -> list[str]:
    """Pairs of residues of two chains that clash, the worst first."""
    residues, s = findings.structure.atom_residue[findings.clashes.pairs], findings.structure
    between = s.residue_chain[residues[:, 0]] != s.residue_chain[residues[:, 1]]
    pairs = dict.fromkeys(map(tuple, np.sort(residues[between], axis=1).tolist()))
    return [f"{s.residue(i)} with {s.residue(j)}" for i, j in pairs]


REMAINS = {
    "inverted_stereocentres": Remaining(
        "inverted stereocentres", lambda f: atom_names(f.structure, inverted_stereocentres(f.structure, f.x))
    ),
    "d_amino_acids_unnamed": Remaining(
        "D-amino acids by their coordinates, under names of L",
        lambda f: _residues(f, expected_stereocentres(f.structure).unnamed),
    ),
    "inverted_double_bonds": Remaining(
        "double bonds of ligands with the other E/Z than their chemistry",
        lambda f: describe_double_bonds(f.structure, f.double_bonds),
    ),
    "clashes_between_chains": Remaining("clashes between chains", _at_interfaces),
    "ramachandran_outlier_residues": Remaining(
        "Ramachandran outliers", lambda f: _residues(f, f.ramachandran.outliers)
    ),
    "rotamer_outlier_residues": Remaining("rotamer outliers", lambda f: _residues(f, f.side_chains.outliers)),
    "cbeta_outlier_residues": Remaining("C-beta outliers", lambda f: _residues(f, f.cbeta.outliers)),
    "fixed_residues": Remaining("held fixed", lambda f: _residues(f, fixed_residues(f.structure))),
}
"""Faults that results list by place, by key of their records."""
_JUDGED = "inverted_stereocentres", "inverted_double_bonds"
"""Faults that messages name as well, except the message of a clash."""


@part("measuring")
def remains(structure: Structure, x: Floats) -> dict[str, list[str]]:
    """Name places of faults that a biologist may reject, at positions x (na, 3), by keys of ``REMAINS``."""
    return Findings(structure, x).remains() if np.isfinite(x).all() else {key: [] for key in REMAINS}


def describe_remains(record: Mapping[str, Any], shown: int = 6) -> list[str]:
    """Describe faults in a record beyond its message: a line for each of ``REMAINS`` with places."""
    in_message = () if record.get("status") == "clash" else _JUDGED
    places = {key: record.get(key) for key in REMAINS if key not in in_message}
    return [f"{REMAINS[key].what}: {abridge(at, shown)} ({len(at)})" for key, at in places.items() if at]
