"""Ensembles: clusters of frames, their medoids, and fluctuations of residues."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.spatial.distance import squareform

from protochain.batches.frames import ensemble_of
from protochain.chains.setup import Setup
from protochain.core.arrays import Floats, Integers, Value, dihedral, read_only
from protochain.core.checks import check_arguments, in_range, number, one_of, optional, selection
from protochain.core.errors import ProtochainError
from protochain.core.lazy_pandas import pd
from protochain.core.settings import document_fields
from protochain.core.units import ANGSTROM_PER_NM
from protochain.minimisers.solution import alpha_residues
from protochain.structure import Structure
from protochain.structure.molecule.dihedrals import dihedral_finder
from protochain.structure.select import select as chosen
from protochain.structure.superpose import superpose

WITHIN = {"rmsd": 2.0, "torsions": 30.0}
"""angstrom, degrees. Default average distance between the members of a cluster."""
_MOST = 5000  # Frames, as the distances of all pairs are in memory.
_ROUNDS = 3  # Superpositions on the mean, which then moves by less than a thousandth of an angstrom.


@document_fields
@dataclass(frozen=True, eq=False)
class Clusters(Value):
    """Clusters of the frames of an ensemble.

    Examples
    --------
    >>> s = pc.load("structures/ala10.pdb")
    >>> len(pc.cluster_frames(s, np.array([s.positions, 1.1 * s.positions])).fluctuations)
    10
    """

    # A row for each frame: ``frame``, ``cluster`` (from 1, the largest first), ``medoid`` (true for the
    # medoid of a cluster) and ``distance_to_medoid``, angstrom or degrees.
    table: "pd.DataFrame"
    medoids: tuple[Structure, ...]  # The medoid of each cluster.
    # A row for each residue: ``chain``, ``residue``, ``name`` and ``ca_fluctuation_angstrom``. This is the
    # root-mean-square deviation of its C-alpha from the mean of all frames, which are superposed on it.
    fluctuations: "pd.DataFrame"

    @property
    def structure(self) -> Structure:
        """Medoid of the largest cluster."""
        return self.medoids[0]

    @property
    def frames(self) -> Floats:
        """(k, na, 3) float, nm: positions of the medoids."""
        return np.array([medoid.positions for medoid in self.medoids])

    def __repr__(self) -> str:
        return f"<Clusters: {len(self.medoids)} of {len(self.table)} frames>"


@check_arguments(
    by=one_of(tuple(WITHIN)), measure=selection,
    within=optional(in_range(number, lambda w: w >= 0.0, "give angstrom or degrees, none below 0")),
)  # fmt: skip
def cluster_frames(
    top: Any, frames: Any = None, select: Any = None, *, by: str = "rmsd", within: float | None = None,
    measure: str = "name CA", **settings: Any,
) -> Clusters:  # fmt: skip
    """Cluster the frames of an ensemble, and compute the fluctuations of its residues.

    Parameters
    ----------
    top, frames, select : as of :func:`protochain.relax_frames`
        Structure, its frames, and a selection of frames. All of these are read into memory.
    by : str
        ``rmsd`` of the superposed atoms of ``measure``, or ``torsions``, the root mean square of the
        differences of phi and psi.
    within : float, angstrom or degrees, optional
        Average distance at which clusters are cut: 2 angstrom, or 30 degrees.
    measure : str
        Atoms of the RMSD.
    **settings
        Fields of :class:`protochain.Setup`, for a file.

    Returns
    -------
    Clusters
        Clusters by average linkage (scipy). A medoid has the least sum of distances to its cluster.

    Raises
    ------
    ProtochainError
        If there are fewer than 1 or more than 5000 frames, or a frame cannot be used.

    Examples
    --------
    >>> s = pc.load("structures/ala10.pdb")
    >>> pc.cluster_frames(s, np.array([s.positions, s.positions])).table["cluster"].tolist()
    [1, 1]
    """
    setup = Setup(**settings)
    ensemble, frames_read = ensemble_of(top, frames, select, setup)
    if not 0 < len(frames_read) <= _MOST:
        raise ProtochainError(
            f"{frames_read.source}: {len(frames_read)} frames; give 1 to {_MOST}, as every tenth by ::10"
        )
    structure, numbers = ensemble.structure, [*frames_read.chosen]
    alpha, atoms = structure.alpha_carbons, np.flatnonzero(chosen(structure, measure))
    quadruples = _backbone(structure) if by == "torsions" else np.empty((0, 4), dtype=np.int64)
    if by == "torsions" and not len(quadruples):
        raise ProtochainError(f"{structure.name}: has no phi or psi to cluster by; cluster by rmsd")
    x = [ensemble.at(frame).positions for frame in frames_read]
    if by == "torsions":
        distances = _torsion_distances(x, quadruples)
    else:
        distances = ANGSTROM_PER_NM * rmsds([conformer[atoms] for conformer in x])
    labels, medoids = cluster_distances(distances, WITHIN[by] if within is None else within)
    table = pd.DataFrame({
        "frame": numbers, "cluster": labels, "medoid": np.isin(np.arange(len(x)), medoids),
        "distance_to_medoid": distances[np.arange(len(x)), medoids[labels - 1]],
    })  # fmt: skip
    return Clusters(
        table, tuple(structure.with_positions(x[k]) for k in medoids.tolist()),
        alpha_residues(structure).assign(ca_fluctuation_angstrom=fluctuations([frame[alpha] for frame in x])),
    )  # fmt: skip


def rmsds(x: Sequence[Floats]) -> Floats:
    """(m, m) RMSD of all pairs of m superposed sets of points (n, 3), in their unit."""
    points = np.array([frame - frame.mean(axis=0) for frame in x])
    square, distances = np.sum(points**2, axis=(1, 2)), np.zeros((len(points), len(points)))
    for i in range(1, len(points)):
        covariance = np.einsum("na,mnb->mab", points[i], points[:i])
        sums = np.linalg.svd(covariance, compute_uv=False)
        sums[:, 2] *= np.sign(np.linalg.det(covariance))
        squares = square[i] + square[:i] - 2.0 * sums.sum(axis=1)
        distances[i, :i] = distances[:i, i] = np.sqrt(np.maximum(squares, 0.0) / points.shape[1])
    return distances


def cluster_distances(distances: Floats, within: float) -> tuple[Integers, Integers]:
    """Clusters by average linkage of distances (m, m): labels (m,), from 1, largest first, and medoids."""
    m = len(distances)
    tree = linkage(squareform(distances, checks=False), "average") if m > 1 else np.empty((0, 4))
    flat_clusters = fcluster(tree, within, "distance") if m > 1 else np.ones(1, dtype=np.int64)
    _, first, counts = np.unique(flat_clusters, return_index=True, return_counts=True)
    order = np.lexsort([first, -counts])
    labels = np.argsort(order)[flat_clusters - 1] + 1
    members = [np.flatnonzero(labels == k) for k in range(1, len(order) + 1)]
    medoids = [indices[np.argmin(distances[np.ix_(indices, indices)].sum(axis=1))] for indices in members]
    return labels, np.array(medoids)


def fluctuations(x: list[Floats]) -> Floats:
    """RMS deviations (n,), angstrom, of m sets of points (n, 3), nm, superposed on their mean."""
    mean = x[0]
    for _ in range(_ROUNDS):
        conformers = np.array([superpose(frame, mean) for frame in x])
        mean = read_only(conformers.mean(axis=0))
    return np.asarray(ANGSTROM_PER_NM * np.sqrt(np.mean(np.sum((conformers - mean) ** 2, axis=2), axis=0)))


def _backbone(structure: Structure) -> Integers:
    """(m, 4) int: atoms of phi and psi."""
    _, backbone_atoms = dihedral_finder(structure, ("phi", "psi"))
    residues = range(structure.n_residues)
    rows = [atoms for r in residues for *_, atoms in backbone_atoms(r) if None not in atoms]
    return np.array(rows, dtype=np.int64).reshape(-1, 4)


def _torsion_distances(x: list[Floats], quadruples: Integers) -> Floats:
    """(m, m) root mean square of the differences of dihedrals, degrees."""
    q = np.array([dihedral(*frame[quadruples.T]) for frame in x])
    distances = np.zeros((len(q), len(q)))
    for i in range(len(q)):
        turn = q - q[i]
        distances[i] = np.sqrt(np.mean((turn - 2.0 * np.pi * np.rint(turn / (2.0 * np.pi))) ** 2, axis=1))
    return np.degrees(distances)
