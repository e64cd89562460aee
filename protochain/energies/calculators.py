"""Energies by name, xtb and machine-learned potentials, of the ligands in the force field of the rest."""

import copy
import hashlib
from collections.abc import Callable
from functools import partial
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
import openmm

from protochain.core.arrays import Floats, Integers
from protochain.core.errors import Argument, ProtochainError
from protochain.core.optional_libraries import library
from protochain.energies.custom import CustomEnergy
from protochain.energies.elements import exclude_pairs
from protochain.energies.protocol import Energy
from protochain.structure.molecule.model import Structure

_KINDS = {"Bond": 2, "Angle": 3, "Torsion": 4}  # Numbers of atoms of terms.


class Calculator(NamedTuple):
    """An ASE calculator of molecules with a total charge."""

    module: str
    extra: str
    build: Callable[[Any, int], Any]  # Module and total charge, e -> calculator.
    largest: int  # Largest number of atoms that it accepts.
    is_neutral: bool = False  # Whether it was fitted to neutral molecules only.


CALCULATORS = {
    "xtb": Calculator(
        "tblite.ase", "xtb", lambda m, q: m.TBLite(method="GFN2-xTB", charge=q, guess="eeq", verbosity=0), 200
    ),
    "aimnet2": Calculator(
        "aimnet.calculators", "aimnet2", lambda m, q: m.AIMNet2ASE("aimnet2", charge=q), 2000
    ),
    "mace-off": Calculator(
        "mace.calculators", "mace-off", lambda m, q: m.mace_off("medium", default_dtype="float64"), 2000, True
    ),
}
"""GFN2-xTB (Bannwarth, Ehlert, Grimme, J. Chem. Theory Comput. 15:1652, 2019), AIMNet2 (Anstine, Zubatyuk,
Isayev, Chem. Sci. 16:10228, 2025) and MACE-OFF23 (Kovacs et al., J. Am. Chem. Soc. 147:17598, 2025)."""


class CalculatorEnergy(CustomEnergy):
    """Energy of a region by an ASE calculator, and of all other terms by the force field.

    The interaction of the region with the rest, and the solvent, are terms of the force field (mechanical
    embedding, as ``createMixedSystem`` of OpenMM-ML). The region is all ligands, or, without ligands, all
    atoms. ``build`` is :func:`protochain.energy`, and ``settings`` are its further arguments.
    """

    def __init__(
        self, build: Callable[..., Energy], structure: Structure, calculator: str, **settings: Any
    ) -> None:
        chosen = chosen_calculator(calculator)
        module = library(chosen.module, chosen.extra)
        self.region = region_of(structure, calculator)
        whole = build(structure, **settings)
        system = without_inside(whole.system, self.region)
        self.rest = build(structure, **(settings | {"system": system}))
        (nonbonded,) = (f for f in whole.system.getForces() if isinstance(f, openmm.NonbondedForce))
        charge = round(sum(nonbonded.getParticleParameters(int(k))[0]._value for k in self.region))
        if charge and chosen.is_neutral:
            raise ProtochainError(
                f"{calculator} computes neutral molecules, but this one has the charge {charge:+d}; "
                "give xtb or aimnet2"
            )
        elements = structure.atom_element[self.region].tolist()
        ase_calculator = chosen.build(module, charge)
        self._ase = library("ase", chosen.extra).Atoms(elements, calculator=ase_calculator)
        super().__init__(self._compute)
        self.name, self.atoms, self.solvent = calculator, structure.fingerprint, whole.solvent
        self.forcefield, self.threads = f"{whole.forcefield} + {calculator}", whole.threads
        self.settings = {k: v for k, v in settings.items() if k != "system"} | {"calculator": calculator}
        self.reason = f"{calculator} of {len(self.region)} atoms with charge {charge:+d}; {whole.reason}"
        self.fingerprint = hashlib.sha256(f"{calculator}{whole.fingerprint}".encode()).hexdigest()
        self._rebuild = partial(build, structure, calculator=calculator, **settings)

    def __reduce__(self) -> Any:
        return self._rebuild, ()

    def list_at(self, x: Floats) -> None:
        """Build the neighbour lists of the force field at positions x (na, 3) in nm."""
        self.rest.list_at(x)

    def parts(self, x: Floats) -> tuple[dict[str, float], Floats]:
        """Energies in kJ/mol of the calculator and of the force field's terms, and forces (na, 3)."""
        value, pull = self._inside(x)
        terms, forces = self.rest.parts(x)
        return {self.name: value, **terms}, _with_forces(forces, self.region, pull)

    def _compute(self, x: Floats) -> tuple[float, Floats]:
        value, pull = self._inside(x)
        rest, forces = self.rest(x)
        return rest + value, _with_forces(forces, self.region, pull)

    def _inside(self, x: Floats) -> tuple[float, Floats]:
        """Energy in kJ/mol of the region and forces on it in kJ/mol/nm, NaN if the calculator fails."""
        from ase.calculators.calculator import CalculatorError
        from ase.units import kJ, mol, nm

        self._ase.positions = x[self.region] * nm
        try:
            return (
                float(self._ase.get_potential_energy()) * mol / kJ,
                np.asarray(self._ase.get_forces(), dtype=np.float64) * mol / kJ * nm,
            )
        except CalculatorError:  # No self-consistent solution, as of overlapping atoms. A run steps back.
            return np.nan, np.full((len(self.region), 3), np.nan)


def chosen_calculator(name: str) -> Calculator:
    """Calculator of a name."""
    if name not in CALCULATORS:
        is_former = name in ("all", "nonbonded")  # The option had another meaning.
        terms = ("; terms of the force field are ", Argument("terms")) if is_former else ()
        raise ProtochainError(Argument("calculator", name), f": give one of {', '.join(CALCULATORS)}", *terms)
    return CALCULATORS[name]


def region_of(structure: Structure, name: str) -> Integers:
    """Atoms (k,) of the ligands, or of the whole structure without ligands."""
    ligands = [bound.atoms for bound in structure.ligands]
    region = np.sort(np.concatenate(ligands)) if ligands else np.arange(structure.n_atoms)
    across = structure.bonds[np.isin(structure.bonds, region).sum(axis=1) == 1]
    if len(across):
        raise ProtochainError(
            f"{structure.name}: {structure.describe(int(across[0, 0]))} has a bond to the ligand, and {name} "
            "computes whole molecules; remove the bond from the file"
        )
    if len(region) > CALCULATORS[name].largest:
        hint = "a smaller one" if ligands else "a peptide, or the chemistry of the ligands"
        raise ProtochainError(
            f"{structure.name}: {name} computes up to {CALCULATORS[name].largest} atoms, not {len(region)}; "
            f"give {hint}"
        )
    return region


def without_inside(system: openmm.System, atoms: Integers) -> openmm.System:
    """Copy of a System without the terms among some atoms. Their terms with others and the solvent remain."""
    out, inside = copy.deepcopy(system), {*atoms.tolist()}
    exclude_pairs(out, combinations(sorted(inside), 2))
    for force in out.getForces():
        kind = next((kind for kind in _KINDS if hasattr(force, f"getNum{kind}s")), "")
        is_map, flat = isinstance(force, openmm.CMAPTorsionForce), None
        for k in range(getattr(force, f"getNum{kind}s")() if kind else 0):
            values = getattr(force, f"get{kind}Parameters")(k)
            members = values[1:] if is_map else values[: _KINDS[kind]]
            if not inside >= {*members}:
                continue
            if is_map:
                size = force.getMapParameters(values[0])[0]
                flat = force.addMap(size, [0.0] * size**2) if flat is None else flat
                force.setTorsionParameters(k, flat, *members)
            else:
                zeros = [_zero(value) for value in values[_KINDS[kind] :]]
                getattr(force, f"set{kind}Parameters")(k, *members, *zeros)
    return out


def _zero(value: Any) -> Any:
    """Parameter of a term without energy. Periodicities are whole numbers above 0, and remain."""
    if isinstance(value, tuple):  # All parameters of a custom force.
        return [0.0] * len(value)
    return value if isinstance(value, int) else 0.0 * value


def _with_forces(forces: Floats, atoms: Integers, pull: Floats) -> Floats:
    out = np.array(forces)
    out[atoms] += pull
    return out
