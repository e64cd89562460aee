"""Conversion of energies for other libraries."""

from typing import TYPE_CHECKING

from protochain.energies.protocol import Energy
from protochain.errors import ProtochainError
from protochain.structure.model import Structure

if TYPE_CHECKING:
    from ase import Atoms


def to_ase(structure: Structure, energy: Energy) -> "Atoms":
    """Convert a structure and its energy to ASE Atoms with a calculator.

    Parameters
    ----------
    structure : Structure
        Structure to convert.
    energy : Energy
        Energy of this structure.

    Returns
    -------
    ase.Atoms
        In angstrom and eV, for ASE's optimisers and dynamics.

    Raises
    ------
    ProtochainError
        If ASE is not installed.
    """
    try:
        from ase import Atoms
        from ase.units import nm

        from protochain.energies.ase_calculator import EnergyCalculator
    except ModuleNotFoundError as error:
        raise ProtochainError("ASE is not installed; python -m pip install ase") from error
    return Atoms(
        symbols=structure.atom_element.tolist(),
        positions=structure.positions * nm,
        masses=structure.atom_mass,
        calculator=EnergyCalculator(energy),
    )
