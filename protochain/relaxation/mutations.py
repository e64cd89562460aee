"""``mutate``: point mutations, with energies of both sides that depend on the fixed atoms alone."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from time import perf_counter
from types import MappingProxyType
from typing import Any

import numpy as np
from scipy.spatial import KDTree

from protochain.chains.setup import OF_ENERGY, Setup
from protochain.core.arrays import Value
from protochain.core.checks import check_arguments
from protochain.core.checks import words as words_of
from protochain.core.errors import Argument, ProtochainError, StructureError
from protochain.core.settings import document_fields
from protochain.core.units import ANGSTROM_PER_NM
from protochain.energies import Energy
from protochain.energies.factory import has_energy
from protochain.energies.requested import cached_energy
from protochain.minimisers.verdict import Status
from protochain.relaxation.relax_settings import RelaxSettings, split
from protochain.relaxation.relax_structure import relax_structure
from protochain.relaxation.result import Relaxation
from protochain.results.columns import Column, record
from protochain.structure import Structure
from protochain.structure.build import from_sequence
from protochain.structure.molecule.residues import LETTERS, STANDARD
from protochain.structure.select import atoms_at
from protochain.structure.sidechains.ideal import place_points
from protochain.structure.substitute import substitute
from protochain.validation.layout import NONE, layout

NEAR = 10.0
"""Angstrom between C-betas at their ideal positions, within which side chains are rebuilt and move."""
PROTOCOL: Mapping[str, Any] = MappingProxyType({"preset": "predicted", "stiffness": 0.0, "tolerance": 1.0})
"""Settings of the relaxation. The fixed backbone makes both sides comparable. Springs to the rotamers would
add strain of tens of kJ/mol if a large residue replaces a small one."""
_BETA = 1.53, np.deg2rad(110.1), np.deg2rad(122.8)
"""CA-CB in angstrom, C-CA-CB, and the dihedral N-C-CA-CB: Lovell et al., Proteins 50:437 (2003)."""
_BACKBONE = ("N", "CA", "C", "O", "OXT")
_PLACE = re.compile(r"(?:(\S*):)?([A-Z])(-?\d+[A-Z]?)([A-Z])")
_PROTONS = {"HIS": ("HD1", "HE2"), "ASP": ("HD2",), "GLU": ("HE2",), "LYS": ("HZ1",), "CYS": ("HG",)}
_STATES = {
    ("HIS", (True, True)): "HIP", ("HIS", (True, False)): "HID", ("HIS", (False, True)): "HIE",
    ("ASP", (True,)): "ASH", ("GLU", (True,)): "GLH", ("LYS", (False,)): "LYN", ("CYS", (False,)): "",
}  # fmt: skip
"""Protonation states by the protons present. A bonded cysteine has no state by itself."""


@document_fields
@dataclass(frozen=True, eq=False)
class Mutation(Value):
    """A mutant and its wild type, with equally rebuilt and relaxed side chains near the site.

    Examples
    --------
    >>> pc.mutate("structures/ala10.pdb", "A5G").mutations
    ('A:A5G',)
    """

    mutations: tuple[str, ...]  # As ``A:L45F``.
    wild: Relaxation  # Wild type, relaxed by the same protocol, with the same moving residues.
    mutant: Relaxation  # Mutant.
    # kJ/mol: Change of energy of the same residues in pentapeptides GGXGG. None for bonded cysteines.
    unfolded: float | None
    seconds: float  # Wall time of all.

    @property
    def structure(self) -> Structure:
        """The relaxed mutant."""
        return self.mutant.structure

    @property
    def energy_function(self) -> Energy:
        """Energy function of the mutant."""
        return self.mutant.energy_function

    @property
    def change(self) -> float:
        """Energy of the mutant minus the wild type's, kJ/mol. Their atoms differ: use ``ddg``."""
        return self.mutant.energy_end - self.wild.energy_end

    @property
    def ddg(self) -> float | None:
        """Change of energy beyond the pentapeptides', kJ/mol, above 0 if less stable. Not a free energy."""
        return None if self.unfolded is None else self.change - self.unfolded

    @property
    def interface_change(self) -> float | None:
        """Change of the binding energy of the interface in the settings, kJ/mol."""
        ends = [side.interface_end for side in (self.wild, self.mutant)]
        if ends[0] is None or ends[1] is None:
            return None
        return float(ends[1].scores["energy_kj_mol"] - ends[0].scores["energy_kj_mol"])

    def save(self, path: str | Path) -> None:
        """Write the mutant with its provenance, as :meth:`Relaxation.save`."""
        self.mutant.save(path)

    def record(self) -> dict[str, Any]:
        """Flat record behind JSON and tables, with None for missing numbers."""
        return record(COLUMNS, self)

    def __repr__(self) -> str:
        ddg = "-" if self.ddg is None else f"{self.ddg:.1f} kJ/mol"
        name, label = self.wild.start.name, ",".join(self.mutations)
        return f"<Mutation {label} of {name}: {self.mutant.status}, ddG {ddg}>"


_CLASHES = "clashscore_per_1000_atoms"
COLUMNS = (
    Column("structure", lambda m: m.wild.start.name),
    Column("mutations", lambda m: ",".join(m.mutations)),
    Column("status", lambda m: str(m.mutant.status), kind=Status),
    Column("status_wild", lambda m: str(m.wild.status), kind=Status),
    Column("ddg_kj_mol", lambda m: m.ddg),
    Column("energy_change_kj_mol", lambda m: m.change),
    Column("unfolded_change_kj_mol", lambda m: m.unfolded),
    Column("energy_wild_kj_mol", lambda m: m.wild.energy_end),
    Column("energy_mutant_kj_mol", lambda m: m.mutant.energy_end),
    Column("interface_change_kj_mol", lambda m: m.interface_change),
    Column("violations", lambda m: m.mutant.measures_end["violations"], kind=int),
    Column("clashscore_per_1000_atoms", lambda m: m.mutant.measures_end[_CLASHES], kind=float | None),
    Column("n_residues_moved", lambda m: len(np.unique(m.mutant.start.atom_residue[m.mutant.moving]))),
    Column("ca_rmsd_angstrom", lambda m: m.mutant.ca_rmsd_angstrom),
    Column("seconds", lambda m: m.seconds),
    Column("message", lambda m: m.mutant.message),
)


@check_arguments()
def mutate(source: Any, mutations: str | Sequence[str], **options: Any) -> Mutation:
    """Mutate residues, and return the change of energy.

    Side chains with C-betas within 10 angstrom of the site are removed, built on rotamers and relaxed. The
    backbone and all other atoms stay fixed. The wild type is treated in the same way, with the same residues.
    So the energy of each side depends on the fixed atoms alone: a mutation to the same residue has ``ddg``
    0, and the reverse mutation of the mutant has the opposite ``ddg``. Exceptions are mutated residues whose
    side chains are bonded to others, or have an unusual protonation state.

    Parameters
    ----------
    source : Structure, path, or anything that :func:`protochain.as_structure` accepts
        Structure to mutate; relax it first.
    mutations : str or sequence of str
        As ``"A:L45F"``, separated by commas, all in one mutant. For a single chain also ``"L45F"``.
    **options
        As for :func:`protochain.relax`. The binding energies of ``interface`` are compared. The default
        tolerance is 1 kJ/mol/nm.

    Returns
    -------
    Mutation
        Both sides. ``ddg`` is an energy difference that approximates the change of stability,
        ``interface_change`` the change of the binding energy, kJ/mol. Neither is a free energy.

    Raises
    ------
    ProtochainError
        If the structure has no such residues, or an option makes no sense.

    Examples
    --------
    >>> m = pc.mutate("structures/1l2y.pdb", "A:L7A")
    >>> m.structure.describe_residue(6), m.ddg > 0.0
    ('A:ALA7', True)
    """
    relaxing, setup = protocol(options, source)
    structure = setup.load(source)
    return mutate_at(structure, places_of(structure, mutations), relaxing, setup, {})


def protocol(options: Mapping[str, Any], source: Any = None) -> tuple[RelaxSettings, Setup]:
    """Settings of both sides, by default with the energy of a result given as ``source``."""
    if "move" in options:
        raise ProtochainError("mutate has no option 'move': what is near moves")
    base = source.energy_function.settings if has_energy(source) else {}
    if has_energy(source) and not base and "forcefield" not in options:
        raise ProtochainError(
            "mutate: the energy of this result is of its own atoms; name a ", Argument("forcefield")
        )
    inherited = {name: base[name] for name in OF_ENERGY if name in base}
    if options.get("solvent") == "vacuum":
        inherited.pop("salt", None)
    return split({**PROTOCOL, **inherited, **options})


def places_of(structure: Structure, mutations: str | Sequence[str]) -> dict[int, str]:
    """Names of new residues by the index of the replaced residue, for mutations as ``A:L45F``."""
    chains, new_names = list(dict.fromkeys(structure.residue_chain.tolist())), dict[int, str]()
    texts = words_of(mutations, "mutations")
    if not texts:
        raise ProtochainError("mutations: give some, as A:L45F,B:G10A")
    for text in texts:
        match = _PLACE.fullmatch(text.upper() if ":" not in text else text)
        if match is None or not {match[2], match[4]} <= LETTERS.keys():
            raise ProtochainError(f"mutations: {text!r}: give chain, residue, number, new residue, as A:L45F")
        if match[1] is None and len(chains) > 1:
            raise ProtochainError(f"mutations: {text!r}: name its chain, of {', '.join(chains)}")
        chain = chains[0] if match[1] is None else match[1]
        (r, *_) = structure.atom_residue[atoms_at(structure, f"{chain}:{match[3]}")].tolist()
        if STANDARD.get(str(structure.residue_name[r])) != match[2]:
            raise StructureError(f"{structure.name}: {text}: there is {structure.describe_residue(r)}")
        if r in new_names:
            raise ProtochainError(f"mutations: {text!r}: its residue is mutated twice")
        new_names[r] = LETTERS[match[4]]
    return new_names


def mutate_at(
    structure: Structure, names: Mapping[int, str], relaxing: RelaxSettings, setup: Setup,
    results: dict[tuple[Any, ...], Relaxation],
) -> Mutation:  # fmt: skip
    """Return a mutant of residues by index. ``results`` caches the sides of one site."""
    began = perf_counter()
    # A mutation to the same residue does not change its protonation state.
    new = {r: name for r, name in names.items() if name != structure.residue_name[r]}
    states = _near(structure, [*names])
    # Both sides choose the tautomer that the surroundings favour, so a histidine may change its tautomer.
    states |= {r: "HIS" for r in names if states.get(r) in ("HID", "HIE")}
    while True:
        built = (states, states | new)
        sides = [substitute(structure, residue_names, **setup.of_building) for residue_names in built]
        # A neighbour that would get another proton or a new bond is not rebuilt, on both sides.
        changed = {r for r in states if r not in names and any(_state(s, r) != states[r] for s in sides)}
        if not changed:
            break
        states = {r: states[r] for r in {*states} - changed}
    near = sorted({*states, *names})
    keys = [(*near, *sorted(residue_names.items())) for residue_names in built]
    for key, side in zip(keys, sides, strict=True):
        if key not in results:
            results[key] = _relax(side, near, relaxing, setup)
    wild, mutant = (results[key] for key in keys)
    unfolded = None if new else 0.0
    of_sites = [[_state(end.start, r) for r in names] for end in (wild, mutant)]
    if new and all(map(all, of_sites)):
        before, after = (sum(_unfolded_energy(s, relaxing, setup) for s in site) for site in of_sites)
        unfolded = after - before
    labels = tuple(mutation_label(structure, r, str(mutant.start.residue_name[r])) for r in names)
    return Mutation(labels, wild, mutant, unfolded, perf_counter() - began)


def mutation_label(structure: Structure, r: int, name: str) -> str:
    """A mutation as ``A:L45F``."""
    residue = structure.residue(r)
    return f"{residue.chain}:{STANDARD[str(structure.residue_name[r])]}{residue.number}{STANDARD[name]}"


def _near(structure: Structure, residues: Sequence[int]) -> dict[int, str]:
    """States of the residues to rebuild, chosen by C-betas from the backbone alone, equal on both sides."""
    atoms = layout(structure).atoms("N", "CA", "C")
    (complete,) = np.nonzero((atoms != NONE).all(axis=1))
    n, alpha, c = ANGSTROM_PER_NM * structure.positions[atoms[complete].T]
    turn = np.where(structure.mirrored[complete], -1.0, 1.0) * _BETA[2]
    betas = place_points(n, c, alpha, _BETA[0], _BETA[1], turn)
    distances = KDTree(betas[np.isin(complete, residues)]).query(betas)[0]
    return {r: state for r in complete[distances <= NEAR].tolist() if (state := _rebuildable(structure, r))}


def _rebuildable(structure: Structure, r: int) -> str:
    """State of a standard residue whose side chain is not bonded or tied to others, else empty."""
    name, state, residue_of = structure.residue_name[r], _state(structure, r), structure.atom_residue
    side = np.flatnonzero((residue_of == r) & ~np.isin(structure.atom_name, _BACKBONE)).tolist()
    tied = {k for tie in structure.ties for k in tie.atoms}
    if tied & {*side} or any(residue_of[atom] != r for k in side for atom in structure.neighbours[k]):
        return ""
    # Protonation states of D-amino acids have no names.
    names = {name, state} if structure.mirrored[r] else {name}
    return state if names <= STANDARD.keys() else ""


def _relax(structure: Structure, near: Sequence[int], relaxing: RelaxSettings, setup: Setup) -> Relaxation:
    """Put side chains into their best rotamers and relax them, with all other atoms fixed."""
    move = _select_side_chains(structure, near)
    energy = setup.energy(structure, cached_energy)
    return relax_structure(structure, energy, replace(relaxing, repack_region=move), move=move)


def _select_side_chains(structure: Structure, residues: Sequence[int]) -> str:
    """Selection of the side chains and the hydrogens of residues."""
    of_backbone = np.isin(structure.atom_name, _BACKBONE)
    atoms = np.flatnonzero(np.isin(structure.atom_residue, residues) & ~of_backbone)
    ends = np.flatnonzero(np.diff(atoms, prepend=-2, append=structure.n_atoms + 1) != 1)
    runs = zip(atoms[ends[:-1]], atoms[ends[1:] - 1], strict=True)
    return "index " + " ".join(f"{first}:{last}" for first, last in runs)


def _state(structure: Structure, r: int) -> str:
    """Name of a residue in its protonation state, empty for a bonded cysteine."""
    name, names = str(structure.residue_name[r]), structure.atom_name[structure.atom_residue == r]
    protons = tuple(proton in names for proton in _PROTONS.get(name, ()))
    return _STATES.get((name, protons), name)


@lru_cache(maxsize=64)
def _unfolded_energy(state: str, relaxing: RelaxSettings, setup: Setup) -> float:
    """Energy of a residue in GGXGG by the same protocol, a model of the unfolded chain, kJ/mol."""
    # Bonds, restraints and selections of the protein do not apply to the peptide.
    peptide = substitute(from_sequence("GGGGG"), {2: state}, **setup.of_building | {"disulfide": None})
    alone = replace(relaxing, interface="", restraints=(), exclude="")
    return _relax(peptide, [2], alone, setup).energy_end
