"""The measures of a structure by itself, and its validation: these, and a row for each residue."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from protochain.arrays import Floats, Value, floats
from protochain.structure.chirality import wrong_atoms
from protochain.structure.convert import as_structure
from protochain.structure.model import Structure
from protochain.validation.cbeta import Deviations, cbeta_deviations
from protochain.validation.layout import layout
from protochain.validation.omega import Peptides, omegas
from protochain.validation.ramachandran import Ramachandran, ramachandran
from protochain.validation.rotamers import SideChains, side_chains
from protochain.validation.violations import Violations, violations

MEASURES = {
    "violations": "residues with violations, as AlphaFold counts them",
    "ramachandran_outliers": "residues in outlier regions of the Ramachandran plot",
    "ramachandran_favoured_percent": "residues in its favoured regions, per cent",
    "rotamer_outliers": "side chains far from every usual rotamer",
    "cbeta_outliers": "C-betas 0.25 angstrom or more from their ideal place",
    "cis_peptides": "cis peptide bonds but those before proline",
    "cis_prolines": "cis peptide bonds before proline",
    "twisted_peptides": "peptide bonds more than 30 degrees from planar",
    "wrong_hands": "chiral atoms of the wrong hand",
}
"""Keys of :func:`measures`, and what they count."""


@dataclass(frozen=True, eq=False)
class Found(Value):
    """All that is measured of a structure at some positions."""

    structure: Structure
    x: Floats

    @cached_property
    def violations(self) -> Violations:
        """Structural violations."""
        return violations(self.structure, self.x)

    @cached_property
    def ramachandran(self) -> Ramachandran:
        """Residues on the Ramachandran plot."""
        return ramachandran(self.structure, self.x)

    @cached_property
    def side_chains(self) -> SideChains:
        """Side chains and their distances from rotamers."""
        return side_chains(self.structure, self.x)

    @cached_property
    def cbeta(self) -> Deviations:
        """C-beta deviations."""
        return cbeta_deviations(self.structure, self.x)

    @cached_property
    def peptides(self) -> Peptides:
        """Peptide bonds."""
        return omegas(self.structure, self.x)

    @cached_property
    def wrong_hands(self) -> Any:
        """Chiral atoms (n,) of the wrong hand."""
        return wrong_atoms(self.structure, self.x, layout(self.structure).mirrored)

    def measures(self) -> dict[str, Any]:
        """Count all that is found; see :func:`measures`."""
        peptides, favoured = self.peptides, self.ramachandran.favoured_percent
        return {
            "violations": len(self.violations.residues),
            "ramachandran_outliers": len(self.ramachandran.outliers),
            "ramachandran_favoured_percent": favoured if np.isfinite(favoured) else None,
            "rotamer_outliers": len(self.side_chains.outliers),
            "cbeta_outliers": len(self.cbeta.outliers),
            "cis_peptides": int(np.sum(peptides.cis & ~peptides.proline)),
            "cis_prolines": int(np.sum(peptides.cis & peptides.proline)),
            "twisted_peptides": int(peptides.twisted.sum()),
            "wrong_hands": len(self.wrong_hands),
        }


def measures(structure: Any, x: Floats | None = None) -> dict[str, Any]:
    """Measure what is wrong with a structure by itself.

    Parameters
    ----------
    structure : Structure, or anything that :func:`protochain.as_structure` takes
        Prepared protein.
    x : (na, 3) float, nm, optional
        Other positions of its atoms.

    Returns
    -------
    dict of str to int or float
        The keys of ``MEASURES``; None where nothing can be measured, or positions are not finite.
    """
    structure = as_structure(structure)
    x = structure.positions if x is None else floats(x, (structure.n_atoms, 3), "x", "nanometer")
    if not np.isfinite(x).all():
        return dict.fromkeys(MEASURES)
    return Found(structure, x).measures()
