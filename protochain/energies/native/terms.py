"""Energy terms of an OpenMM System as arrays."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import openmm
from numpy.typing import NDArray

from protochain.core.arrays import Floats, Integers
from protochain.core.units import COULOMB
from protochain.energies.native.implicit import Solvent, from_custom_gb, from_gbsa_obc
from protochain.energies.native.reading import UnsupportedForceError, plain, rows, strip, tables

_HERMITE = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [-3, 3, -2, -1], [2, -2, 1, 1]])
"""Coefficients of 1, u, u^2, u^3 from values at 0 and 1 and slopes at 0 and 1."""
NO_MAPS = np.zeros((1, 1, 1, 4, 4))  # Coefficients of a System without torsion maps.
SHAPES = {
    "bonds": (2, 2), "angles": (3, 2), "torsions": (4, 3), "impropers": (4, 2), "maps": (8, 1),
    "ties": (2, 2), "tie angles": (3, 2),
}  # fmt: skip
"""Atoms and parameters of each kind."""
TIES = "ties of kept molecules"
"""Name of the harmonic forces for bonds between the protein and hetero molecules, separate kinds."""
_TIED = {"ties": "bonds", "tie angles": "angles"}
_WITH_NONBONDED = ("CustomNonbondedForce", "CustomBondForce", "GBSAOBCForce", "CustomGBForce")
_ONCE = ("NonbondedForce", "CMAPTorsionForce", *_WITH_NONBONDED)


@dataclass(frozen=True, eq=False)
class Bonded:
    """Bonded terms of one kind."""

    atoms: Integers  # (n, k) int.
    parameters: Floats  # (n, m).


@dataclass(frozen=True, eq=False)
class Nonbonded:
    """Lennard-Jones and Coulomb parameters."""

    charge: Floats  # (na,): Charge times the root of Coulomb's constant.
    lj_type: Integers  # (na,) int.
    a12: Floats  # a12, b6: (types, types): A and B of A/r^12 - B/r^6.
    b6: Floats
    exceptions: Bonded  # Pairs with their own parameters (A, B, q q), all zero if excluded.
    cutoff: float  # nm: Infinite for none.
    krf: float  # krf, crf: Constants of the reaction field q q (1/r + krf r^2 - crf).
    crf: float


@dataclass(frozen=True, eq=False)
class Terms:
    """Potential energy of a System, term by term."""

    n_atoms: int
    # ``bonds`` and ``ties`` (r0, k), ``angles`` and ``tie angles`` (theta0, k), ``torsions`` (n, phi0, k),
    # ``impropers`` (phi0, k), and ``maps`` of eight atoms with the index of the map.
    bonded: Mapping[str, Bonded]
    map_coefficients: Floats  # (maps, size, size, 4, 4).
    nonbonded: Nonbonded
    solvent: Solvent | None

    @cached_property
    def is_proper(self) -> NDArray[np.bool_]:
        """(n,) bool: whether the four atoms of each torsion are bonded in sequence."""
        atoms = self.bonded["torsions"].atoms
        return np.asarray(np.all([self._are_bonded(*atoms[:, k : k + 2].T) for k in range(3)], axis=0))

    @cached_property
    def centres(self) -> Integers:
        """(n, 2) int: atom bonded to the three others, twice, or the middle atoms if there is none."""
        # For the torsions that are not proper, then for the impropers.
        impropers = self.bonded["torsions"].atoms[~self.is_proper]
        atoms = np.concatenate([impropers, self.bonded["impropers"].atoms])
        centres = atoms[:, 1:3].copy()
        for k in range(4):
            bonded = [self._are_bonded(atoms[:, k], atoms[:, other]) for other in range(4) if other != k]
            is_centre = np.all(bonded, axis=0)
            centres[is_centre] = atoms[is_centre][:, [k, k]]
        return centres

    def _are_bonded(self, first: Integers, second: Integers) -> NDArray[np.bool_]:
        bonds = np.sort(self.bonded["bonds"].atoms, axis=1) @ [self.n_atoms, 1]
        return np.isin(self.n_atoms * np.minimum(first, second) + np.maximum(first, second), bonds)


def compile_system(system: openmm.System) -> Terms:
    """Read the terms of a System."""
    forces_by_class: dict[str, list[openmm.Force]] = {}
    for force in system.getForces():
        forces_by_class.setdefault(type(force).__name__, []).append(force)
    forces_by_class.pop("CMMotionRemover", None)
    if unknown := sorted(set(forces_by_class) - set(READERS) - {"NonbondedForce", *_WITH_NONBONDED}):
        raise UnsupportedForceError(f"{unknown[0]} has no native kernel")
    if any(system.isVirtualSite(i) for i in range(system.getNumParticles())):
        raise UnsupportedForceError("virtual sites have no native kernel")
    if repeated := [name for name in forces_by_class if name in _ONCE and len(forces_by_class[name]) > 1]:
        raise UnsupportedForceError(f"more than one {repeated[0]}")
    for forces in forces_by_class.values():
        for force in forces:
            if force.usesPeriodicBoundaryConditions():
                raise UnsupportedForceError(f"{type(force).__name__} with periodic boundaries")
    bonded = {kind: Bonded(*_stack_terms(kind, forces_by_class)) for kind in SHAPES}
    maps = [m for force in forces_by_class.get("CMAPTorsionForce", []) for m in _read_maps(force)]
    sizes = {len(m) for m in maps}
    if len(sizes) > 1:
        raise UnsupportedForceError("CMAPTorsionForce with maps of different sizes")
    coefficients = np.array([spline_coefficients(m) for m in maps]) if maps else NO_MAPS
    nonbonded, solvent = _read_nonbonded(system, forces_by_class), _read_solvent(forces_by_class)
    if solvent is not None:
        _check_cutoff("GBSAOBCForce or CustomGBForce", solvent.cutoff, nonbonded.cutoff)
    return Terms(system.getNumParticles(), bonded, coefficients, nonbonded, solvent)


def _stack_terms(kind: str, forces_by_class: dict[str, list[openmm.Force]]) -> tuple[Integers, Floats]:
    n_atoms, n_parameters = SHAPES[kind]
    rows = [
        row
        for name, (kind_read, read) in READERS.items() if kind_read == _TIED.get(kind, kind)
        for force in forces_by_class.get(name, []) if (force.getName() == TIES) == (kind in _TIED)
        for row in read(force)
    ]  # fmt: skip
    table = np.array(rows, dtype=float).reshape(-1, n_atoms + n_parameters)
    return table[:, :n_atoms].astype(np.int64), table[:, n_atoms:].copy()


def _read_impropers(force: openmm.CustomTorsionForce) -> list[list[Any]]:
    names = [force.getPerTorsionParameterName(i) for i in range(force.getNumPerTorsionParameters())]
    if strip(force.getEnergyFunction()) != "k*(theta-theta0)^2" or sorted(names) != ["k", "theta0"]:
        raise UnsupportedForceError(f"CustomTorsionForce {force.getEnergyFunction()!r}")
    order = [names.index("theta0"), names.index("k")]
    read = rows(force, "getNumTorsions", "getTorsionParameters")
    return [[*row[:4], *(row[4][place] for place in order)] for row in read]


def _read_map_torsions(force: openmm.CMAPTorsionForce) -> list[list[Any]]:
    return [[*row[1:], row[0]] for row in rows(force, "getNumTorsions", "getTorsionParameters")]


READERS = {
    "HarmonicBondForce": ("bonds", lambda force: rows(force, "getNumBonds", "getBondParameters")),
    "HarmonicAngleForce": ("angles", lambda force: rows(force, "getNumAngles", "getAngleParameters")),
    "PeriodicTorsionForce": ("torsions", lambda force: rows(force, "getNumTorsions", "getTorsionParameters")),
    "CustomTorsionForce": ("impropers", _read_impropers),
    "CMAPTorsionForce": ("maps", _read_map_torsions),
}


def _read_maps(force: openmm.CMAPTorsionForce) -> list[Floats]:
    read = [force.getMapParameters(i) for i in range(force.getNumMaps())]
    # OpenMM's first angle runs fastest.
    return [np.array([plain(v) for v in values]).reshape(size, size).T for size, values in read]


def spline_coefficients(grid: Floats) -> Floats:
    """Fit the periodic bicubic spline through a map."""
    # grid (size, size) kJ/mol -> (size, size, 4, 4): Coefficients of u^a v^b, u and v from 0 to 1 in a cell.
    # First and cross derivatives are from periodic cubic splines along each axis: MacKerell, Feig,
    # Brooks, J. Comput. Chem. 25:1400 (2004).
    along = _slopes(grid, 0)
    across = _slopes(grid, 1)
    cross = _slopes(along, 1)
    corners = np.empty((*grid.shape, 4, 4))
    for a, (value, slope) in enumerate(((grid, across), (along, cross))):
        for i in (0, 1):
            for j in (0, 1):
                corners[..., 2 * a + i, j] = np.roll(value, (-i, -j), (0, 1))
                corners[..., 2 * a + i, 2 + j] = np.roll(slope, (-i, -j), (0, 1))
    return np.einsum("ap,ijpq,bq->ijab", _HERMITE, corners, _HERMITE)


def _slopes(values: Floats, axis: int) -> Floats:
    """Differentiate the periodic spline along one axis, per grid step."""
    # Imported only for force fields with maps, because the import is as slow as minimising a small protein.
    from scipy.interpolate import CubicSpline

    size = values.shape[axis]
    closed = np.concatenate([values, np.take(values, [0], axis)], axis)
    spline = CubicSpline(np.arange(size + 1), closed, axis=axis, bc_type="periodic")
    return np.asarray(spline(np.arange(size), 1))


def _read_nonbonded(system: openmm.System, forces_by_class: dict[str, list[openmm.Force]]) -> Nonbonded:
    n = system.getNumParticles()
    force = forces_by_class.get("NonbondedForce", [openmm.NonbondedForce()])[0]
    if not force.getNumParticles():
        for _ in range(n):
            force.addParticle(0.0, 1.0, 0.0)
    if force.getNumParticleParameterOffsets() or force.getNumExceptionParameterOffsets():
        raise UnsupportedForceError("NonbondedForce with parameter offsets")
    cutoff, krf, crf = np.inf, 0.0, 0.0
    if force.getNonbondedMethod() == force.CutoffNonPeriodic:
        if force.getUseSwitchingFunction():
            raise UnsupportedForceError("NonbondedForce with a switching function")
        cutoff, dielectric = plain(force.getCutoffDistance()), force.getReactionFieldDielectric()
        # Tironi, Sperb, Smith, van Gunsteren, J. Chem. Phys. 102:5451 (1995).
        krf = (dielectric - 1.0) / (2.0 * dielectric + 1.0) / cutoff**3
        crf = 3.0 * dielectric / (2.0 * dielectric + 1.0) / cutoff
    particles = np.array(rows(force, "getNumParticles", "getParticleParameters"))
    pair_tables = None
    for table in forces_by_class.get("CustomNonbondedForce", []):
        types, read = _read_types(table, force), tables(table)
        pair_tables = types, read["acoef"], read["bcoef"]
    exceptions = _read_exceptions(force, forces_by_class)
    return nonbonded_of(particles, exceptions, cutoff, krf, crf, pair_tables)


def nonbonded_of(
    particles: Floats, exceptions: Bonded, cutoff: float = np.inf, krf: float = 0.0, crf: float = 0.0,
    pair_tables: tuple[list[float], Floats, Floats] | None = None,
) -> Nonbonded:  # fmt: skip
    """Parameters of particles (na, 3): charge, sigma, epsilon, and with tables of their types."""
    charge, sigma, epsilon = particles.T
    # Sigma has no effect without a well, so all such atoms share a type.
    kinds = np.column_stack([np.where(epsilon == 0.0, 0.0, sigma), epsilon, np.zeros(len(charge))])
    if pair_tables:
        kinds[:, 2] = pair_tables[0]
    types, lj_type = np.unique(kinds, axis=0, return_inverse=True)
    s6 = (0.5 * (types[:, None, 0] + types[None, :, 0])) ** 6
    b6 = 4.0 * np.sqrt(types[:, None, 1] * types[None, :, 1]) * s6
    a12 = b6 * s6
    if pair_tables:
        table_type = types[:, 2].astype(int)
        _, more_a, more_b = pair_tables
        a12, b6 = a12 + more_a[np.ix_(table_type, table_type)], b6 + more_b[np.ix_(table_type, table_type)]
    return Nonbonded(
        charge * np.sqrt(COULOMB), lj_type.reshape(-1).astype(np.int64), a12, b6, exceptions,
        cutoff, krf, crf,
    )  # fmt: skip


def _read_exceptions(force: openmm.NonbondedForce, forces_by_class: dict[str, list[openmm.Force]]) -> Bonded:
    read = np.array(rows(force, "getNumExceptions", "getExceptionParameters"), dtype=float).reshape(-1, 5)
    pairs = np.sort(read[:, :2].astype(np.int64), axis=1)
    parameters = pair_parameters(read[:, 2:])
    keys = pairs @ (key := [force.getNumParticles(), 1])
    order = np.argsort(keys)
    for custom in forces_by_class.get("CustomBondForce", []):
        names = [custom.getPerBondParameterName(i) for i in range(custom.getNumPerBondParameters())]
        is_lj = strip(custom.getEnergyFunction()) == "4*epsilon*((sigma/r)^12-(sigma/r)^6)"
        if not is_lj or sorted(names) != ["epsilon", "sigma"]:
            raise UnsupportedForceError(f"CustomBondForce {custom.getEnergyFunction()!r}")
        bonds = rows(custom, "getNumBonds", "getBondParameters")
        if not bonds:
            continue
        bond_keys = np.sort([bond[:2] for bond in bonds], axis=1) @ key
        place = np.searchsorted(keys, bond_keys, sorter=order)
        if not np.isin(bond_keys, keys).all():
            raise UnsupportedForceError("CustomBondForce between atoms that are no exception")
        sizes = np.array([bond[2] for bond in bonds]).T[[names.index("sigma"), names.index("epsilon")]]
        np.add.at(parameters[:, :2], order[place], _well(*sizes))
    return Bonded(pairs, parameters)


def pair_parameters(pairs: Floats) -> Floats:
    """A, B and q q (n, 3) of pairs (n, 3): product of charges, sigma, epsilon."""
    return np.column_stack([_well(*pairs[:, 1:].T), pairs[:, 0] * COULOMB])


def _well(sigma: Floats, epsilon: Floats) -> Floats:
    """A and B (n, 2) of A/r^12 - B/r^6."""
    b6 = 4.0 * epsilon * sigma**6
    return np.column_stack([b6 * sigma**6, b6])


def _read_types(table: openmm.CustomNonbondedForce, force: openmm.NonbondedForce) -> list[float]:
    """Type of each particle in CHARMM's table of Lennard-Jones parameters."""
    names = [table.getPerParticleParameterName(i) for i in range(table.getNumPerParticleParameters())]
    is_supported = (
        strip(table.getEnergyFunction()) == "acoef(type1,type2)/r^12-bcoef(type1,type2)/r^6"
        and names == ["type"]
        and not table.getNumInteractionGroups()
        and table.getNonbondedMethod() == force.getNonbondedMethod()
        and not table.getUseSwitchingFunction()
    )
    if not is_supported:
        raise UnsupportedForceError(f"CustomNonbondedForce {table.getEnergyFunction()!r}")
    if force.getNonbondedMethod() != force.NoCutoff:
        _check_cutoff(
            "CustomNonbondedForce", plain(table.getCutoffDistance()), plain(force.getCutoffDistance())
        )
    excluded = {tuple(sorted(table.getExclusionParticles(i))) for i in range(table.getNumExclusions())}
    exceptions = {tuple(sorted(row[:2])) for row in rows(force, "getNumExceptions", "getExceptionParameters")}
    if excluded != exceptions:
        raise UnsupportedForceError("CustomNonbondedForce with other exclusions than NonbondedForce")
    return [table.getParticleParameters(i)[0] for i in range(table.getNumParticles())]


def _read_solvent(forces_by_class: dict[str, list[openmm.Force]]) -> Solvent | None:
    if "GBSAOBCForce" in forces_by_class and "CustomGBForce" in forces_by_class:
        raise UnsupportedForceError("GBSAOBCForce together with CustomGBForce")
    for force in forces_by_class.get("GBSAOBCForce", []):
        return from_gbsa_obc(force)
    for force in forces_by_class.get("CustomGBForce", []):
        return from_custom_gb(force)
    return None


def _check_cutoff(name: str, cutoff: float, reference: float) -> None:
    """Refuse a force whose cutoff in nm (infinite for none) differs from NonbondedForce's cutoff."""
    if cutoff != reference:
        raise UnsupportedForceError(
            f"{name} with a cutoff of {cutoff:g} nm, NonbondedForce with {reference:g} nm"
        )
