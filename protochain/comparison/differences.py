"""Differences of two structures: torsions, rotamers, hydrogen bonds, salt bridges, contacts, RMSDs."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree

from protochain.comparison.domains import rigid_domains
from protochain.core.arrays import Floats, Integers, Value
from protochain.core.settings import document_fields
from protochain.core.units import ANGSTROM_PER_NM
from protochain.results.columns import heading
from protochain.structure import as_structure
from protochain.structure.matching import Match, match
from protochain.structure.molecule.model import Structure
from protochain.structure.molecule.residues import CHI, Atom
from protochain.structure.superpose import motion, rmsd_angstrom
from protochain.validation.bonding import FOLD, hydrogen_bonds, salt_bridges, secondary_structure
from protochain.validation.layout import NONE, dihedrals, layout, peptides
from protochain.validation.rotamers import side_chains

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CHIS = ("chi1", "chi2", "chi3", "chi4")
TORSIONS = ("phi", "psi", "omega", *CHIS)
_FLIPS = {("ASP", 1), ("GLU", 2), ("PHE", 1), ("TYR", 1)}
"""Residues and last dihedrals (from 0) whose half turns only exchange atom names."""
_CONTACT, _APART = 4.5, 4
"""Angstrom between heavy atoms of residues in contact, and least distance along the chain."""
_RMSD, _TURN, _DOMAIN = "ca_rmsd_angstrom", "turn_degrees", "domain"


@document_fields
@dataclass(frozen=True, eq=False)
class Differences(Value):
    """Changes from one structure to another.

    Examples
    --------
    >>> pc.differences("structures/1ubq.pdb", "structures/1ubq.cif").totals["rotamers_changed"]
    0
    """

    # A row for each matched residue: ``chain``, ``residue``, ``name`` (of the first structure),
    # ``secondary_structure``, ``domain`` (from 1, the largest, or 0 for none), changes of ``phi`` ...
    # ``chi4`` in degrees from -180 to 180, ``torsions_degrees`` (root mean square over these),
    # ``rotamer_before``, ``rotamer_after``, ``ca_moved_angstrom`` after superposition of all C-alphas.
    residues: pd.DataFrame
    # Hydrogen bonds and salt bridges of only one structure: ``kind``, ``change`` (gained or lost), ``first``
    # and ``second``: atoms of donor and acceptor, or residues of cation and anion.
    bonds: pd.DataFrame
    # ``rotamers_changed``, ``hydrogen_bonds_kept``, ``_gained`` and ``_lost``, the same for ``salt_bridges``,
    # ``contacts_kept`` (Q: share of the first structure's contacts in the second), and ``ca_rmsd_angstrom``.
    # Chains, helices, strands, loops and rigid domains are superposed separately for ``ca_rmsd_angstrom_A``,
    # ``_helix``, ``_domain_1`` and so on. ``rigid_domains`` is their number. ``turn_degrees_domain_2`` and so
    # on are the angles of their motions relative to the first domain.
    totals: Mapping[str, Any]

    def __repr__(self) -> str:
        totals = self.totals
        return (
            f"<Differences: C-alpha RMSD {totals['ca_rmsd_angstrom']:.2f} angstrom, "
            f"{totals['rotamers_changed']} rotamers changed, "
            f"hydrogen bonds +{totals['hydrogen_bonds_gained']} -{totals['hydrogen_bonds_lost']}, "
            f"Q {totals['contacts_kept']:.2f}>"
        )

    def plot(self) -> "Figure":
        """Plot changes of backbone and side chains, and displacements of C-alphas, along the sequence."""
        from protochain.comparison.plots import plot_differences

        return plot_differences({"": self.residues})


def of_ends(ends: Mapping[str, Structure]) -> dict[str, Differences]:
    """Differences of ends from a start, the first of them. Empty without amino acids."""
    (_, start), *other_ends = ends.items()
    if not layout(start).amino.any():
        return {}
    return {name: differences(start, end) for name, end in other_ends}


def totals_of(changes: Mapping[str, Differences]) -> pd.DataFrame:
    """Totals of several differences: a column for each after ``quantity``, the name in words."""
    keys = dict.fromkeys(key for difference in changes.values() for key in difference.totals)
    rows = [
        {
            "quantity": _in_words(key),
            **{name: difference.totals.get(key) for name, difference in changes.items()},
        }
        for key in keys
    ]
    return pd.DataFrame(rows, columns=["quantity", *changes])


def _in_words(key: str) -> str:
    """Name in words: ``ca_rmsd_angstrom_helix`` is ``C-alpha RMSD of helix, angstrom``."""
    for quantity in (_RMSD, _TURN):
        part = key.removeprefix(f"{quantity}_")
        if part != key:
            label, _, unit = heading(quantity).partition(", ")
            if not part.startswith(_DOMAIN) and part not in FOLD.values():
                part = f"chain {part}"
            return f"{label} of {part.replace('_', ' ')}, {unit}"
    return heading(key)


def concatenate(changes: Mapping[str, Differences], table: str) -> pd.DataFrame:
    """Concatenate a table, ``residues`` or ``bonds``, of several differences, with names in ``method``."""
    parts = [getattr(difference, table) for difference in changes.values()]
    if not parts:
        return pd.DataFrame(columns=["method"])
    return pd.concat(parts, keys=changes, names=["method"]).reset_index(level=0).reset_index(drop=True)


def differences(before: Any, after: Any) -> Differences:
    """Compare two structures.

    Parameters
    ----------
    before, after : Structure, Solution, path, or anything that :func:`protochain.as_structure` accepts
        Residues are matched as by :func:`protochain.rmsd`. Sequences may differ.

    Returns
    -------
    Differences
        A row for each residue, gained and lost bonds, and totals.

    Raises
    ------
    ProtochainError
        If no residue matches, or the sequences are unrelated.

    Notes
    -----
    A hydrogen bond is a donor, its hydrogen and an acceptor by Baker and Hubbard's criterion, as in
    :func:`protochain.quality`. If all residues correspond, the second count equals the first count minus
    lost plus gained bonds. Secondary structure is by mdtraj's DSSP. Half turns of the last dihedral of Asp,
    Glu, Phe and Tyr do not count. A rigid domain has 20 C-alphas or more that follow one motion within
    2 angstrom: adaptive selection of Wriggers, Schulten, Proteins 29:1 (1997),
    :mod:`protochain.comparison.domains`.

    Examples
    --------
    >>> found = pc.differences("structures/ala10.pdb", "structures/ala10.pdb")
    >>> found.totals["rotamers_changed"]
    0
    """
    first, second = as_structure(before), as_structure(after)
    pairs = match(first, second)
    # Superpose all C-alphas, and find rigid domains.
    turns = _turn_angles(first, second, pairs)
    alphas = [
        layout(s).atoms("CA")[indices, 0] for s, indices in ((first, pairs.reference), (second, pairs.model))
    ]
    has_alpha = (np.array(alphas) != NONE).all(axis=0)
    x, y = first.positions[alphas[0]], second.positions[alphas[1]]
    turn, shift = motion(y[has_alpha], x[has_alpha])
    shifts = np.where(has_alpha, np.linalg.norm(y @ turn.T + shift - x, axis=1) * ANGSTROM_PER_NM, np.nan)
    domains, parts = np.zeros(len(has_alpha), dtype=int), rigid_domains(x[has_alpha], y[has_alpha])
    for k, part in enumerate(parts, 1):
        domains[np.flatnonzero(has_alpha)[part.members]] = k
    names = [_rotamers(s, indices) for s, indices in ((first, pairs.reference), (second, pairs.model))]
    number = np.char.add(first.residue_number, first.residue_insertion_code)
    table = pd.DataFrame(
        {
            "chain": first.residue_chain[pairs.reference], "residue": number[pairs.reference],
            "name": first.residue_name[pairs.reference],
            "secondary_structure": secondary_structure(first)[pairs.reference], "domain": domains,
            **dict(zip(TORSIONS, turns.T, strict=True)),
            "torsions_degrees": _root_mean_square(turns),
            "rotamer_before": names[0], "rotamer_after": names[1], "ca_moved_angstrom": shifts,
        }
    )  # fmt: skip
    # Totals of both structures, of parts, and of domains.
    bonds, counts = _bonds(first, second, pairs)
    is_same = first.residue_name[pairs.reference] == second.residue_name[pairs.model]
    changed = (names[0] != names[1]) & is_same & (names[0] != "") & (names[1] != "")
    totals: dict[str, Any] = {"rotamers_changed": int(changed.sum()), **counts}
    totals["contacts_kept"] = _contacts_kept(first, second, pairs)
    totals["ca_rmsd_angstrom"] = rmsd_angstrom(y[has_alpha], x[has_alpha])
    for column in ("chain", "secondary_structure"):
        for value in dict.fromkeys(table[column]):
            selected = has_alpha & (table[column] == value).to_numpy()
            if selected.sum() > 2:
                totals[f"{_RMSD}_{value or '_'}"] = rmsd_angstrom(y[selected], x[selected])
    totals["rigid_domains"] = len(parts)
    for k, part in enumerate(parts, 1):
        totals[f"{_RMSD}_{_DOMAIN}_{k}"] = part.rmsd * ANGSTROM_PER_NM
        if k > 1:
            totals[f"{_TURN}_{_DOMAIN}_{k}"] = part.turn
    return Differences(table, bonds, totals)


def _turn_angles(first: Structure, second: Structure, matches: Match) -> Floats:
    """(n, 7) float, degrees from -180 to 180: changes of ``TORSIONS``, NaN if one is missing."""
    angles = []
    for s, indices in ((first, matches.reference), (second, matches.model)):
        backbone = np.column_stack(peptides(s, s.positions))
        angles.append(np.column_stack([backbone, _chis(s)])[indices])
    off = (angles[1] - angles[0] + 180.0) % 360.0 - 180.0
    names = first.residue_name[matches.reference]
    off[names != second.residue_name[matches.model], 3:] = np.nan
    for name, chi in _FLIPS:
        flipped = off[names == name, 3 + chi]
        off[names == name, 3 + chi] = (flipped + 90.0) % 180.0 - 90.0
    return np.asarray(off)


def _chis(s: Structure) -> Floats:
    """(nr, 4) float, degrees: chi angles, NaN if missing."""
    atoms, angles = layout(s), np.full((s.n_residues, len(CHIS)), np.nan)
    for name, quadruples in CHI.items():
        residues = np.flatnonzero((s.residue_name == name) & atoms.amino)
        for k, four in enumerate(quadruples[: len(CHIS)]):
            angles[residues, k] = dihedrals(s.positions, atoms.atoms(*four)[residues])
    return angles


def _root_mean_square(off: Floats) -> Floats:
    counts = np.isfinite(off).sum(axis=1)
    return np.asarray(np.sqrt(np.nansum(off**2, axis=1) / np.maximum(counts, 1)))


def _rotamers(s: Structure, residues: Integers) -> np.ndarray:
    """Rotamer of each residue, empty without rotamers or far from all."""
    sides = side_chains(s)
    names = np.zeros(s.n_residues, dtype="U8")
    is_near = ~np.isin(sides.residue, sides.outliers)
    names[sides.residue[is_near]] = sides.rotamer[is_near]
    return np.asarray(names[residues])


def _bonds(first: Structure, second: Structure, matches: Match) -> tuple[pd.DataFrame, dict[str, int]]:
    """Hydrogen bonds and salt bridges of only one structure, and their counts."""
    rows, counts = list[dict[str, str]](), dict[str, int]()
    places = _places(first, second, matches)
    for kind, bonds in (("hydrogen bond", _hydrogen_bonds), ("salt bridge", salt_bridges)):
        before, after = (
            {(int(of[i]), int(of[j]), *names) for i, j, *names in bonds(s) if NONE not in (of[i], of[j])}
            for s, of in zip((first, second), places, strict=True)
        )
        plural = f"{kind.replace(' ', '_')}s"
        counts[f"{plural}_kept"] = len(before & after)
        for change, pairs in (("gained", after - before), ("lost", before - after)):
            counts[f"{plural}_{change}"] = len(pairs)
            rows += [
                {"kind": kind, "change": change, "first": _end(first, i, names[:1]),
                 "second": _end(first, j, names[2:])}
                for i, j, *names in sorted(pairs)
            ]  # fmt: skip
    return pd.DataFrame(rows, columns=["kind", "change", "first", "second"]), counts


def _places(first: Structure, second: Structure, matches: Match) -> tuple[Integers, Integers]:
    """Residues of the first for each residue of the first (nr,) and the second (ns,), or ``NONE``."""
    first_places, second_places = np.full(first.n_residues, NONE), np.full(second.n_residues, NONE)
    first_places[matches.reference] = second_places[matches.model] = matches.reference
    # Alignments have only amino acids: caps, ligands and nucleotides are matched by their names in files.
    unplaced = {first.residue(r): r for r in np.flatnonzero(first_places == NONE).tolist()}
    for r in np.flatnonzero(second_places == NONE).tolist():
        if (place := unplaced.pop(second.residue(r), NONE)) != NONE:
            first_places[place] = second_places[r] = place
    return first_places, second_places


def _hydrogen_bonds(s: Structure) -> set[tuple[Any, ...]]:
    """Residues of donor and acceptor, and names of donor, hydrogen and acceptor."""
    bonds = hydrogen_bonds(s)
    residues, names = s.atom_residue[bonds[:, [0, 2]]].T, s.atom_name[bonds].T
    return set(zip(*residues.tolist(), *names.tolist(), strict=True))


def _end(s: Structure, residue: int, name: list[Any]) -> str:
    """An atom of a residue, or the residue without a name."""
    return str(Atom(name[0], s.residue(residue)) if name else s.residue(residue))


def _contacts_kept(first: Structure, second: Structure, matches: Match) -> float:
    """Share of the first structure's residue contacts in the second, NaN without contacts."""
    place = np.full(second.n_residues, NONE)
    place[matches.model] = matches.reference
    matched = {*matches.reference.tolist()}
    first_pairs = {pair for pair in _contacts(first) if {*pair} <= matched}
    second_pairs = {tuple(sorted((int(place[i]), int(place[j])))) for i, j in _contacts(second)}
    return len(first_pairs & second_pairs) / len(first_pairs) if first_pairs else float("nan")


def _contacts(s: Structure) -> set[tuple[int, int]]:
    atoms = np.flatnonzero((s.atom_element != "H") & layout(s).amino[s.atom_residue])
    pairs = cKDTree(s.positions[atoms] * ANGSTROM_PER_NM).query_pairs(_CONTACT, output_type="ndarray")
    residues = np.unique(np.sort(s.atom_residue[atoms][pairs], axis=1), axis=0)
    chain = s.residue_chain_index[residues]
    far = (residues[:, 1] - residues[:, 0] >= _APART) | (chain[:, 0] != chain[:, 1])
    return {(int(i), int(j)) for i, j in residues[far]}
