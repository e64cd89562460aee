"""Energy terms of a protein from the templates of a force field, without an OpenMM System.

OpenMM's generators assign parameters to one term of each combination of atom types. Other terms copy them.
"""

from collections.abc import Callable
from itertools import combinations, pairwise
from types import SimpleNamespace
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
import openmm
from numpy.typing import NDArray
from openmm import app
from openmm.app import forcefield as generators
from openmm.app.internal.customgbforces import GBSAOBC2Force

from protochain.core.arrays import Floats, Integers
from protochain.energies.native.implicit import OBC2_CHARGE_SCALE, from_gbsa_obc
from protochain.energies.native.terms import (
    NO_MAPS,
    READERS,
    SHAPES,
    Bonded,
    Terms,
    nonbonded_of,
    pair_parameters,
)
from protochain.structure.molecule.model import Structure

_GENERATORS = {
    generators.HarmonicBondGenerator, generators.HarmonicAngleGenerator, generators.PeriodicTorsionGenerator,
    generators.NonbondedGenerator,
}  # fmt: skip
"""Classes of the generators that are read. Each has terms that depend on the types of their atoms only."""
_Built = list[tuple[list[int], list[float]]]
"""Terms of a combination of atom types: order of the atoms, and parameters."""
_KNOWN: WeakKeyDictionary[app.ForceField, dict[Any, Any]] = WeakKeyDictionary()
"""What a force field has built: terms by the types of their atoms in order, and atoms of residues."""


class _Assigned(NamedTuple):
    """Parameters of each atom, from the template of its residue."""

    types: list[str]
    places: list[int]  # Places in the templates.
    particles: Floats  # (na, 3): Charge, sigma and epsilon of NonbondedForce.
    radii: Floats  # (na, 2): Radius and scale of OBC2.


def template_terms(
    structure: Structure, force_field: app.ForceField, obc2: openmm.Force | None
) -> Terms | None:
    """Terms of a structure without cutoff, equal bit by bit to terms of its System."""
    # The particles of ``obc2`` are the atoms. None if only a System has all terms.
    by_class = {type(generator): generator for generator in force_field.getGenerators()}
    if by_class.keys() != _GENERATORS or force_field._scripts or force_field._templateMatchers:
        return None
    atoms, n = list(structure.topology.atoms()), structure.n_atoms
    start, partners = _adjacency(structure.bonds, n)
    ends, others = start.tolist(), partners.tolist()
    bonded = [others[a:b] for a, b in pairwise(ends)]
    assigned = _assign(structure, force_field, bonded, obc2 is not None)
    if assigned is None:
        return None
    data = SimpleNamespace(
        atoms=atoms, atomType=dict(zip(atoms, assigned.types, strict=True)), propers=[], impropers=[],
        atomTemplateIndexes=dict(zip(atoms, assigned.places, strict=True)),
    )  # fmt: skip
    angles, propers = _angles(start, partners), _propers(start, partners)

    def run(name: str, **terms: Any) -> list[list[Any]]:
        """Rows of the force that a generator builds of some terms."""
        generator, system = by_class[getattr(generators, f"{name}Generator")], openmm.System()
        vars(data).update(terms)
        generator.createForce(system, data, app.NoCutoff, 1.0, {})
        if hasattr(generator, "postprocessSystem"):
            generator.postprocessSystem(system, data, {})
        force = system.getForce(0)
        return READERS[type(force).__name__][1](force)

    names, known = np.array(assigned.types), _KNOWN.setdefault(force_field, {})
    bonds = _copy_parameters(
        structure.bonds, names, known,
        lambda rows: run("HarmonicBond", bonds=[app.ForceField._BondData(*row) for row in rows]),
    )  # fmt: skip
    bends = _copy_parameters(
        angles, names, known,
        lambda rows: run("HarmonicAngle", angles=rows, isAngleConstrained=[False] * len(rows)),
    )  # fmt: skip
    turns = _copy_parameters(
        propers, names, known, lambda rows: run("PeriodicTorsion", propers=rows), is_symmetric=True
    )
    # The order of the atoms of an improper depends on the residues of the first in the structure.
    more = _copy_parameters(
        _impropers(start, partners), names, {},
        lambda rows: run("PeriodicTorsion", propers=[], impropers=rows),
    )  # fmt: skip
    tables = {"bonds": bonds, "angles": bends, "torsions": np.concatenate([turns, more])}
    subsets = {}
    for kind, (n_atoms, n_parameters) in SHAPES.items():
        table = tables.get(kind, np.empty((0, n_atoms + n_parameters)))
        subsets[kind] = Bonded(table[:, :n_atoms].astype(np.int64), table[:, n_atoms:].copy())
    generator = by_class[generators.NonbondedGenerator]
    exceptions = _exceptions(structure.bonds, angles, propers, assigned.particles, generator)
    nonbonded = nonbonded_of(assigned.particles, exceptions)
    solvent = None
    if obc2 is not None:
        solvent = from_gbsa_obc(
            obc2, np.column_stack([OBC2_CHARGE_SCALE * assigned.particles[:, 0], assigned.radii])
        )
    return Terms(n, subsets, NO_MAPS, nonbonded, solvent)


def _adjacency(bonds: Integers, n: int) -> tuple[Integers, Integers]:
    """Bonded atoms of each atom in ascending order: (n + 1,) starts, and the atoms."""
    keys = np.unique(np.concatenate([bonds @ [n, 1], bonds @ [1, n]]))
    return np.searchsorted(keys // n, np.arange(n + 1)), keys % n


def _partners_of(atoms: Integers, start: Integers, partners: Integers) -> tuple[Integers, Integers]:
    """Bonded atoms of each of some atoms: rows of ``atoms``, and a bonded atom of each."""
    counts = np.diff(start)[atoms]
    row = np.repeat(np.arange(len(atoms)), counts)
    offset = np.arange(len(row)) - np.repeat(np.cumsum(counts) - counts, counts)
    return row, partners[start[atoms][row] + offset]


def _angles(start: Integers, partners: Integers) -> Integers:
    """Angles (n, 3) in ascending order, the smaller end first."""
    centre = np.repeat(np.arange(len(start) - 1), np.diff(start))
    row, end = _partners_of(centre, start, partners)
    angles = np.column_stack([partners[row], centre[row], end])[partners[row] < end]
    return angles[np.lexsort(angles.T[::-1])]


def _propers(start: Integers, partners: Integers) -> Integers:
    """Proper torsions (n, 4) in ascending order, the smaller end first."""
    b, c = np.repeat(np.arange(len(start) - 1), np.diff(start)), partners
    b, c = b[b < c], c[b < c]
    row, a = _partners_of(b, start, partners)
    a, b, c = a[a != c[row]], b[row][a != c[row]], c[row][a != c[row]]
    row, d = _partners_of(c, start, partners)
    a, b, c = a[row], b[row], c[row]
    paths = np.column_stack([a, b, c, d])[(d != b) & (d != a)]
    paths = np.where((paths[:, 0] < paths[:, 3])[:, None], paths, paths[:, ::-1])
    return paths[np.lexsort(paths.T[::-1])]


def _impropers(start: Integers, partners: Integers) -> Integers:
    """Atoms with any three of their bonded atoms (n, 4), in ascending order of the first."""
    degree = np.diff(start)
    groups = [np.empty((0, 4), dtype=np.int64)]
    for size in range(3, degree.max(initial=0) + 1):
        centre = np.flatnonzero(degree == size)
        for trio in combinations(range(size), 3):
            groups.append(np.column_stack([centre, partners[start[centre][:, None] + trio]]))
    rows = np.concatenate(groups)
    return rows[np.argsort(rows[:, 0], kind="stable")]


def _copy_parameters(
    rows: Integers,
    names: NDArray[np.str_],
    known: dict[tuple[str, ...], _Built],
    build: Callable[[list[tuple[int, ...]]], list[list[Any]]],
    is_symmetric: bool = False,
) -> Floats:
    """Atoms and parameters of all terms. ``build`` makes the first of each combination of types."""
    types = np.unique(names, return_inverse=True)[1].reshape(-1)
    n = rows.shape[1]
    powers = (int(types.max(initial=0)) + 1) ** np.arange(n)
    keys = types[rows] @ powers
    if is_symmetric:
        keys = np.minimum(keys, types[rows[:, ::-1]] @ powers)
    _, first, kind = np.unique(keys, return_index=True, return_inverse=True)
    examples = [*map(tuple, names[rows[first]].tolist())]
    new = {
        example: tuple(row)
        for example, row in zip(examples, rows[first].tolist(), strict=True)
        if example not in known
    }
    places = {frozenset(row): example for example, row in new.items()}
    fresh: dict[tuple[str, ...], _Built] = {example: [] for example in new}
    for row in build([*new.values()]) if new else []:
        example = places[frozenset(row[:n])]
        fresh[example].append(([new[example].index(atom) for atom in row[:n]], row[n:]))
    known.update(fresh)
    built = [known[example] for example in examples]
    copies = np.array([len(terms) for terms in built], dtype=np.int64)
    order = np.array([atoms for terms in built for atoms, _ in terms], dtype=np.int64)
    parameters = np.array([values for terms in built for _, values in terms], dtype=float)
    # The terms of each row, from those of its example.
    at, term = _partners_of(kind.reshape(-1), np.append(0, np.cumsum(copies)), np.arange(copies.sum()))
    if not len(term):
        return np.empty((0, n))
    return np.column_stack([np.take_along_axis(rows[at], order[term], axis=1), parameters[term]])


def _assign(
    structure: Structure, force_field: app.ForceField, bonded: list[list[int]], is_in_solvent: bool
) -> _Assigned | None:
    """Assign parameters to each atom, or None if a residue has no template, or one with more than atoms."""
    owner = structure.atom_residue.tolist()
    known = _KNOWN.setdefault(force_field, {})
    rows: list[tuple[Any, ...]] = []
    for residue in structure.topology.residues():
        atoms = [*residue.atoms()]
        first, index = atoms[0].index, residue.index
        kinds_of_atoms = (
            (atom.name, atom.element, *(b - first if owner[b] == index else None for b in bonded[atom.index]))
            for atom in atoms
        )
        key = (is_in_solvent, *kinds_of_atoms)
        if key not in known:
            template, places = force_field._getResidueTemplateMatches(residue, bonded)
            if places is None or template.constraints or template.virtualSites:
                return None
            kinds = [template.atoms[place] for place in places]
            inside = [(a, atoms[b - first]) for a in atoms for b in bonded[a.index] if owner[b] == index]
            radii = _radii(atoms, inside) if is_in_solvent else np.zeros((len(atoms), 2))
            particles = _particles(force_field, atoms, kinds)
            known[key] = [*zip((kind.type for kind in kinds), places, particles, radii, strict=True)]
        rows += known[key]
    types, indices, charges, sizes = zip(*rows, strict=True)
    return _Assigned([*types], [*indices], np.array(charges), np.array(sizes))


def _particles(force_field: app.ForceField, atoms: list[Any], kinds: list[Any]) -> list[list[float]]:
    """Charge, sigma and epsilon of the atoms of a residue, whose template has atoms of these kinds."""
    data = SimpleNamespace(
        atomType={atom: kind.type for atom, kind in zip(atoms, kinds, strict=True)},
        atomParameters={atom: kind.parameters for atom, kind in zip(atoms, kinds, strict=True)},
    )
    (nonbonded,) = (g for g in force_field.getGenerators() if isinstance(g, generators.NonbondedGenerator))
    return [nonbonded.params.getAtomParameters(atom, data) for atom in atoms]


def _radii(atoms: list[Any], bonds: list[tuple[Any, Any]]) -> Floats:
    """Radii and scales of OBC2 (n, 2) of the atoms of a residue with bonds between them."""
    residue = SimpleNamespace(getNumAtoms=lambda: len(atoms), atoms=lambda: atoms, bonds=lambda: bonds)
    return np.asarray(GBSAOBC2Force.getStandardParameters(residue))


def _exceptions(
    bonds: Integers, angles: Integers, propers: Integers, particles: Floats, generator: Any
) -> Bonded:
    """Pairs one to three bonds apart, in the order and with the parameters of OpenMM."""
    n = len(particles)
    near = np.concatenate([bonds, angles[:, [0, 2]]])
    pairs = np.sort(np.concatenate([near, propers[:, [0, 3]]]), axis=1)
    _, first = np.unique(pairs @ [1, n], return_index=True)
    pairs, is_scaled = pairs[first], first >= len(near)
    charge, sigma, epsilon = particles[pairs].transpose(2, 1, 0)
    parameters = np.column_stack([
        generator.coulomb14scale * charge[0] * charge[1], 0.5 * (sigma[0] + sigma[1]),
        generator.lj14scale * np.sqrt(epsilon[0] * epsilon[1]),
    ])  # fmt: skip
    parameters[~is_scaled] = 0.0, 1.0, 0.0
    return Bonded(pairs, pair_parameters(parameters))
