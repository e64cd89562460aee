"""Validation of a structure: numbers, a row for each residue, and faults in words."""

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from protochain.core.arrays import Floats, Value
from protochain.core.checks import flag
from protochain.core.markup import facts, plural
from protochain.core.settings import document_fields
from protochain.core.timings import part
from protochain.structure.convert import as_structure
from protochain.structure.matching import structure_to_measure
from protochain.structure.molecule.model import Structure
from protochain.structure.molecule.repairs import Kind
from protochain.validation.findings import MEASURES, Findings
from protochain.validation.layout import positions
from protochain.validation.ligands import LIGAND_COLUMNS, LigandFound, with_posebusters
from protochain.validation.likeness import LIKENESS, likeness
from protochain.validation.nucleic import nucleotide_table, nucleotides
from protochain.validation.violations import Violations

if TYPE_CHECKING:
    import pandas as pd


@document_fields
@dataclass(frozen=True, eq=False)
class Validation(Value):
    """Faults of a structure, and its likeness to a reference.

    Examples
    --------
    >>> pc.validate("structures/1l2y.pdb").measures["ramachandran_outliers"]
    0
    """

    structure: Structure  # As prepared. Its heavy atoms are at their places in the file.
    # The keys of ``MEASURES``, and with a reference of ``LIKENESS``. None if a quantity cannot be measured.
    measures: Mapping[str, Any]
    # A row for each residue of the protein: ``chain``, ``residue`` (number and insertion code), ``name``,
    # ``violation``, ``clashes``, ``phi_degrees``, ``psi_degrees``, ``ramachandran_class``,
    # ``ramachandran_percent`` (of the class are rarer), ``ramachandran`` (favoured, allowed, outlier),
    # ``omega_degrees`` and ``peptide_bond`` (of the bond before it), ``rotamer`` (the nearest),
    # ``rotamer_outlier``, ``cbeta_deviation_angstrom``, ``inverted_stereocentres``, ``bond_outliers``,
    # ``angle_outliers``, ``threaded_rings``, ``atoms_added`` (heavy atoms that the file lacks), with a
    # reference ``lddt``.
    residues: "pd.DataFrame"
    violations: Violations  # As AlphaFold counts them, and covalent bonds of a wrong length.
    findings: tuple[tuple[int, str], ...]  # Index of a residue, and its fault.
    # Chains of the reference and their matches, as ``A:B,B:A``. None without a reference.
    chain_mapping: str | None = None
    ligands: tuple[LigandFound, ...] = ()  # Findings of each ligand of known chemistry.
    posebusters_missing: str = ""  # Reason why requested PoseBusters' tests were not run, empty if they were.

    def __post_init__(self) -> None:
        object.__setattr__(self, "measures", MappingProxyType(dict(self.measures)))

    def listing(self) -> list[str]:
        """List the residues with which something is wrong, in words, in the order of the file."""
        faults: dict[int, list[str]] = defaultdict(list)
        for residue, fault in self.findings:
            faults[residue].append(fault)
        return [f"{self.structure.describe_residue(r)}: {', '.join(faults[r])}" for r in sorted(faults)]

    @property
    def ligand_table(self) -> "pd.DataFrame":
        """A row for each ligand.

        ``chain``, ``residue``, ``name``, ``source``, ``strain_kj_mol``, ``contacts``, ``clashes``,
        ``inverted``, ``posebusters_passed`` and ``posebusters_failed``, names of tests.
        """
        import pandas as pd

        return pd.DataFrame([ligand.record() for ligand in self.ligands], columns=LIGAND_COLUMNS)

    @property
    def nucleotide_table(self) -> "pd.DataFrame":
        """A row for each nucleotide with a whole sugar.

        ``chain``, ``residue``, ``name``, ``pucker``, ``phase_degrees`` and ``amplitude_degrees`` of its
        pseudorotation, ``delta_degrees``, ``pucker_outlier`` and ``paired_with``, the residues of its pairs.
        """
        return nucleotide_table(self.structure, nucleotides(self.structure, self.structure.positions))

    @property
    def added(self) -> str:
        """Additions of preparation to the file, in words, empty without any."""
        heavy = self.residues["atoms_added"]
        additions = [str(repair) for repair in self.structure.repairs if repair.kind is Kind.HYDROGENS_ADDED]
        if heavy.any():
            atoms = plural(int(heavy.sum()), "heavy atom")
            residues = plural(int((heavy > 0).sum()), "residue")
            additions.insert(0, f"{atoms} added that the file lacks, in {residues}")
        return "; ".join(additions)

    def record(self) -> dict[str, Any]:
        """Flat row: name, model and size, additions, and the measures."""
        s = self.structure
        return {
            "structure": s.name, "model": s.model_number, "n_chains": s.n_chains,
            "n_residues": len(self.residues), "n_atoms": s.n_atoms,
            "heavy_atoms_added": int(self.residues["atoms_added"].sum()), **self.measures,
            **({} if self.chain_mapping is None else {"chain_mapping": self.chain_mapping}),
        }  # fmt: skip

    def __repr__(self) -> str:
        faults = [
            f"{self.measures[key]} {measure.what}"
            for key, measure in MEASURES.items()
            if measure.whole and key not in ("cis_prolines", "base_pairs") and self.measures[key]
        ]
        return f"<Validation of {self.structure.name}: {'; '.join(faults) or 'nothing wrong'}>"

    def _repr_html_(self) -> str:
        words = {key: measure.what for key, measure in MEASURES.items()}
        words |= {key: description for key, (_, description) in LIKENESS.items()}
        rows = {words[key]: value for key, value in self.measures.items()}
        return facts(f"Validation of {self.structure.name}", rows)


@part("measuring")
def measures(structure: Any, x: Floats | None = None) -> dict[str, Any]:
    """Measure the faults of a structure, without a reference.

    Parameters
    ----------
    structure : Structure, or anything that :func:`protochain.as_structure` takes
        Structure to measure.
    x : (na, 3) float, nm, optional
        Other positions of its atoms.

    Returns
    -------
    dict of str to int or float
        The keys of ``MEASURES``. None if a quantity cannot be measured or positions are not finite.

    Raises
    ------
    ProtochainError
        If x has another shape.
    """
    structure = as_structure(structure)
    x = positions(structure, x)
    if not np.isfinite(x).all():
        return dict.fromkeys(MEASURES)
    return Findings(structure, x).measures()


def validate(source: Any, reference: Any = None, posebusters: bool = False, **settings: Any) -> Validation:
    """Find the faults of a structure, and measure its likeness to a reference.

    Heavy atoms are measured at their places in the file. Missing heavy atoms and hydrogens, which clashes
    need, are added as by :func:`protochain.load`. The result reports both.

    Parameters
    ----------
    source : Structure, Solution, path, or anything that :func:`protochain.as_structure` takes
        Structure to validate, or a solution, whose end is used.
    reference : the same, optional
        Structure to compare with. Residues are matched as by :func:`protochain.rmsd`. A file may have only
        C-alphas.
    posebusters : bool
        Whether PoseBusters' tests are run on the ligands. For a large ligand they need half a minute.
    **settings
        Options of :func:`protochain.load`, for the source.

    Returns
    -------
    Validation
        Numbers, a row for each residue, and faults in words.

    Raises
    ------
    ProtochainError
        If a file cannot be used, or no residue matches the reference.

    Examples
    --------
    >>> pc.validate("structures/1l2y.pdb").measures["violations"]
    0
    """
    posebusters = flag(posebusters, "posebusters")
    structure = as_structure(source, **settings)
    findings = Findings(structure, structure.positions)
    values, table = findings.measures(), findings.table()
    mapping: str | None = None
    if reference is not None:
        alike = likeness(structure, structure_to_measure(reference))
        values |= alike.measures
        mapping = alike.match.chain_mapping
        table["lddt"] = alike.lddt[table.index]
    ligands, reason = findings.ligands, ""
    if posebusters:
        ligands, reason = with_posebusters(structure, structure.positions, ligands)
    return Validation(
        structure, values, table, findings.violations, tuple(findings.listing()), mapping, ligands, reason
    )
