"""Measures of a structure by itself, and its validation."""

from typing import Any

import numpy as np

from protochain.core.arrays import Floats, floats
from protochain.core.checks import flag
from protochain.core.timings import part
from protochain.structure.convert import as_structure
from protochain.structure.matching import structure_to_measure
from protochain.validation.findings import MEASURES, Findings
from protochain.validation.ligands import with_posebusters
from protochain.validation.likeness import likeness
from protochain.validation.result import Validation


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
    x = structure.positions if x is None else floats(x, (structure.n_atoms, 3), "x", "nanometer")
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
