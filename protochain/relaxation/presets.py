"""Strengths of relaxation: every number of every preset, in one place, with its source."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from protochain.core.settings import document_fields

KCAL_PER_ANGSTROM2 = 418.4
"""kJ/mol/nm^2 in 1 kcal/mol/angstrom^2."""


@document_fields
@dataclass(frozen=True)
class Preset:
    """Strengths of the springs of a relaxation, and its tolerance."""

    name: str  # Value of the option that selects it.
    # kJ/mol/nm^2: Springs E = k/2 d^2 from heavy atoms of the backbone to the input, a strength for each
    # stage. Hydrogens have none.
    backbone: tuple[float, ...]
    # kJ/mol/nm^2: The same for heavy atoms of side chains.
    side_chains: tuple[float, ...]
    tolerance: float  # kJ/mol/nm: RMS force, springs included, at which each stage ends.
    source: str  # Source of the numbers.
    # Soft repulsions that separate overlapping atoms in stages before the force field acts: range, as a share
    # of the contact distance, and stiffness in kJ/mol/nm^2.
    softened: tuple[tuple[float, float], ...] = ()
    forcefield: str = ""  # Force field of the protocol. Empty for the value of the settings.
    solvent: str = ""  # Solvent of the protocol. Empty for the value of the settings.
    planar: bool = True  # Whether peptide bonds are restrained to their usual range while springs act.


IN_RIGID_PROTEIN = (0.85, 1e3), (0.85, 1e4)
"""Soft repulsions if only ligands move. The first moves a ligand as a whole and does not bend bonds. After a
stiffer one ligands stay wrapped around atoms of the protein. With a range of 0.7 many do so, too."""

_ALPHAFOLD = 10.0 * KCAL_PER_ANGSTROM2
_BINDER = 3.0 * KCAL_PER_ANGSTROM2

_TABLE = (
    Preset(
        "predicted", (_ALPHAFOLD,), (_ALPHAFOLD,), 10.0,
        "springs and tolerance of AlphaFold's relaxation (Jumper et al., Nature 596:583, 2021, supplement "
        "1.8.6: 10 kcal/mol/angstrom^2; 2.39 kcal/mol, which OpenMM takes as an RMS force of 10 kJ/mol/nm), "
        "in ff14SB and OBC2",
    ),
    Preset(
        "crystal", (_ALPHAFOLD,), (1000.0,), 10.0,
        "backbone as predicted; side chains 1000 kJ/mol/nm^2, the usual position restraint of GROMACS "
        "(pdb2gmx)",
    ),
    Preset(
        "design", (_BINDER, 0.4 * _BINDER, 0.0), (0.0, 0.0, 0.0), 10.0,
        "springs of the backbone as in the relaxation of FreeBindCraft: 3 kcal/mol/angstrom^2 times 1, 0.4 "
        "and 0, repulsion soft first; without its dynamics between the stages",
        softened=((0.7, 1e4),),
    ),
)  # fmt: skip

PRESETS: Mapping[str, Preset] = MappingProxyType({preset.name: preset for preset in _TABLE})

_PROTOCOLS = (
    Preset(
        "alphafold", (_ALPHAFOLD,), (_ALPHAFOLD,), 10.0,
        "AlphaFold's relaxation (Jumper et al., 2021): amber99sb in vacuum, 10 kcal/mol/angstrom^2 on heavy "
        "atoms, 2.39 kcal/mol; bonds to hydrogen are free here, and constrained there",
        forcefield="amber99sb", solvent="vacuum", planar=False,
    ),
)  # fmt: skip

PROTOCOLS: Mapping[str, Preset] = MappingProxyType({preset.name: preset for preset in _PROTOCOLS})
"""Relaxations of other programs, to compare like with like."""
