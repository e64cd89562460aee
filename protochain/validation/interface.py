"""Interfaces of two sides of a complex, scored: energy, area, bonds, fit of the surfaces, and whose share."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from protochain.core.arrays import Floats, Integers, Value, means_by
from protochain.core.checks import check_arguments, concentration, file_name, optional, text
from protochain.core.errors import ProtochainError
from protochain.core.graph import both_ways
from protochain.core.markup import facts
from protochain.core.settings import document_fields, without_none
from protochain.core.units import ANGSTROM_PER_NM
from protochain.energies.decomposed import TERMS, interaction, native_of
from protochain.energies.native import NativeEnergy
from protochain.energies.protocol import Energy, an_energy
from protochain.energies.requested import as_energy
from protochain.structure.convert import as_structure, to_mdtraj
from protochain.structure.formats.confidences import Confidence, confidence_files, read_scores
from protochain.structure.molecule.model import Structure
from protochain.structure.molecule.residues import NUCLEOTIDES
from protochain.structure.select import contacts, sides
from protochain.validation.bonding import hydrogen_bonds, salt_bridges, secondary_structure
from protochain.validation.clashes import clashes
from protochain.validation.complementarity import shape_complementarity, united_radii
from protochain.validation.packing import packing

if TYPE_CHECKING:
    import pandas as pd

Sides = tuple[NDArray[np.bool_], NDArray[np.bool_]]  # Residues (nr,) of either side.


class Score(NamedTuple):
    """Column of an interface: description, if more is better (1) or less (-1), and if it is a count."""

    what: str
    better: int = 0
    whole: bool = False


SCORES: Mapping[str, Score] = MappingProxyType(
    {
        "energy_kj_mol": Score("energy of binding of rigid sides, with desolvation", -1),
        "interaction_kj_mol": Score("the same without desolvation", -1),
        "lennard_jones_kj_mol": Score("Lennard-Jones energy between the sides", -1),
        "coulomb_kj_mol": Score("Coulomb energy between the sides", -1),
        "generalised_born_kj_mol": Score("generalised-Born energy between the sides", -1),
        "bonded_kj_mol": Score("energy of bonds that join the sides"),
        "desolvation_kj_mol": Score("what either side loses of its own solvation", -1),
        "energy_1_kj_mol": Score("of the energy of binding the share of the first side", -1),
        "energy_2_kj_mol": Score("of the energy of binding the share of the second side", -1),
        "energy_per_area_kj_mol_nm2": Score("energy of binding by buried area", -1),
        "energy_per_residue_kj_mol": Score("energy of binding by residues in contact", -1),
        "buried_area_angstrom2": Score("accessible area that both sides lose, of all atoms", 1),
        "buried_heavy_area_angstrom2": Score("the same as if there were no hydrogens", 1),
        "buried_polar_1_angstrom2": Score("of it polar, of the first side"),
        "buried_apolar_1_angstrom2": Score("of it apolar, of the first side"),
        "buried_polar_2_angstrom2": Score("of it polar, of the second side"),
        "buried_apolar_2_angstrom2": Score("of it apolar, of the second side"),
        "shape_complementarity": Score("Sc of Lawrence and Colman", 1),
        "packing": Score("share of the volume between the sides that atoms fill", 1),
        "hydrogen_bonds": Score("hydrogen bonds across", 1, whole=True),
        "salt_bridges": Score("salt bridges across", 1, whole=True),
        "unsatisfied_polar_atoms": Score(
            "N and O that the other side buries, without a hydrogen bond", -1, whole=True
        ),
        "clashes": Score("clashes across", -1, whole=True),
        "contacts": Score("pairs of residues in contact", 1, whole=True),
        "residues_1": Score("residues of the first side in contact", whole=True),
        "residues_2": Score("residues of the second side in contact", whole=True),
        "contacts_per_residue": Score("residues across that a residue in contact touches", 1),
    }
)
"""Columns of a scored interface, in the order of tables."""
MAKEUP: Mapping[str, Score] = MappingProxyType(
    {
        f"{key}_percent_{k}": Score(f"{what}, {side} side", better)
        for k, side in ((1, "first"), (2, "second"))
        for key, what, better in (
            ("hydrogen_bonds", "hydrogen bonds across for 100 residues in contact", 1),
            ("unsatisfied", "unsatisfied polar atoms for 100 residues in contact", -1),
            ("hydrophobic", "residues in contact that are one of ACFILMPVWY", 1),
            ("contact_helix", "residues in contact in helices", 0),
            ("contact_sheet", "residues in contact in sheets", 0),
            ("contact_loop", "residues in contact in loops", 0),
            ("helix", "residues in helices", 0),
            ("sheet", "residues in sheets", 0),
            ("loop", "residues in loops", 0),
        )
    }
)
"""Columns of the composition of the sides, in percent."""
RESIDUES = ("contact_residues_1", "contact_residues_2")
"""Columns of rows: residues of either side in contact."""
CONFIDENCES: Mapping[str, Score] = MappingProxyType(
    {
        "interface_plddt": Score("pLDDT of the residues in contact", 1),
        "iptm": Score("ipTM of the two sides", 1),
        "pae_angstrom": Score("mean predicted aligned error between the sides", -1),
        "ipsae": Score("ipSAE, the larger of both directions", 1),
        "pdockq": Score("pDockQ", 1),
        "pdockq2": Score("pDockQ2, the larger of both directions", 1),
    }
)
"""Columns of predicted models."""
_NEAR = 0.9  # nm from the other side within which the area of an atom may change, and its neighbours matter.
_PROBE, _POINTS = 0.14, 960  # nm, and points of each atom: Shrake, Rupley, J. Mol. Biol. 79:351 (1973).
_ONE_PLACE = 2e-5  # nm apart: mdtraj treats atoms within 1e-5 as one place.
_HIDDEN = 1.0  # angstrom^2 of accessible area, including its hydrogens, below which a polar atom is buried.
_HYDROPHOBIC = ("ALA", "CYS", "PHE", "ILE", "LEU", "MET", "PRO", "VAL", "TRP", "TYR")
"""BindCraft's: Pacesa et al., Nature 646:483 (2025)."""
_APOLAR = ("C", "S", "SE", "F", "CL", "BR", "I")
_SOLVATED = ("generalised_born", "surface")
_NONBONDED = ("lennard_jones", "coulomb", *_SOLVATED)
_DOCKQ, _DOCKQ_REACH = (0.724, 152.611, 0.052, 0.018), 0.8
"""Of pDockQ: L, x0, k, b, and nm between C-betas in contact. Bryant, Pozzati, Elofsson, Nat. Commun.
13:1265 (2022)."""
_DOCKQ2, _DOCKQ2_ERROR = (1.31, 84.733, 0.075, 0.005), 10.0
"""pDockQ2: L, x0, k, b, and angstrom. Zhu, Shenoy, Kundrotas, Elofsson, Bioinformatics 39:btad424 (2023)."""
_SAE_ERROR = 10.0
"""Angstrom of predicted error below which ipSAE counts a pair: the default of Dunbrack's program."""


@document_fields
@dataclass(frozen=True, eq=False)
class Interface(Value):
    """Scores of an interface.

    Examples
    --------
    >>> pc.score_interface("structures/3i40.pdb", "A", "B").scores["buried_area_angstrom2"] > 0.0
    True
    """

    structure: Structure  # Complex that was scored.
    energy_function: Energy  # Energy of the complex.
    first: str  # First side, as in the call.
    second: str  # Second side, as in the call.
    # The keys of ``SCORES``, ``MAKEUP`` and ``CONFIDENCES``, None without anything to measure.
    scores: Mapping[str, Any]
    # A row for each residue in contact or with buried area: ``side`` (1 or 2), ``chain``, ``residue``,
    # ``name``, its shares of the energy (``energy_kj_mol``, ``interaction_kj_mol``, ``desolvation_kj_mol``),
    # ``buried_area_angstrom2``, and how many contacts, hydrogen bonds, salt bridges, clashes and unsatisfied
    # polar atoms it has.
    residues: "pd.DataFrame"
    shares: Floats  # (nr,) float, kJ/mol: Share of the energy of binding of every residue.

    def __post_init__(self) -> None:
        object.__setattr__(self, "scores", MappingProxyType(dict(self.scores)))

    @property
    def name(self) -> str:
        """The two sides, as ``A,B:C``."""
        return f"{self.first}:{self.second}"

    def record(self) -> dict[str, Any]:
        """Flat row: structure, sides, scores, and the residues of either side in contact, as ``A5,A8``."""
        touching = self.residues[self.residues["contacts"] > 0]
        names = touching["chain"] + touching["residue"]
        row = {"structure": self.structure.name, "interface": self.name, **self.scores}
        return row | {key: ",".join(names[touching["side"] == k]) for k, key in enumerate(RESIDUES, 1)}

    def __repr__(self) -> str:
        scores = self.scores
        sc = scores["shape_complementarity"]
        return (
            f"<Interface {self.name} of {self.structure.name}: {scores['energy_kj_mol']:.1f} kJ/mol, "
            f"{scores['buried_area_angstrom2']:.0f} angstrom^2, Sc {'-' if sc is None else f'{sc:.2f}'}, "
            f"{scores['hydrogen_bonds']} hydrogen bonds, {scores['contacts']} contacts>"
        )

    def _repr_html_(self) -> str:
        words = {**SCORES, **MAKEUP, **CONFIDENCES}
        rows = {words[key].what: value for key, value in self.scores.items()}
        return facts(f"Interface {self.name} of {self.structure.name}", rows)


@check_arguments(
    first=text, second=text, forcefield=file_name, solvent=text, salt=concentration,
    energy=optional(an_energy),
)  # fmt: skip
def score_interface(
    source: Any,
    first: str,
    second: str,
    *,
    forcefield: str | None = None,
    solvent: str | None = None,
    salt: float | None = None,
    energy: Energy | None = None,
    **settings: Any,
) -> Interface:
    """Score the interface of two rigid sides of a complex, read without changes.

    Parameters
    ----------
    source : Structure, path, or anything that :func:`protochain.as_structure` takes
        Complex. Relax it first if it has clashes. Files of predictors next to a model are read too.
    first, second : str
        Chains of either side, as ``"A"`` or ``"A,B"``, with the molecules of the same chain names. Or
        selections in the language of MDAnalysis, as ``"resname LIG"``, whose residues the other side's chains
        do not have. Waters count for neither side. Other molecules are skipped.
    forcefield, solvent, salt : optional
        As for :func:`protochain.energy`.
    energy : Energy, optional
        In place of the energy of this force field and solvent. The native engine must support its System. By
        default the energy of a result.
    **settings
        Options of :func:`protochain.load`, for a file.

    Returns
    -------
    Interface
        Scores, and a row for each residue. If the sides do not touch, areas and counts are 0, and
        ``shape_complementarity`` is None. Confidences are None unless the complex is a predicted model.

    Raises
    ------
    ProtochainError
        If a side cannot be read or is empty, a residue is on both, or the engine has no kernel for a force.

    Notes
    -----
    Hydrogen bonds (Baker, Hubbard) and areas (Shrake, Rupley, with a probe of 1.4 angstrom and Bondi's radii)
    are by mdtraj. Sc follows Lawrence and Colman, J. Mol. Biol. 234:946 (1993). Residues in contact
    have heavy atoms within 5 angstrom.

    Examples
    --------
    >>> pc.score_interface("structures/3i40.pdb", "A", "B").scores["hydrogen_bonds"]
    7
    """
    structure = as_structure(source, **without_none(forcefield=forcefield), **settings)
    parts = sides(structure, first, second)
    options = without_none(forcefield=forcefield, solvent=solvent, salt=salt)
    function = as_energy(energy, structure, source, **options)
    paths = confidence_files(Path(source)) if isinstance(source, str | Path) else ()
    return score_sides(structure, as_native(function), first, second, parts, read_scores(paths))


def as_native(energy: Energy) -> NativeEnergy:
    """Return the energy by the native engine, which alone has terms. Raise ProtochainError for others."""
    by_kernels = native_of(energy)
    if by_kernels is None:
        raise ProtochainError(f"interface: is scored by the native engine alone, not by: {energy.reason}")
    return by_kernels


def score_sides(
    structure: Structure, energy: NativeEnergy, first: str, second: str, parts: Sides,
    metrics: Confidence | None = None,
) -> Interface:  # fmt: skip
    """Score an interface whose sides (nr,) and energy are known, with the confidence of a model."""
    import pandas as pd

    touching = contacts(structure, *parts)
    buried, areas = _buried_areas(structure, parts)
    groups = (
        _energy_scores(structure, energy, parts), buried, _contact_scores(structure, touching),
        _bond_scores(structure, parts, *areas),
    )  # fmt: skip
    values: dict[str, Any] = {**_confidences(structure, parts, touching, metrics)}
    for group in groups:
        values |= group.scores
    values |= _makeup(structure, parts, touching, values)
    binding, area, n = values["energy_kj_mol"], values["buried_area_angstrom2"], len(np.unique(touching))
    values["energy_per_area_kj_mol_nm2"] = binding / area * ANGSTROM_PER_NM**2 if area else None
    values["energy_per_residue_kj_mol"] = binding / n if n else None
    scores = {key: values[key] for key in (*SCORES, *MAKEUP, *CONFIDENCES)}
    scores = {key: value if value is None or np.isfinite(value) else None for key, value in scores.items()}
    columns = {
        "side": np.where(parts[0], 1, 2), "chain": structure.residue_chain,
        "residue": np.char.add(structure.residue_number, structure.residue_insertion_code),
        "name": structure.residue_name_in_file,
    }  # fmt: skip
    table = pd.DataFrame(columns | {key: column for kind in groups for key, column in kind.columns.items()})
    shown = (table["contacts"] > 0) | (table["buried_area_angstrom2"] > 0.0)
    shares = table["energy_kj_mol"].to_numpy()
    return Interface(structure, energy, first, second, scores, table[shown].reset_index(drop=True), shares)


class _Scored(NamedTuple):
    """Scores, and columns (nr,) of the table of residues, of one kind."""

    scores: dict[str, Any]
    columns: dict[str, Floats | Integers]


def _energy_scores(structure: Structure, energy: NativeEnergy, parts: Sides) -> _Scored:
    """Energy between the sides, by term, and the cost of desolvation."""
    between, desolvation = interaction(structure, energy, structure.positions, *parts)
    terms = dict(zip(TERMS, between.sum(axis=1).tolist(), strict=True))
    shares = (between + desolvation).sum(axis=0)
    scores = {
        "energy_kj_mol": float(shares.sum()), "interaction_kj_mol": float(between.sum()),
        **{f"{name}_kj_mol": terms[name] for name in ("lennard_jones", "coulomb", "generalised_born")},
        "bonded_kj_mol": sum(value for name, value in terms.items() if name not in _NONBONDED),
        "desolvation_kj_mol": float(desolvation.sum()),
        **{f"energy_{k}_kj_mol": float(shares[side].sum()) for k, side in enumerate(parts, 1)},
    }  # fmt: skip
    return _Scored(scores, {
        "energy_kj_mol": shares, "interaction_kj_mol": between.sum(axis=0),
        "desolvation_kj_mol": desolvation.sum(axis=0),
    })  # fmt: skip


def _buried_areas(structure: Structure, parts: Sides) -> tuple[_Scored, tuple[Floats, Floats]]:
    """Areas that the sides lose, their fit, and the remaining and lost areas of atoms (na,)."""
    residue_of = structure.atom_residue
    # All but carbon, sulphur, selenium, halogens and their hydrogens.
    polar = ~np.isin(np.char.upper(structure.atom_element[_parents(structure)]), _APOLAR)
    masks = [part[residue_of] for part in parts]
    together, lost = _areas(structure, *masks)
    heavy = [mask & (structure.atom_element != "H") for mask in masks]
    spheres = [(ANGSTROM_PER_NM * structure.positions[side], united_radii(structure)[side]) for side in heavy]
    scores = {
        "buried_area_angstrom2": float(lost.sum()),
        "buried_heavy_area_angstrom2": float(_areas(structure, *heavy)[1].sum()),
        "packing": packing(*spheres[0], *spheres[1]),
        **{
            f"buried_{kind}_{k + 1}_angstrom2": float(lost[masks[k] & atoms].sum())
            for k in (0, 1) for kind, atoms in (("polar", polar), ("apolar", ~polar))
        },
        "shape_complementarity": shape_complementarity(
            structure, structure.positions, *map(np.flatnonzero, masks)
        ),
    }  # fmt: skip
    column = np.bincount(residue_of, lost, structure.n_residues)
    return _Scored(scores, {"buried_area_angstrom2": column}), (together, lost)


def _contact_scores(structure: Structure, touching: Integers) -> _Scored:
    sides_of = [len(np.unique(side)) for side in touching.T]
    scores = {
        "contacts": len(touching), "residues_1": sides_of[0], "residues_2": sides_of[1],
        "contacts_per_residue": 2.0 * len(touching) / sum(sides_of) if sum(sides_of) else None,
    }  # fmt: skip
    return _Scored(scores, {"contacts": _count_by_residue(touching, structure)})


def _makeup(
    structure: Structure, parts: Sides, touching: Integers, row: Mapping[str, Any]
) -> dict[str, float | None]:
    """Columns of ``MAKEUP``: shares of amino acids, None for a side without any."""
    fold, scores = secondary_structure(structure), dict[str, float | None]()
    for k, part in enumerate(parts):
        near = np.unique(touching[:, k])
        scale = 100.0 / len(near) if len(near) else None
        counts = {"hydrogen_bonds": row["hydrogen_bonds"], "unsatisfied": row["unsatisfied_polar_atoms"]}
        shares = {key: None if scale is None else scale * n for key, n in counts.items()}
        amino = near[fold[near] != ""]
        shares["hydrophobic"] = _percent(np.isin(structure.residue_name[amino], _HYDROPHOBIC))
        for kind, name in (("helix", "helix"), ("sheet", "strand"), ("loop", "loop")):
            shares[f"contact_{kind}"] = _percent(fold[amino] == name)
            shares[kind] = _percent(fold[part & (fold != "")] == name)
        scores |= {f"{key}_percent_{k + 1}": value for key, value in shares.items()}
    return scores


def _percent(mask: NDArray[np.bool_]) -> float | None:
    return 100.0 * float(mask.mean()) if len(mask) else None


def _bond_scores(structure: Structure, parts: Sides, together: Floats, lost: Floats) -> _Scored:
    """Hydrogen bonds, salt bridges and clashes across, and polar atoms that are buried without a bond."""
    residue_of = structure.atom_residue
    masks = [part[residue_of] for part in parts]
    bonds = hydrogen_bonds(structure)
    bonds = bonds[(masks[0] | masks[1])[bonds].all(axis=1)]
    clashing = clashes(structure).pairs
    residues: dict[str, Integers | Sequence[tuple[int, int]]] = {
        "hydrogen_bonds": residue_of[bonds[_across(masks, bonds[:, [0, 2]])][:, [0, 2]]],
        "salt_bridges": [pair for pair in salt_bridges(structure) if _across(parts, np.array([pair]))[0]],
        "clashes": residue_of[clashing[_across(masks, clashing)]],
        "unsatisfied_polar_atoms": residue_of[_unsatisfied_atoms(structure, together, lost, bonds)],
    }
    return _Scored(
        {key: len(rows) for key, rows in residues.items()},
        {key: _count_by_residue(rows, structure) for key, rows in residues.items()},
    )


def _count_by_residue(residues: Integers | Sequence[tuple[int, int]], structure: Structure) -> Integers:
    """How often each residue is among some, (nr,)."""
    return np.bincount(np.array(residues, dtype=np.int64).ravel(), minlength=structure.n_residues)


def _across(parts: Sequence[NDArray[np.bool_]], pairs: Integers) -> NDArray[np.bool_]:
    """Whether one of each pair (n, 2) is of one part, and the other of the other."""
    (a, b), (i, j) = parts, pairs.reshape(-1, 2).T
    return np.asarray((a[i] & b[j]) | (b[i] & a[j]))


def _within(x: Floats, a: NDArray[np.bool_], b: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(na,) bool: atoms of one mask that are near one of the other."""
    near = np.zeros(len(x), dtype=bool)
    if a.any() and b.any():
        near[a] = cKDTree(x[b]).query(x[a], distance_upper_bound=_NEAR)[0] < _NEAR
    return near


def _areas(structure: Structure, a: NDArray[np.bool_], b: NDArray[np.bool_]) -> tuple[Floats, Floats]:
    """(na,), (na,) float, angstrom^2: accessible areas with both sides present, and the loss of each atom."""
    x = structure.positions
    changing = [_within(x, a, b), _within(x, b, a)]
    together, alone = np.zeros(len(x)), np.zeros(len(x))
    if not changing[0].any():
        return together, alone
    around = [_within(x, side, near) for side, near in zip((a, b), changing, strict=True)]
    trajectory = to_mdtraj(structure)
    for side, near_side in zip(changing, around, strict=True):
        alone[side] = _area(trajectory, near_side)[side]
    affected = changing[0] | changing[1]
    together[affected] = _area(trajectory, around[0] | around[1])[affected]
    return together, np.maximum(alone - together, 0.0)


def _area(trajectory: Any, mask: NDArray[np.bool_]) -> Floats:
    """(na,) float, angstrom^2: accessible areas of some atoms of a trajectory without the others."""
    import mdtraj

    areas, atoms = np.zeros(len(mask)), np.flatnonzero(mask)
    # Of two atoms in one place, for which mdtraj ends the process, one has the area.
    doubled = cKDTree(trajectory.xyz[0][atoms]).query_pairs(_ONE_PLACE, output_type="ndarray")[:, 1]
    atoms = np.delete(atoms, doubled)
    accessible = mdtraj.shrake_rupley(trajectory.atom_slice(atoms), _PROBE, _POINTS)[0]
    areas[atoms] = ANGSTROM_PER_NM**2 * accessible
    return areas


def _parents(structure: Structure) -> Integers:
    """(na,) int: of a hydrogen the atom that bears it, of others themselves."""
    is_h, parents = structure.atom_element == "H", np.arange(structure.n_atoms)
    ends = both_ways(structure.bonds)
    ends = ends[is_h[ends[:, 0]] & ~is_h[ends[:, 1]]]
    parents[ends[:, 0]] = ends[:, 1]
    return parents


def _unsatisfied_atoms(structure: Structure, together: Floats, lost: Floats, bonds: Integers) -> Integers:
    """(n,) int: N and O, accessible without the other side, that it buries, and without a bond."""
    parents, n, element = _parents(structure), structure.n_atoms, structure.atom_element
    hydrogens = np.bincount(parents, minlength=n) - 1
    degree = np.bincount(structure.bonds.ravel(), minlength=n)
    # A nitrogen with three bonds and no hydrogen, as of proline, neither gives nor takes.
    candidates = (element == "O") | ((element == "N") & ((hydrogens > 0) | (degree < 3)))
    remaining, before = np.bincount(parents, together, n), np.bincount(parents, together + lost, n)
    candidates &= (remaining < _HIDDEN) & (before >= _HIDDEN)
    candidates[bonds[:, [0, 2]]] = False
    return np.flatnonzero(candidates)


def _confidences(
    structure: Structure, parts: Sides, touching: Integers, metrics: Confidence | None
) -> dict[str, float | None]:
    """Columns of ``CONFIDENCES``, for a model identified by its header or confidence files."""
    if metrics is None and "_ma_" not in structure.header:
        return dict.fromkeys(CONFIDENCES)
    heavy = structure.atom_element != "H"
    per_residue = means_by(structure.atom_residue[heavy], structure.b_factor[heavy], structure.n_residues)
    # Some programs write shares.
    scale = 100.0 if np.nanmax(per_residue, initial=0.0) <= 1.0 else 1.0
    near, plddt = _near_betas(structure, parts), scale * structure.b_factor
    values: dict[str, float | None] = {
        **dict.fromkeys(CONFIDENCES),
        "interface_plddt": scale * float(per_residue[np.unique(touching)].mean()) if len(touching) else None,
        "pdockq": _docking(_DOCKQ, plddt, near, np.log10(max(len(near), 1))),
    }
    if metrics is None or structure.origin is None:
        return values
    atoms = structure.origin.atoms
    chains = [*dict.fromkeys(atom.split("/", 1)[0] for atom in atoms)]
    values["iptm"] = metrics.mean_iptm(chains, *({*structure.residue_chain[part].tolist()} for part in parts))
    return values | _of_errors(structure, parts, near, plddt, metrics, atoms)


def _of_errors(
    structure: Structure, parts: Sides, near: Integers, plddt: Floats, metrics: Confidence,
    atoms: Sequence[str],
) -> dict[str, float | None]:  # fmt: skip
    """Columns from the predicted errors of amino acids and nucleotides. Other residues have no frame."""
    pae, tokens = metrics.pae, metrics.tokens(atoms)
    numbers = np.char.add(structure.residue_number, structure.residue_insertion_code).tolist()
    keys = zip(structure.residue_chain.tolist(), numbers, strict=True)
    token = np.array([tokens.get(key, -1) for key in keys], dtype=np.int64)
    nucleic = np.isin(structure.residue_name, [*NUCLEOTIDES])
    framed = nucleic.copy()
    framed[structure.atom_residue[(structure.atom_name == "CA") & ~structure.kept]] = True
    first, second = (token[part & framed & (token >= 0)] for part in parts)
    if pae is None or not (len(first) and len(second)):
        return {}
    least = 2.0 if any(nucleic[part].any() for part in parts) else 1.0
    errors = pae[np.ix_(first, second)], pae[np.ix_(second, first)]
    ends = token[structure.atom_residue[near]]
    near_errors = [pae[ends[:, a], ends[:, 1 - a]] for a in (0, 1)]
    return {
        "pae_angstrom": float(np.mean([block.mean() for block in errors])),
        "ipsae": max(ipsae(block, least) for block in errors),
        "pdockq2": max(
            _docking(_DOCKQ2, plddt, near, (1.0 / (1.0 + (block / _DOCKQ2_ERROR) ** 2)).mean())
            for block in near_errors
        ) if len(near) else 0.0,
    }  # fmt: skip


def ipsae(errors: Floats, least: float = 1.0) -> float:
    """IpSAE of one side aligned, the other scored, by errors (n, m), angstrom (Dunbrack, bioRxiv 2025)."""
    is_low = errors < _SAE_ERROR
    n = is_low.sum(axis=1)
    scale = np.maximum(least, 1.24 * np.cbrt(np.maximum(n, 26) - 15) - 1.8)
    scores = np.where(is_low, 1.0 / (1.0 + (errors / scale[:, None]) ** 2), 0.0).sum(axis=1)
    return float((scores / np.maximum(n, 1)).max())


def _near_betas(structure: Structure, parts: Sides) -> Integers:
    """(n, 2) int: C-betas of either side in contact, C-alphas of glycines."""
    names, residue_of = structure.atom_name, structure.atom_residue
    glycine = structure.residue_name[residue_of] == "GLY"
    beta = ~structure.kept & np.where(glycine, names == "CA", names == "CB")
    atoms = [np.flatnonzero(beta & part[residue_of]) for part in parts]
    if not all(map(len, atoms)):
        return np.empty((0, 2), dtype=np.int64)
    first, second = (cKDTree(structure.positions[side]) for side in atoms)
    pairs = first.sparse_distance_matrix(second, _DOCKQ_REACH, output_type="ndarray")
    return np.column_stack([atoms[0][pairs["i"]], atoms[1][pairs["j"]]])


def _docking(curve: tuple[float, float, float, float], plddt: Floats, near: Integers, factor: float) -> float:
    """PDockQ or pDockQ2 by its curve, 0 without contacts, as in the programs."""
    if not len(near):
        return 0.0
    top, middle, slope, base = curve
    x = float(plddt[np.unique(near)].mean()) * factor
    return float(top / (1.0 + np.exp(-slope * (x - middle))) + base)
