"""Conversion of energies for other libraries."""

from typing import TYPE_CHECKING, Any

from protochain.core.errors import ProtochainError
from protochain.energies.custom import as_energy
from protochain.structure.convert import as_structure

if TYPE_CHECKING:
    from ase import Atoms


def to_ase(structure: Any, energy: Any = None) -> "Atoms":
    """Convert a structure and its energy to ASE Atoms with a calculator.

    Parameters
    ----------
    structure : Structure, or anything that :func:`protochain.as_structure` takes
        Structure to convert.
    energy : Energy or callable, optional
        As in :func:`protochain.minimise`.

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
    structure = as_structure(structure)
    energy = as_energy(energy, structure)
    return Atoms(
        symbols=structure.atom_element.tolist(),
        positions=structure.positions * nm,
        masses=structure.atom_mass,
        calculator=EnergyCalculator(energy),
    )
