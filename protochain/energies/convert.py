"""Conversion of energies for other libraries, and of OpenMM simulations."""

from typing import TYPE_CHECKING, Any

import numpy as np
import openmm
from openmm import app, unit

from protochain.core.arrays import Floats
from protochain.core.checks import brief, check_arguments, instance
from protochain.core.errors import ProtochainError
from protochain.energies.factory import energy
from protochain.energies.protocol import Energy
from protochain.energies.requested import as_energy
from protochain.structure.convert import as_structure
from protochain.structure.molecule.model import Structure

if TYPE_CHECKING:
    from ase import Atoms

_SAME_PLACE = 1e-6  # nm. Positions are converted to angstrom and back.
_SIMULATION = instance(app.Simulation, "openmm.app.Simulation(topology, system, integrator)")


def to_ase(structure: Any, energy: Any = None) -> "Atoms":
    """Convert a structure and its energy to ASE Atoms with a calculator.

    Parameters
    ----------
    structure : Structure, or any input of :func:`protochain.as_structure`
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

    Examples
    --------
    >>> len(pc.to_ase(pc.from_sequence("GAG")))
    27
    """
    try:
        from ase import Atoms
        from ase.units import nm

        from protochain.energies.ase_calculator import EnergyCalculator
    except ModuleNotFoundError as error:
        raise ProtochainError("ASE is not installed; python -m pip install ase") from error
    model = as_structure(structure)
    energy = as_energy(energy, model, structure)
    return Atoms(
        symbols=model.atom_element.tolist(),
        positions=model.positions * nm,
        masses=model.atom_mass,
        calculator=EnergyCalculator(energy),
    )


def energy_from(calculator: Any, structure: Any) -> Energy:
    """Energy of a structure by an ASE calculator, such as xtb or a machine-learned potential.

    Parameters
    ----------
    calculator : ase.calculators.calculator.Calculator, or ase.Atoms with one
        It computes energies in eV and forces in eV/angstrom.
    structure : Structure, or any input of :func:`protochain.as_structure`
        Structure whose elements and positions the calculator receives, in the order of the atoms.

    Returns
    -------
    Energy
        For every call with an energy. It is its own reference, because no other engine computes it.

    Raises
    ------
    ProtochainError
        If it is not a calculator, or its forces are not the derivative of its energy.

    Examples
    --------
    >>> s = pc.from_sequence("GAG")
    >>> e = pc.energy_from(pc.to_ase(s), s)
    >>> bool(np.isclose(e(s.positions)[0], pc.energy(s)(s.positions)[0]))
    True
    """
    from ase import Atoms
    from ase.units import kJ, mol, nm

    model = as_structure(structure)
    calc = getattr(calculator, "calc", calculator)
    if not callable(getattr(calc, "get_potential_energy", None)) or isinstance(calc, type):
        description = brief(calculator)
        raise ProtochainError(f"calculator {description}: give a calculator of ASE, or Atoms with one")
    atoms = Atoms(model.atom_element.tolist(), model.positions * nm, masses=model.atom_mass, calculator=calc)

    def by_calculator(x: Floats) -> tuple[float, Floats]:
        atoms.positions = x * nm
        return atoms.get_potential_energy() * mol / kJ, atoms.get_forces() * mol / kJ * nm

    by_calculator.__qualname__ = type(calc).__qualname__
    return as_energy(by_calculator, model)


@check_arguments(simulation=_SIMULATION)
def from_simulation(simulation: Any) -> tuple[Structure, Energy]:
    """Structure and energy of an OpenMM simulation in its current state.

    Parameters
    ----------
    simulation : openmm.app.Simulation
        Simulation of a protein in vacuum or implicit solvent, with all hydrogens.

    Returns
    -------
    structure : Structure
        Structure with the atoms of the simulation, in its order and at its positions.
    energy : Energy
        Energy of the simulation's System, by native kernels if they support all its forces.

    Raises
    ------
    ProtochainError
        If the prepared structure would have other atoms, or a constrained bond has no force.

    Examples
    --------
    >>> import openmm
    >>> s = pc.from_sequence("GAG")
    >>> simulation = openmm.app.Simulation(s.topology, pc.energy(s).system, openmm.VerletIntegrator(0.001))
    >>> pc.to_simulation(s, simulation)
    >>> structure, energy = pc.from_simulation(simulation)
    >>> structure.n_atoms
    27
    """
    state = simulation.context.getState(getPositions=True)
    x = np.asarray(state.getPositions(asNumpy=True).value_in_unit(unit.nanometer))
    structure = as_structure((simulation.topology, x), "simulation")
    if structure.n_atoms != len(x) or not np.allclose(structure.positions, x, rtol=0.0, atol=_SAME_PLACE):
        raise ProtochainError(
            f"simulation: its {len(x)} atoms are not the {structure.n_atoms} of the prepared structure; "
            "give one of a whole protein without explicit water, made from structure.topology"
        )
    if n_bare := _count_bare_constraints(simulation.system):
        raise ProtochainError(
            f"simulation: its System constrains {n_bare} bonds that have no force, and would break; "
            "create it with constraints=None or flexibleConstraints=True"
        )
    return structure, energy(structure, system=simulation.system)


def _count_bare_constraints(system: openmm.System) -> int:
    """Number of constraints without a bond force between the same atoms."""
    bonds = [force for force in system.getForces() if isinstance(force, openmm.HarmonicBondForce)]
    bonded = {frozenset(f.getBondParameters(k)[:2]) for f in bonds for k in range(f.getNumBonds())}
    pairs = (system.getConstraintParameters(k)[:2] for k in range(system.getNumConstraints()))
    return sum(frozenset(pair) not in bonded for pair in pairs)


@check_arguments(simulation=_SIMULATION)
def to_simulation(structure: Any, simulation: Any) -> None:
    """Set the positions of an OpenMM simulation to a structure, without changing its velocities.

    Parameters
    ----------
    structure : Structure, Solution, or any input of :func:`protochain.as_structure`
        Structure with the atoms of the simulation, in its order, as from :func:`from_simulation`.
    simulation : openmm.app.Simulation
        Simulation whose context receives the positions.

    Raises
    ------
    ProtochainError
        If the structure has another number of atoms.

    Examples
    --------
    >>> import openmm
    >>> s = pc.from_sequence("GAG")
    >>> simulation = openmm.app.Simulation(s.topology, pc.energy(s).system, openmm.VerletIntegrator(0.001))
    >>> pc.to_simulation(s, simulation)
    """
    structure = as_structure(structure)
    n = simulation.system.getNumParticles()
    if structure.n_atoms != n:
        raise ProtochainError(
            f"{structure.name}: has {structure.n_atoms} atoms, not the {n} of the simulation; "
            "give one of from_simulation"
        )
    simulation.context.setPositions(structure.positions)
