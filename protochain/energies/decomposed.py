"""Energy by term, by residue and by pair of residues.

The energy of a pair of residues sums the terms split between them. A residue's share is half of its pairs and
all terms within it.
"""

import re
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from protochain.core import defaults
from protochain.core.arrays import Floats, Integers, Value, angle, dihedral, distance
from protochain.core.checks import check_arguments, concentration, file_name, one_of, optional, text
from protochain.core.errors import ProtochainError
from protochain.core.settings import document_fields, without_none
from protochain.energies.native import NativeEnergy, UnsupportedForceError
from protochain.energies.native.neighbours import partners as partners_of
from protochain.energies.native.pairs import CLOSEST
from protochain.energies.native.shares import residue_sums
from protochain.energies.native.terms import Bonded, Terms
from protochain.energies.on_device import DeviceEnergy
from protochain.energies.openmm_engine import OpenMMEnergy
from protochain.energies.protocol import Energy, an_energy
from protochain.energies.requested import as_energy
from protochain.structure import as_structure
from protochain.structure.molecule.model import Structure
from protochain.structure.select import select

if TYPE_CHECKING:
    import pandas as pd

TERMS = (
    "bonds", "angles", "torsions", "impropers", "cmap", "lennard_jones", "coulomb", "generalised_born",
    "surface", "ties",
)  # fmt: skip
"""Terms of the energy. ``ties`` are springs of bonds to hetero molecules."""
BY = ("term", "residue", "pair")
_NONBONDED = slice(5, 8)
_CHUNKS = 16
"""Parts of the sums over pairs. Their order, and so the last bits, are the same for any number of threads."""
_AWAY = 1e4  # nm between molecules that do not interact: Born radii change by less than the last bit.
_SharedEnergies = tuple[Integers, Floats]
"""(n, 2) int, (n,) float: the two atoms that share each energy, or one atom twice."""


@document_fields
@dataclass(frozen=True, eq=False)
class Decomposed(Value):
    """Energy of a structure, term by term."""

    structure: Structure  # Structure of the energy.
    shares: Floats  # (terms, nr) float, kJ/mol: Share of each residue, in the order of ``TERMS``.
    # (terms, nr, nr) float, kJ/mol: Upper triangle: energies of two residues, on the diagonal within a
    # residue. Empty unless requested.
    pairs: Floats

    @property
    def terms(self) -> dict[str, float]:
        """Energy of each term, kJ/mol."""
        return dict(zip(TERMS, self.shares.sum(axis=1).tolist(), strict=True))


@check_arguments(
    forcefield=file_name, solvent=text, salt=concentration, by=one_of(BY), energy=optional(an_energy)
)
def energy_terms(
    source: Any,
    by: str = "term",
    *,
    between: Sequence[str] | str | None = None,
    forcefield: str | None = None,
    solvent: str | None = None,
    salt: float | None = None,
    energy: Energy | None = None,
    **settings: Any,
) -> "pd.DataFrame":
    """Decompose the energy of a structure by term, residue or pair of residues.

    Parameters
    ----------
    source : Structure, path, or any input of :func:`protochain.as_structure`
        Structure whose energy to decompose.
    by : str
        One of ``term``, ``residue``, or ``pair`` of residues.
    between : two str, or one text, optional
        Two parts of the structure, as ``"A:1-50,B"``, or two selections in the language of MDAnalysis. The
        result is their interaction, with ``residue`` or ``pair`` by residues.
    forcefield, solvent, salt : optional
        As for :func:`protochain.energy`.
    energy : Energy, optional
        Any energy whose System the native engine supports, in place of force field and solvent. The default
        is the energy of a result.
    **settings
        Options of :func:`protochain.load`, for a file.

    Returns
    -------
    pandas.DataFrame
        Energies in kJ/mol, columns ``TERMS`` and ``total``. By term, the only row is ``whole``. For two
        parts, the rows are ``interaction`` (pairs between the parts, with the Born radii of the complex),
        ``desolvation`` (change of generalised Born and surface within each part on binding, all other
        molecules removed) and ``sum``. By residue, a row starts with ``chain``, ``residue`` and ``name``. By
        pair, rows start with these columns of both residues. A residue paired with itself has its internal
        energy. Bonds, ties and pairs of atoms are split equally between their two atoms, torsions between
        their two middle atoms. An angle belongs to its middle atom, an improper to its central atom, a
        torsion map to its C-alpha. Self energies of generalised Born and surface terms belong to their atom.

    Raises
    ------
    ProtochainError
        If ``by`` is unknown, the parts cannot be read, are empty or have an atom in common, or the engine has
        no kernel for a force.

    Examples
    --------
    >>> terms = pc.energy_terms(pc.from_sequence("GAG"))
    >>> sorted(terms)[:3]
    ['angles', 'bonds', 'cmap']
    """
    import pandas as pd

    structure = as_structure(source, **without_none(forcefield=forcefield), **settings)
    parts = None if between is None else _parts(structure, between)
    options = without_none(forcefield=forcefield, solvent=solvent, salt=salt)
    resolved = as_energy(energy, structure, source, **options)
    native = native_of(resolved)
    if native is None:
        raise ProtochainError(f"energy: terms are told by the native engine alone, not by: {resolved.reason}")
    if parts and by == "term":
        return _interface(structure, native, parts)
    decomposition = decomposed(structure, native, structure.positions, by == "pair" or parts is not None)
    if parts:
        decomposition = _pairs_across(decomposition, parts)
    if by == "term":
        return _with_total(pd.DataFrame([decomposition.terms], index=["whole"]))
    number = np.char.add(structure.residue_number, structure.residue_insertion_code)
    columns = {"chain": structure.residue_chain, "residue": number, "name": structure.residue_name}
    labels = pd.DataFrame(columns)
    if by == "residue":
        return _with_total(labels.join(pd.DataFrame(decomposition.shares.T, columns=TERMS)))
    first, second = np.nonzero(decomposition.pairs.any(axis=0))
    sides = [labels.iloc[k].reset_index(drop=True).add_suffix(f"_{n}") for n, k in ((1, first), (2, second))]
    return _with_total(
        pd.concat([*sides, pd.DataFrame(decomposition.pairs[:, first, second].T, columns=TERMS)], axis=1)
    )


def _with_total(table: "pd.DataFrame") -> "pd.DataFrame":
    return table.assign(total=table[list(TERMS)].sum(axis=1))


def _parts(structure: Structure, between: Sequence[str] | str) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Residues of two parts, each (nr,) bool."""
    sides = between.split(",") if isinstance(between, str) else between
    if not isinstance(sides, list | tuple) or len(sides) != 2 or not all(isinstance(e, str) for e in sides):
        raise ProtochainError(f"between {between!r}: give two parts, as 'A:1-50,B'")
    masks = [residues_of(structure, part.strip(), "between") for part in sides]
    if (masks[0] & masks[1]).any():
        residue = structure.describe_residue(int(np.argmax(masks[0] & masks[1])))
        raise ProtochainError(
            f"between {between!r}: {residue} is in both parts; give parts without it in common"
        )
    return masks[0], masks[1]


def residues_of(structure: Structure, part: str, argument: str) -> NDArray[np.bool_]:
    """Residues (nr,) of a chain, of ``A:1-50``, or of a selection, for a named argument."""
    # Ends with insertion codes, as ``H:111A-112``, select the residues between them in the order of the file.
    place = re.fullmatch(r"(\w+)(?::(-?\d+)([A-Za-z]?)(?:-(-?\d+)([A-Za-z]?))?)?", part)
    chains = [*dict.fromkeys(structure.residue_chain.tolist())]
    if place is None or place[1] not in chains:
        mask = np.zeros(structure.n_residues, dtype=bool)
        try:
            mask[structure.atom_residue[select(structure, part)]] = True
        except ProtochainError:
            raise ProtochainError(
                f"{argument}: {part!r} is no part of {structure.name}; give a chain ({', '.join(chains)}), "
                "residues as A:1-50, or a selection that has atoms"
            ) from None
        return mask
    chosen = structure.residue_chain == place[1]
    first, last = (place[2], place[3]), (place[4] or place[2], place[5] if place[4] else place[3])
    number, code = structure.residue_number.astype(int), structure.residue_insertion_code
    if first[1] or last[1]:
        # Insertion codes have no order of their own: IMGT has 112B, 112A, 112.
        ends = [
            np.flatnonzero(chosen & (number == int(n)) & (code == (c or "")))[:1].tolist()
            for n, c in (first, last)
        ]
        order = np.arange(structure.n_residues)
        chosen &= bool(all(ends)) & (order >= sum(ends[0])) & (order <= sum(ends[1]))
    elif first[0]:
        chosen &= (number >= int(first[0])) & (number <= int(last[0]))
    if not chosen.any():
        raise ProtochainError(f"{argument}: {structure.name} has no residue {part}; give numbers that it has")
    return chosen


def _pairs_across(energies: Decomposed, parts: tuple[NDArray[np.bool_], NDArray[np.bool_]]) -> Decomposed:
    """Energies of pairs of residues with one residue in each part."""
    first, second = parts
    across = first[:, None] & second
    pairs = energies.pairs * (across | across.T)
    return Decomposed(energies.structure, _shares(pairs), pairs)


def _interface(
    structure: Structure, energy: NativeEnergy, parts: tuple[NDArray[np.bool_], NDArray[np.bool_]]
) -> "pd.DataFrame":
    import pandas as pd

    shares = interaction(structure, energy, structure.positions, *parts)
    rows = np.array([share.sum(axis=1) for share in shares])
    table = pd.DataFrame([*rows, rows.sum(axis=0)], ["interaction", "desolvation", "sum"], TERMS)
    return _with_total(table)


def native_of(energy: Energy) -> NativeEnergy | None:
    """The same energy by the native engine, or None for a callable or an unsupported System."""
    if isinstance(energy, DeviceEnergy):
        energy = energy.processor
    if isinstance(energy, OpenMMEnergy):
        try:
            return NativeEnergy(energy, energy.threads)
        except UnsupportedForceError:
            return None
    return energy if isinstance(energy, NativeEnergy) else None


def terms_at(energy: Energy, structure: Structure, *positions: Floats) -> tuple[dict[str, float], ...]:
    """Energy of each term, kJ/mol, at positions (na, 3) in nm, at less than two evaluations for each."""
    # Empty if the terms are unknown, as for a callable, and for more than ``defaults.FULL_UP_TO`` atoms,
    # because a sum over single pairs would take longer than the run.
    native = native_of(energy) if structure.n_atoms <= defaults.FULL_UP_TO else None
    return tuple({} if native is None else decomposed(structure, native, x).terms for x in positions)


def interaction(
    structure: Structure, energy: NativeEnergy, x: Floats, first: NDArray[np.bool_], second: NDArray[np.bool_]
) -> tuple[Floats, Floats]:
    """Interaction of two parts and their desolvation, with all other molecules removed."""
    # x (na, 3) nm, first, second (nr,) bool. -> interaction, desolvation (terms, nr) kJ/mol: shares of each
    # residue. Interaction is half of its pairs with the other part, with the Born radii of the complex.
    # Desolvation is the change of generalised Born and surface within its own part.
    first_atoms, second_atoms = (part[structure.atom_residue] for part in (first, second))
    offset = np.zeros((structure.n_atoms, 3))
    offset[~first_atoms & ~second_atoms, 1] = _AWAY
    complex_terms = decomposed(structure, energy, x + offset, pairs=True)
    offset[second_atoms, 0] = _AWAY
    separate_terms = decomposed(structure, energy, x + offset, pairs=True)
    desolvation = np.zeros_like(complex_terms.pairs)
    same_side = (first[:, None] & first) | (second[:, None] & second)
    for term in map(TERMS.index, ("generalised_born", "surface")):
        desolvation[term] = (complex_terms.pairs[term] - separate_terms.pairs[term]) * same_side
    return _pairs_across(complex_terms, (first, second)).shares, _shares(desolvation)


def _shares(pairs: Floats) -> Floats:
    """(terms, nr): half of the pairs of each residue with other residues, and all terms within it."""
    return np.asarray(0.5 * (pairs.sum(axis=1) + pairs.sum(axis=2)))


def decomposed(structure: Structure, energy: NativeEnergy, x: Floats, pairs: bool = False) -> Decomposed:
    """Decompose an energy into terms and shares of residues.

    Parameters
    ----------
    structure : Structure
        Structure with the residues.
    energy : NativeEnergy
        Energy of its atoms.
    x : (na, 3) float, nm
        Positions.
    pairs : bool
        Whether to sum the energy by pairs of residues, too.

    Returns
    -------
    Decomposed
        Terms, shares, and pairs if requested.
    """
    terms, residue_of, n = energy.terms, structure.atom_residue, structure.n_residues
    born, shares = energy.born_radii(x), np.zeros((len(TERMS), n))
    matrix = np.zeros((len(TERMS), n, n) if pairs else (0, 0, 0))
    energies = _bonded_energies(terms, x)
    energies |= _exception_energies(terms, x)
    if terms.solvent is not None:
        atoms = np.arange(len(x))[:, None].repeat(2, axis=1)
        share, kappa = terms.solvent.salt or (0.0, 0.0)
        screen = 1.0 + share - share * np.exp(-kappa * born)
        energies["generalised_born"] = atoms, -0.5 * terms.solvent.charge**2 / born * screen
        energies["surface"] = atoms, terms.solvent.surface / born**6
    for kind, (ends, values) in energies.items():
        if not len(values):
            continue
        k = TERMS.index(kind)
        for column in ends.T:
            shares[k] += np.bincount(residue_of[column], 0.5 * values, n)
        if pairs:
            residues = np.sort(residue_of[ends], axis=1)
            np.add.at(matrix[k], (residues[:, 0], residues[:, 1]), values)
    start = np.searchsorted(residue_of, np.arange(n + 1))
    for first, rows in _pairs_of_residues(terms, x, born, start, energy.threads):
        last = first + rows.shape[1]
        shares[_NONBONDED] += 0.5 * rows.sum(axis=1)
        shares[_NONBONDED, first:last] += 0.5 * rows.sum(axis=2)
        if pairs:
            matrix[_NONBONDED, first:last] += rows
    return Decomposed(structure, shares, matrix)


def _pairs_of_residues(
    terms: Terms, x: Floats, born: Floats, start: Integers, threads: int
) -> Iterator[tuple[int, Floats]]:
    """Yield nonbonded energies (3, rows, nr) of chunks of residues with all later residues."""
    # Lennard-Jones, Coulomb and generalised Born, in chunks: the full array would need much memory.
    nonbonded, solvent, n = terms.nonbonded, terms.solvent, len(start) - 1
    partner_start, partners = partners_of(nonbonded.exceptions.atoms, len(x))
    gb_charge, gb_cutoff = (solvent.charge, solvent.cutoff) if solvent else (np.empty(0), np.inf)
    salt = solvent.salt if solvent and solvent.salt else (0.0, 0.0)
    # Rows of the first residues are longer. Each part has the same number of pairs.
    boundaries = n - np.sqrt(np.linspace(n * n, 0.0, _CHUNKS + 1))
    begin = np.clip(np.round(boundaries), 0, n).astype(int)

    def part(chunk: int) -> tuple[int, Floats]:
        first, last = int(begin[chunk]), int(begin[chunk + 1])
        rows = np.zeros((3, last - first, n))
        residue_sums(
            first, last, start, np.ascontiguousarray(x.T), nonbonded.charge, nonbonded.lj_type, nonbonded.a12,
            nonbonded.b6, partner_start, partners, float(nonbonded.cutoff), float(nonbonded.krf),
            float(nonbonded.crf), gb_charge, born, float(gb_cutoff), *salt, rows,
        )  # fmt: skip
        return first, rows

    with ThreadPoolExecutor(threads) as pool:
        yield from pool.map(part, range(_CHUNKS))


def _exception_energies(terms: Terms, x: Floats) -> dict[str, _SharedEnergies]:
    """Energies of exceptions, pairs with their own parameters."""
    exceptions = terms.nonbonded.exceptions
    is_active = exceptions.parameters.any(axis=1)
    atoms, (a, b, qq) = exceptions.atoms[is_active], exceptions.parameters[is_active].T
    inverse2 = 1.0 / np.maximum(distance(*x[atoms.T]) ** 2, CLOSEST)
    inverse6 = inverse2 * inverse2 * inverse2
    return {
        "lennard_jones": (atoms, (a * inverse6 - b) * inverse6),
        "coulomb": (atoms, qq * np.sqrt(inverse2)),
    }


def _bonded_energies(terms: Terms, x: Floats) -> dict[str, _SharedEnergies]:
    """Bonded energies, and the atoms that share each."""
    bonded, is_proper = terms.bonded, terms.is_proper

    def springs(kind: str, measure: Callable[..., Floats]) -> Floats:
        equilibrium, k = bonded[kind].parameters.T
        return np.asarray(0.5 * k * (measure(*x[bonded[kind].atoms.T]) - equilibrium) ** 2)

    torsions, harmonic, maps = bonded["torsions"], bonded["impropers"], bonded["maps"]
    n, phase, k = torsions.parameters.T
    periodic = k * (1.0 + np.cos(n * _dihedrals(x, torsions.atoms) - phase))
    equilibrium, k = harmonic.parameters.T
    improper_energies = k * (_dihedrals(x, harmonic.atoms) - equilibrium) ** 2
    return {
        "bonds": (bonded["bonds"].atoms, springs("bonds", distance)),
        "angles": (bonded["angles"].atoms[:, [1, 1]], springs("angles", angle)),
        "torsions": (torsions.atoms[is_proper][:, 1:3], periodic[is_proper]),
        "impropers": (terms.centres, np.concatenate([periodic[~is_proper], improper_energies])),
        "cmap": (maps.atoms[:, [2, 2]], _maps(maps, terms.map_coefficients, x)),
        "ties": (
            np.concatenate([bonded["ties"].atoms, bonded["tie angles"].atoms[:, [1, 1]]]),
            np.concatenate([springs("ties", distance), springs("tie angles", angle)]),
        ),
    }


def _dihedrals(x: Floats, atoms: Integers) -> Floats:
    """(n,) float, rad, from -pi to pi."""
    # Terms of one torsion, of several periodicities, follow each other.
    new = np.append(True, (atoms[1:] != atoms[:-1]).any(axis=1))[: len(atoms)]
    return np.asarray(dihedral(*x[atoms[new].T])[np.cumsum(new) - 1])


def _maps(maps: Bonded, coefficients: Floats, x: Floats) -> Floats:
    """Torsion map energies, bicubic in each cell of a grid over two dihedrals."""
    size = coefficients.shape[1]
    angles = [_dihedrals(x, maps.atoms[:, k : k + 4]) for k in (0, 4)]
    cells = [phi % (2.0 * np.pi) * size / (2.0 * np.pi) for phi in angles]
    index = [np.minimum(place.astype(int), size - 1) for place in cells]
    powers = [(place - low)[:, None] ** np.arange(4) for place, low in zip(cells, index, strict=True)]
    surface = coefficients[maps.parameters[:, 0].astype(int), index[0], index[1]]
    return np.asarray(np.einsum("nij,ni,nj->n", surface, *powers))
