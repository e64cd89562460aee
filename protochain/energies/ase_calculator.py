"""Energies as calculators of the Atomic Simulation Environment, ASE."""

from typing import Any

from ase import Atoms
from ase.calculators.calculator import Calculator, all_changes
from ase.units import kJ, mol, nm

from protochain.energies.protocol import Energy


class EnergyCalculator(Calculator):
    """ASE calculator, in eV and eV/angstrom (Larsen et al., J. Phys.: Condens. Matter 29:273002, 2017)."""

    implemented_properties: list[str] = ["energy", "forces"]  # noqa: RUF012 (as ASE declares it)

    def __init__(self, energy: Energy) -> None:
        super().__init__()
        self.energy = energy

    def calculate(
        self,
        atoms: Atoms | None = None,
        properties: Any = ("energy",),
        system_changes: Any = tuple(all_changes),
    ) -> None:
        """Compute energy and forces, whichever properties are requested."""
        super().calculate(atoms, properties, system_changes)
        assert self.atoms is not None
        value, forces = self.energy(self.atoms.positions / nm)
        self.results = {"energy": value * kJ / mol, "forces": forces * kJ / mol / nm}
