"""Evaluation of compiled terms: arguments and order of the kernels."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from protochain.arrays import Floats, Integers
from protochain.energies.native import bonded, born, neck, pairs
from protochain.energies.native.layout import (
    CHARGE,
    CHUNKS,
    GB_CHARGE,
    ROWS,
    S2,
    S3,
    SUMS,
    W,
    add_forces,
    aligned,
    empty_blocks,
    in_blocks,
    n_blocks,
    put_positions,
    take_scalars,
)  # fmt: skip
from protochain.energies.native.neighbours import Lists, make_lists
from protochain.energies.native.series import FAR_RATIO, NEAR_RATIO
from protochain.energies.native.terms import Terms

CLOSE = 0.35
"""nm. Pairs nearer than this come from a list, among them all excluded and clashing ones."""
KINDS = (
    "bonds",
    "angles",
    "torsions",
    "impropers",
    "maps",
    "ties",
    "tie angles",
    "nonbonded",
    "polar",
    "surface",
)
"""Components of the energy."""


@dataclass(frozen=True, eq=False)
class Layout:
    """Terms in the memory layout of the kernels.

    Parameters
    ----------
    terms : Terms
    groups : (na, k) int
        Rigid groups of each atom, -1 for none.
    exceptions : (na + 1,) int, (n,) int
        Start of each atom's exception partners, and the partners, constant exceptions included.
    """

    terms: Terms
    groups: Integers
    exceptions: tuple[Integers, Integers]

    @cached_property
    def near(self) -> float:
        """Distance in nm from which on tiles compute the pairs."""
        if self.terms.solvent is None:
            return CLOSE
        s, radius = np.abs(self.terms.solvent.scaled_radius), self.terms.solvent.offset_radius
        return float(max(CLOSE, s.max() / NEAR_RATIO, s.max() + radius.max()))

    @cached_property
    def block_near(self) -> Floats:
        """(blocks,) float: distance in nm beyond which a block needs neither near series nor masks."""
        if self.terms.solvent is None:
            return np.full(n_blocks(self.terms.n_atoms), self.near)
        far = in_blocks(np.abs(self.terms.solvent.scaled_radius)).max(axis=1) / FAR_RATIO
        return np.maximum(far, self.near)

    @cached_property
    def necked(self) -> float:
        """Largest distance of a neck, nm."""
        necks = self.terms.solvent.necks if self.terms.solvent else None
        return float(necks.reach.max()) if necks else 0.0

    @cached_property
    def blocks(self) -> Floats:
        """(blocks, ROWS * W) float: blocks with all rows that do not depend on positions."""
        blocks = empty_blocks(self.terms.n_atoms)
        rows = blocks.reshape(-1, ROWS, W)
        rows[:, CHARGE] = in_blocks(self.terms.nonbonded.charge)
        if self.terms.solvent is not None:
            s = self.terms.solvent.scaled_radius
            rows[:, GB_CHARGE] = in_blocks(self.terms.solvent.charge)
            rows[:, S2], rows[:, S3] = in_blocks(s**2), in_blocks(0.5 * s**3)
        return blocks

    @cached_property
    def lj_type(self) -> Integers:
        """(blocks, W) int: Lennard-Jones types."""
        return in_blocks(self.terms.nonbonded.lj_type)

    @cached_property
    def lj(self) -> Floats:
        """(blocks, types, 2 W) float: 12 A and 6 B of each type with each atom of a block."""
        n = self.terms.nonbonded
        rows = (12.0 * n.a12, 6.0 * n.b6)
        return np.concatenate([in_types(row, n.lj_type) for row in rows], axis=2)

    @cached_property
    def neck_type(self) -> Integers:
        """(blocks, W) int: types of the neck tables."""
        assert self.terms.solvent is not None and self.terms.solvent.necks is not None
        return in_blocks(self.terms.solvent.necks.kind)

    @cached_property
    def necks(self) -> Floats:
        """(blocks, types, 5 W) float: rows of :mod:`neck` for each type and each atom of a block."""
        assert self.terms.solvent is not None and self.terms.solvent.necks is not None
        n = self.terms.solvent.necks
        rows = (n.height, n.place, n.height.T, n.place.T, n.reach**2)
        return np.concatenate([in_types(row, n.kind) for row in rows], axis=2)


def in_types(table: Floats, kind: Integers) -> Floats:
    """(blocks, types, W) float: row of a table for each type and each atom of a block."""
    n = n_blocks(len(kind)) * W
    wide = np.zeros((len(table), n))
    wide[:, : len(kind)] = table[:, kind]
    return np.ascontiguousarray(wide.reshape(len(table), -1, W).swapaxes(0, 1))


def lists_of(layout: Layout, x: Floats) -> Lists:
    """Build the neighbour lists at x."""
    return make_lists(
        x, layout.near, layout.block_near, layout.necked, layout.terms.nonbonded.cutoff, layout.exceptions,
        layout.groups,
    )  # fmt: skip


def evaluate(layout: Layout, lists: Lists, x: Floats, fixed: Floats) -> tuple[dict[str, float], Floats]:
    """Evaluate energies by kind, and forces.

    Parameters
    ----------
    layout : Layout
    lists : Lists
    x : (na, 3) float, nm
    fixed : (na,) float
        Constant parts of the Born integrals.

    Returns
    -------
    dict of str to float, kJ/mol; (na, 3) float, kJ/mol/nm
    """
    terms, atoms = layout.terms, _blocks_at(layout, x)
    nonbonded = terms.nonbonded
    sums = aligned((CHUNKS, len(atoms), SUMS * W))
    parts = np.zeros((len(KINDS), CHUNKS))
    part = dict(zip(KINDS, parts, strict=True))
    pairwise = layout.near, nonbonded.cutoff, nonbonded.krf, nonbonded.crf
    in_tiles = lists.is_near, layout.near, layout.block_near, *pairwise[1:]
    solvent = terms.solvent
    if solvent is None:
        pairs.pair_sums(atoms, layout.lj, layout.lj_type, lists.tiles, *in_tiles, sums, part["nonbonded"])
    else:
        integral, slopes = _integrals(layout, lists, x, atoms, sums)
        slope = np.empty(terms.n_atoms)
        born.put_born_radii(
            integral + fixed, solvent.offset_radius, solvent.radius, solvent.bend, atoms, slope
        )
        born.polar_sums(atoms, lists.tiles, solvent.cutoff, sums, part["polar"])
        pull = np.empty(terms.n_atoms)
        take_scalars(sums, pull)
        polar, area = born.add_self_energy(solvent.charge, solvent.surface, slope, atoms, pull)
        part["polar"][0] += polar
        part["surface"][0] += area
        pairs.solvated_pair_sums(
            atoms, layout.lj, layout.lj_type, lists.tiles, *in_tiles, sums, part["nonbonded"]
        )
        born.near_descreening_sums(x, pull, lists.close, slopes, sums)
        if solvent.necks is not None:
            neck.neck_force_sums(
                atoms, layout.necks, layout.neck_type, lists.tiles[lists.is_necked], layout.necked,
                solvent.cutoff, sums,
            )  # fmt: skip
    kinds = nonbonded.charge, nonbonded.a12, nonbonded.b6, nonbonded.lj_type
    pairs.near_sums(x, *kinds, lists.free, layout.near, nonbonded.krf, nonbonded.crf, sums, part["nonbonded"])
    own_terms = nonbonded.exceptions
    pairs.exception_sums(x, *kinds, own_terms.atoms, own_terms.parameters, *pairwise, sums, part["nonbonded"])
    for kind, kernel in _BONDED:
        some = terms.bonded[kind]
        if len(some.atoms):
            kernel(x, some.atoms, some.parameters, sums, part[kind])
    maps = terms.bonded["maps"]
    if len(maps.atoms):
        which = maps.parameters[:, 0].astype(np.int64)
        bonded.map_sums(x, maps.atoms, which, terms.map_coefficients, sums, part["maps"])
    forces = np.empty((terms.n_atoms, 3))
    add_forces(sums, forces)
    return {kind: float(values.sum()) for kind, values in part.items()}, forces


_BONDED = (
    ("bonds", bonded.bond_sums),
    ("angles", bonded.angle_sums),
    ("torsions", bonded.torsion_sums),
    ("impropers", bonded.improper_sums),
    ("ties", bonded.bond_sums),
    ("tie angles", bonded.angle_sums),
)


def born_integrals(layout: Layout, lists: Lists, x: Floats) -> Floats:
    """(na,) float: Born integrals at x of the pairs in tiles and lists."""
    atoms = _blocks_at(layout, x)
    return _integrals(layout, lists, x, atoms, aligned((CHUNKS, len(atoms), SUMS * W)))[0]


def _blocks_at(layout: Layout, x: Floats) -> Floats:
    """(blocks, ROWS * W) float: blocks with positions."""
    atoms = aligned(layout.blocks.shape)
    atoms[:] = layout.blocks
    put_positions(x, atoms)
    return atoms


def _integrals(layout: Layout, lists: Lists, x: Floats, atoms: Floats, sums: Floats) -> tuple[Floats, Floats]:
    """Born integrals, and the slopes of the contributions of close pairs."""
    solvent = layout.terms.solvent
    assert solvent is not None
    born.integral_sums(
        atoms, lists.tiles, lists.is_near, layout.near, layout.block_near, solvent.cutoff, sums
    )
    slopes = np.empty((len(lists.close), 2))
    born.near_integral_sums(
        x, solvent.offset_radius, solvent.scaled_radius, solvent.engulfs, lists.close, layout.near, slopes,
        sums,
    )  # fmt: skip
    if solvent.necks is not None:
        neck.neck_sums(
            atoms, layout.necks, layout.neck_type, lists.tiles[lists.is_necked], layout.necked,
            solvent.cutoff, sums,
        )  # fmt: skip
    integral = np.empty(len(x))
    take_scalars(sums, integral)
    return integral, slopes
