"""Quality of a model of a complex: DockQ of its interfaces, and the places of its ligands."""

import itertools
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from difflib import SequenceMatcher
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.spatial import cKDTree

from protochain.core.arrays import Integers, Value
from protochain.core.checks import check_arguments
from protochain.core.errors import ProtochainError
from protochain.core.graph import components, group_members
from protochain.core.lazy_pandas import pd
from protochain.core.optional_libraries import library
from protochain.core.units import ANGSTROM_PER_NM
from protochain.structure import Structure
from protochain.structure.matching import Match, matches, pair_atoms, structure_to_measure
from protochain.structure.molecule.residues import NUCLEOTIDES, STANDARD
from protochain.structure.select import is_water, sides, touching_chains
from protochain.structure.superpose import deviation_angstrom, motion, rmsd_angstrom
from protochain.validation.interface import Score, Sides
from protochain.validation.likeness import preserved_distances

QUALITY: Mapping[str, Score] = MappingProxyType(
    {
        "dockq": Score("DockQ of the interface", 1),
        "fnat": Score("share of the reference's contacts that the model has", 1),
        "irms_angstrom": Score("RMSD of the backbone at the interface", -1),
        "lrms_angstrom": Score("RMSD of the smaller side's backbone, with the larger superposed", -1),
        "lddt": Score("lDDT of the whole model", 1),
        "lddt_pli": Score("lDDT of contacts of ligands with the protein", 1),
        "ligand_rmsd_angstrom": Score("RMSD of ligands, with the pocket superposed", -1),
    }
)
"""Columns of the quality of complexes."""
DOCKING: Mapping[str, Score] = MappingProxyType(
    {
        "ca_rmsd_1_angstrom": Score("C-alpha RMSD of the first side, superposed by itself", -1),
        "ca_rmsd_2_angstrom": Score("C-alpha RMSD of the second side, superposed by itself", -1),
        "hotspot_rmsd_angstrom": Score("C-alpha RMSD of the second side, with the first superposed", -1),
        **QUALITY,
    }
)
"""Columns of an interface with a reference."""
HEADINGS: Mapping[str, str] = MappingProxyType(
    {
        "dockq": "DockQ", "fnat": "fnat", "irms_angstrom": "iRMS", "lrms_angstrom": "LRMS", "lddt": "lDDT",
        "lddt_pli": "lDDT-PLI", "ligand_rmsd_angstrom": "ligand RMSD",
    }
)  # fmt: skip
"""Headings of the terminal."""
Mask = NDArray[np.bool_]
EXTRA = "quality"
"""Extra of the package with peppr."""
_CONTACT = 0.5  # nm between heavy atoms of residues in contact: Basu, Wallner, PLoS ONE 11:e0161879 (2016).
_POCKET = 1.0  # nm from a ligand within which residues are of its pocket, as in DockQ 2.
_SAME_STRAND = 0.8  # Least share of equal nucleotides of corresponding strands.
_MOST_ORDERS = 10_000  # Numberings of a symmetric ligand that are tried.


@check_arguments()
def complex_quality(reference: Any, model: Any) -> dict[str, Any]:
    """Measure the quality of a model of a complex: DockQ of interfaces, and RMSD and lDDT of ligands.

    Parameters
    ----------
    reference, model : Structure, path, or anything that :func:`protochain.as_structure` accepts
        Complexes, with chains in any order and under any names.

    Returns
    -------
    dict
        Means over interfaces: ``dockq``, ``fnat``, ``irms_angstrom``, ``lrms_angstrom``. The ``lddt`` of all
        amino acids. Means over ligands: ``lddt_pli``, ``ligand_rmsd_angstrom``. ``chain_mapping`` as in
        :func:`protochain.rmsd`, but a symmetric complex has the order that its ligands fit best. Tables
        (pandas.DataFrame) ``interfaces``, with a row for each pair of chains that are in contact in the
        reference and present in the model, and ``ligands``. Ligands with other atoms or bonds are skipped.
        Numbers are None without anything to measure.

    Raises
    ------
    ProtochainError
        If peppr is not installed, nothing matches, or the sequences are unrelated.

    Notes
    -----
    DockQ (Mirabello, Wallner, Bioinformatics 40:btae586, 2024) and lDDT-PLI (Robin et al., Proteins 91:1811,
    2023) are by peppr. Ligands are matched by their bonds, with the numbering of least RMSD.

    Examples
    --------
    >>> round(pc.complex_quality("structures/3i40.pdb", "structures/3i40.pdb")["dockq"], 3)
    1.0
    """
    reference, model = structure_to_measure(reference), structure_to_measure(model)
    pairing = Pairing.of(reference, model)
    ends = zip((reference, model), pairing.atoms.T, strict=True)
    names = dict(zip(*(s.residue_chain[s.atom_residue[k]] for s, k in ends), strict=True))
    rows = []
    for first, second in touching_chains(reference):
        if values := pairing.dockq([reference.residue_chain == name for name in (first, second)]):
            model_interface = f"{names[first]}:{names[second]}"
            rows.append({"interface": f"{first}:{second}", "model_interface": model_interface, **values})
    interfaces = pd.DataFrame(rows, columns=["interface", "model_interface", *[*QUALITY][:4]])
    ligands = pd.DataFrame(pairing.ligand_rows, columns=["ligand", "model_ligand", *[*QUALITY][5:]])
    means = {**interfaces.mean(numeric_only=True), **ligands.mean(numeric_only=True), "lddt": pairing.lddt}
    numbers = {key: _plain(means.get(key)) for key in QUALITY}
    mapping = pairing.matched.chain_mapping
    return numbers | {"chain_mapping": mapping, "interfaces": interfaces, "ligands": ligands}


def is_complex(reference: Structure) -> bool:
    """Whether a reference has interfaces or ligands to measure. Without peppr, warn and return False."""
    if len(reference.alpha_carbons) == _is_heavy(reference).sum():  # Only C-alphas.
        return False
    if not (touching_chains(reference) or _molecules(reference)):
        return False
    try:
        library("peppr", EXTRA)
    except ProtochainError as error:
        warnings.warn(f"without DockQ, as {error}", stacklevel=3)
        return False
    return True


def docking(pairing: "Pairing", first: str, second: str) -> dict[str, float | None]:
    """Columns ``DOCKING`` of two sides of a model. Sides without amino acids have no C-alpha RMSD."""
    reference, model = pairing.reference, pairing.model
    masks = pairing.reference_sides(sides(model, first, second))
    is_alpha = reference.atom_name[pairing.atoms[:, 0]] == "CA"
    i, j = (pairing.atoms[is_alpha & mask[pairing.residues]].T for mask in masks)
    x, fixed, moved, mobile = (
        s.positions[k] for pairs in (i, j) for s, k in zip((model, reference), pairs[::-1], strict=True)
    )
    turn, shift = motion(x, fixed)
    values = [rmsd_angstrom(x, fixed), rmsd_angstrom(moved, mobile)]
    values.append(deviation_angstrom(moved @ turn.T + shift, mobile) if len(x) else np.nan)
    rows = [row for row in pairing.ligand_rows if (masks[0] | masks[1])[row["residue"]]]
    means = pd.DataFrame(rows, columns=[*QUALITY][5:]).astype(float).mean().to_dict()
    columns = dict(zip(DOCKING, values, strict=False)) | pairing.dockq(masks) | means | {"lddt": pairing.lddt}
    return {key: _plain(columns.get(key)) for key in DOCKING}


def _plain(value: float | None) -> float | None:
    return None if value is None or not np.isfinite(value) else float(value)


@dataclass(frozen=True, eq=False)
class Pairing(Value):
    """Corresponding heavy atoms of a reference and a model, as indices (n, 2) of both."""

    reference: Structure
    model: Structure
    matched: Match
    atoms: Integers  # Of proteins and strands.
    ligands: tuple[tuple[Integers, float], ...]  # With RMSDs in angstrom, the pocket superposed.

    @classmethod
    def of(cls, reference: Structure, model: Structure) -> "Pairing":
        """Pair atoms of matched residues by name. Pair other molecules by their bonds and places.

        The chains of a symmetric complex are in the order in which most ligands are in place.
        """
        molecules, pairings = [_molecules(s) for s in (reference, model)], list[Pairing]()
        numberings = _numberings(reference, model, *molecules)
        is_strand = [_is_nucleic(reference)[atoms[0]] for atoms in molecules[0]]
        # Without ligands the least RMSD decides.
        for matched in itertools.islice(matches(reference, model), None if numberings else 1):
            residues = matched.reference, matched.model
            atoms = pair_atoms(reference, model, residues, _is_heavy(reference) & ~reference.kept)
            atoms = atoms[~model.built[atoms[:, 1]]]
            placed = _place_molecules(reference, model, atoms, molecules[0], numberings)
            strands = [pairs for i, (pairs, _) in placed.items() if is_strand[i]]
            ligands = tuple(entry for i, entry in placed.items() if not is_strand[i])
            pairings.append(cls(reference, model, matched, np.vstack([atoms, *strands]), ligands))
        return min(pairings, key=lambda pairing: sum(off for _, off in pairing.ligands))

    @property
    def residues(self) -> Integers:
        """(n,) int: residues of the atoms in the reference."""
        return self.reference.atom_residue[self.atoms[:, 0]]

    @cached_property
    def lddt(self) -> float | None:
        """Mean lDDT of the amino acids."""
        preserved = preserved_distances(self.model, self.reference, self.matched)[-1]
        return float(preserved.mean()) if len(preserved) else None

    @cached_property
    def ligand_rows(self) -> list[dict[str, Any]]:
        """RMSD and lDDT-PLI of each ligand, and the index of its first residue in the reference."""
        rows = []
        for pairs, off in self.ligands:
            first, second = self.reference.atom_residue[pairs[0, 0]], self.model.atom_residue[pairs[0, 1]]
            arrays = (self._array(column, [pairs]) for column in (0, 1))
            rows.append({
                "ligand": self.reference.describe_residue(first),
                "model_ligand": self.model.describe_residue(second), "ligand_rmsd_angstrom": off,
                "lddt_pli": library("peppr", EXTRA).LDDTPLIScore().evaluate(*arrays), "residue": int(first),
            })  # fmt: skip
        return rows

    def reference_sides(self, parts: Sides) -> Sequence[Mask]:
        """Residues of the reference that correspond to two sides of the model, (nr,) bool."""
        i, j = np.vstack([self.atoms, *(pairs for pairs, _ in self.ligands)]).T
        side = np.full(self.reference.n_residues, -1)
        of_model = parts[0] + 2 * parts[1]
        side[self.reference.atom_residue[i]] = of_model[self.model.atom_residue[j]]
        # Residues that the model lacks are on the side of the others of their chain.
        for name in np.unique(self.reference.residue_chain):
            of_chain = self.reference.residue_chain == name
            sides_of_chain = {*side[of_chain].tolist()} - {-1}
            if len(sides_of_chain) == 1:
                side[of_chain] = sides_of_chain.pop()
        return side == 1, side == 2

    def dockq(self, masks: Sequence[Mask]) -> dict[str, float]:
        """DockQ and its parts of two sides, as residues (nr,) of the reference. Empty without contacts."""
        s = self.reference
        whole = [np.flatnonzero(_is_polymer(s) & mask[s.atom_residue]) for mask in masks]
        chosen = [mask[self.residues] for mask in masks]
        contacts = _contacts(s, whole, np.arange(s.n_residues))
        if not contacts or not all(map(np.any, chosen)):
            return {}
        # Contacts of the model are of all its atoms, also of atoms that the reference lacks.
        counterpart = np.full(self.model.n_residues, -1)
        counterpart[self.model.atom_residue[self.atoms[:, 1]]] = self.residues
        places = counterpart[self.model.atom_residue]
        matched = _is_polymer(self.model) & (places >= 0)
        present = [np.flatnonzero(matched & mask[places]) for mask in masks]
        of_model = _contacts(self.model, present, counterpart)
        # The larger side is the receptor, of equal sides the second in the reference, as in DockQ.
        sizes = [(len(np.unique(s.atom_residue[atoms])), atoms[0]) for atoms in whole]
        order = (0, 1) if sizes[0] > sizes[1] else (1, 0)
        arrays = [self._array(column)[chosen[side]] for column in (0, 1) for side in order]
        peppr = library("peppr.dockq", EXTRA)
        fnat, off = len(contacts & of_model) / len(contacts), peppr.irmsd(*arrays)
        # A model without the residues of the interface has no RMSD there, which is not a good one.
        parts = peppr.DockQ(fnat, 0.0, off if np.isfinite(off) else np.inf, peppr.lrmsd(*arrays))
        return dict(zip(QUALITY, map(float, (parts.score, fnat, off, parts.lrmsd)), strict=False))

    def _array(self, column: int, ligand: Sequence[Integers] = ()) -> Any:
        """Atoms of one of both for peppr, with names and residues of the reference, and with a ligand."""
        s, pairs = self.reference, np.vstack([self.atoms, *ligand])
        atoms, residue = pairs[:, 0], s.atom_residue[pairs[:, 0]]
        array = library("biotite.structure", EXTRA).AtomArray(len(pairs))
        array.coord = ANGSTROM_PER_NM * (s, self.model)[column].positions[pairs[:, column]]
        array.res_id, array.chain_id = residue, s.residue_chain[residue]
        array.atom_name, array.element = s.atom_name[atoms], s.atom_element[atoms]
        array.chain_id[len(self.atoms) :], array.hetero[len(self.atoms) :] = "~", True
        return array


def _is_heavy(s: Structure) -> Mask:
    """(na,) bool: heavy atoms of the file and of poses, without waters."""
    in_file = ~s.built
    for ligand in s.ligands:  # Poses are of other files.
        in_file[ligand.atoms] |= ligand.posed
    return np.asarray((s.atom_element != "H") & in_file & ~is_water(s)[s.atom_residue])


def _is_nucleic(s: Structure) -> Mask:
    """(na,) bool: atoms of nucleotides."""
    return np.asarray(np.isin(s.residue_name, [*NUCLEOTIDES])[s.atom_residue])


def _is_polymer(s: Structure) -> Mask:
    """(na,) bool: heavy atoms of amino acids and nucleotides."""
    return _is_heavy(s) & np.isin(s.residue_name, [*STANDARD, *NUCLEOTIDES])[s.atom_residue]


def _contacts(s: Structure, parts: Sequence[Integers], number: Integers) -> set[tuple[int, int]]:
    """Pairs of residues, by their numbers (nr,), with atoms of two parts in contact."""
    trees = [cKDTree(s.positions[atoms]) for atoms in parts]
    near = trees[0].sparse_distance_matrix(trees[1], _CONTACT, output_type="ndarray")
    ends = (number[s.atom_residue[atoms[near[key]]]] for atoms, key in zip(parts, "ij", strict=True))
    return {*zip(*(end.tolist() for end in ends), strict=True)}


def _molecules(s: Structure) -> list[Integers]:
    """Heavy atoms of each strand and of each molecule outside the protein, without single atoms."""
    outside, nucleic, names = _is_heavy(s) & s.kept, _is_nucleic(s), s.residue_chain[s.atom_residue]
    strands = [np.flatnonzero(outside & nucleic & (names == name)) for name in np.unique(names[nucleic])]
    # Atoms are in one molecule by bonds, or by their residue.
    neighbours = np.column_stack([np.arange(s.n_atoms - 1), np.arange(1, s.n_atoms)])
    bonds = np.vstack([s.bonds[~s.coordination], neighbours[np.diff(s.atom_residue) == 0]])
    small = outside & ~nucleic
    groups = group_members(components(bonds[small[bonds].all(axis=1)], s.n_atoms))
    return strands + [atoms for group in groups if len(atoms := group[small[group]]) > 1]


def _graph(s: Structure, atoms: Integers) -> Any:
    """Bonds of a molecule as RDKit's. Orders are single: resonance is symmetric."""
    chem = library("rdkit.Chem", EXTRA)
    mol = chem.RWMol()
    for element in s.atom_element[atoms].tolist():
        mol.AddAtom(chem.Atom(element))
    for pair in np.searchsorted(atoms, s.bonds[np.isin(s.bonds, atoms).all(axis=1)]).tolist():
        mol.AddBond(*pair, chem.BondType.SINGLE)
    mol.UpdatePropertyCache(strict=False)
    chem.FastFindRings(mol)
    return mol


def _paired_strands(
    reference: Structure, atoms: Integers, model: Structure, model_atoms: Integers
) -> Integers:
    """Pairs (n, 2) of atoms of two strands, none if their sequences differ."""
    first, second = (np.unique(s.atom_residue[k]) for s, k in ((reference, atoms), (model, model_atoms)))
    names = reference.residue_name[first].tolist(), model.residue_name[second].tolist()
    blocks = SequenceMatcher(None, *names, autojunk=False).get_matching_blocks()
    places = np.array([(a + k, b + k) for a, b, size in blocks for k in range(size)], dtype=np.int64)
    if len(places) < _SAME_STRAND * min(len(first), len(second)):
        return np.empty((0, 2), dtype=np.int64)
    chosen = np.isin(np.arange(reference.n_atoms), atoms)
    pairs = pair_atoms(reference, model, (first[places[:, 0]], second[places[:, 1]]), chosen)
    return pairs[~model.built[pairs[:, 1]]]


def _numberings(
    reference: Structure, model: Structure, molecules: Sequence[Integers], model_molecules: Sequence[Integers]
) -> dict[tuple[int, int], tuple[Integers, Integers]]:
    """Atoms (n,) of molecules i of the reference, and (m, n) of equal ones j of the model, in all orders."""
    sides = (reference, molecules), (model, model_molecules)
    graphs = [
        [None if _is_nucleic(s)[atoms[0]] else _graph(s, atoms) for atoms in group] for s, group in sides
    ]
    numberings = {}
    for (i, graph), (j, other) in itertools.product(*map(enumerate, graphs)):
        order, orders = molecules[i], list[Integers]()
        if graph is None and other is None:
            order, *orders = _paired_strands(reference, order, model, model_molecules[j]).T
        elif graph and other and graph.GetNumAtoms() == other.GetNumAtoms():
            # Molecules of as many atoms and bonds are equal if one contains the other.
            places = other.GetSubstructMatches(graph, uniquify=False, maxMatches=_MOST_ORDERS)
            is_equal = graph.GetNumBonds() == other.GetNumBonds()
            if is_equal and len(places) == _MOST_ORDERS:
                ligand = reference.describe_residue(reference.atom_residue[order[0]])
                warnings.warn(f"{ligand}: too symmetric, so that its RMSD may be too large", stacklevel=4)
            orders = [model_molecules[j][[*place]] for place in places if is_equal]
        if len(order) and orders:
            numberings[i, j] = order, np.array(orders)
    return numberings


def _place_molecules(
    reference: Structure, model: Structure, protein: Integers, molecules: Sequence[Integers],
    numberings: Mapping[tuple[int, int], tuple[Integers, Integers]],
) -> dict[int, tuple[Integers, float]]:  # fmt: skip
    """Pairs (n, 2) of atoms and RMSDs of molecules, assigned by least RMSD with the pocket superposed."""
    motions = {i: _pocket_motion(reference, model, protein, molecules[i]) for i in {i for i, _ in numberings}}
    results = dict[tuple[int, int], tuple[Integers, float]]()
    for place, (order, orders) in numberings.items():
        turn, shift = motions[place[0]]
        square = ((model.positions[orders] @ turn.T + shift - reference.positions[order]) ** 2).sum(axis=2)
        best = int(square.mean(axis=1).argmin())
        distance = ANGSTROM_PER_NM * float(np.sqrt(square[best].mean()))
        results[place] = np.column_stack([order, orders[best]]), distance
    # As many as possible are assigned.
    shape = 1 + np.max([(-1, -1), *results], axis=0)
    cost = np.full(shape, 1.0 + 2.0 * len(molecules) * max((off for _, off in results.values()), default=0.0))
    for place, (_, off) in results.items():
        cost[place] = off
    assigned = zip(*(index.tolist() for index in linear_sum_assignment(cost)), strict=True)
    return {place[0]: results[place] for place in assigned if place in results}


def _pocket_motion(reference: Structure, model: Structure, protein: Integers, atoms: Integers) -> Any:
    """Rotation and translation of the model that superpose the backbone of a pocket, or all."""
    first, second = protein.T
    tree = cKDTree(reference.positions[atoms])
    is_near = tree.query(reference.positions[first], distance_upper_bound=_POCKET)[0] < _POCKET
    backbone = np.isin(reference.atom_name[first], ("N", "CA", "C", "O"))
    residue = reference.atom_residue[first]
    pocket = backbone & np.isin(residue, residue[is_near])
    chosen = pocket if pocket.sum() > 2 else backbone
    return motion(model.positions[second[chosen]], reference.positions[first[chosen]])
