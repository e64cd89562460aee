"""Compiled terms in the memory layout of the kernels."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from protochain.core.arrays import Floats, Integers
from protochain.energies.native.layout import (
    CHARGE,
    CHUNKS,
    GB_CHARGE,
    ROWS,
    S2,
    S3,
    W,
    empty_blocks,
    in_blocks,
    n_blocks,
    scalar,
)
from protochain.energies.native.neighbours import Lists, block_groups, make_lists, partners
from protochain.energies.native.series import FAR_RATIO, NEAR_RATIO
from protochain.energies.native.terms import Bonded, Terms

CLOSE = 0.35  # nm. Closer pairs come from a list, which includes all excluded and clashing pairs.


@dataclass(frozen=True, eq=False)
class Layout:
    """Terms in the memory layout of the kernels."""

    terms: Terms
    groups: Integers  # (na, k) int: Rigid groups of each atom, -1 for none.
    # (na + 1,) int: Start of each atom's exception partners, and the partners, including constant exceptions.
    exceptions: tuple[Integers, Integers]

    @cached_property
    def near(self) -> float:
        """Smallest distance in nm of pairs in tiles."""
        if self.terms.solvent is None:
            return CLOSE
        s, radius = np.abs(self.terms.solvent.scaled_radius), self.terms.solvent.offset_radius
        return float(max(CLOSE, s.max() / NEAR_RATIO, s.max() + radius.max()))

    @cached_property
    def block_near(self) -> Floats:
        """(blocks,) float: distance in nm beyond which a block requires neither near series nor masks."""
        if self.terms.solvent is None:
            return np.full(n_blocks(self.terms.n_atoms), self.near)
        far = in_blocks(np.abs(self.terms.solvent.scaled_radius)).max(axis=1) / FAR_RATIO
        return np.maximum(far, self.near)

    @cached_property
    def block_group(self) -> Integers:
        """(blocks,) int: rigid group to which all atoms of a block belong, -1 for none."""
        return block_groups(self.groups)

    @cached_property
    def neck_reach(self) -> float:
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
    def written_blocks(self) -> np.ndarray:
        """(CHUNKS, blocks) bool: blocks to whose sums a chunk adds bonded terms and exceptions."""
        is_written = np.zeros((CHUNKS, n_blocks(self.terms.n_atoms)), dtype=bool)
        for kind in (*self.terms.bonded.values(), self.terms.nonbonded.exceptions):
            mark_written(is_written, kind.atoms // W)
        return is_written

    def pairs_of(self, lists: Lists) -> int:
        """Count the pairs of atoms that an evaluation visits, in each pass over tiles and in lists."""
        solvent = self.terms.solvent
        passes = len(lists.changing) * (1 if solvent is None else 2)
        listed = len(lists.free)
        if solvent is not None:
            # Polar energies of all tiles, because Born radii change. Near pairs of integrals, in two passes.
            passes, listed = passes + len(lists.tiles), listed + 2 * len(lists.close)
            passes += 2 * int(lists.is_necked.sum()) if solvent.necks else 0
        return W * W * passes + listed

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


def written_blocks(layout: Layout, lists: Lists) -> np.ndarray:
    """(CHUNKS, blocks) bool: blocks to whose sums a chunk adds, in any step."""
    is_written = layout.written_blocks.copy()
    mark_written(is_written, lists.changing)
    mark_written(is_written, lists.free // W)
    if layout.terms.solvent is not None:
        mark_written(is_written, lists.close // W)
        mark_written(is_written, lists.tiles)
        mark_written(is_written, lists.tiles[lists.is_necked])
    return is_written


@scalar
def mark_written(is_written: np.ndarray, blocks: Integers) -> None:
    """Mark the blocks (n, k) of items, divided among chunks as by :func:`layout.part`."""
    n = len(blocks)
    for chunk in range(CHUNKS):
        for i in range(chunk * n // CHUNKS, (chunk + 1) * n // CHUNKS):
            for k in range(blocks.shape[1]):
                is_written[chunk, blocks[i, k]] = True


def in_types(table: Floats, kind: Integers) -> Floats:
    """(blocks, types, W) float: row of a table for each type and each atom of a block."""
    n = n_blocks(len(kind)) * W
    wide = np.zeros((len(table), n))
    wide[:, : len(kind)] = table[:, kind]
    return np.ascontiguousarray(wide.reshape(len(table), -1, W).swapaxes(0, 1))


def lists_of(layout: Layout, x: Floats, tiles: Integers | None = None) -> Lists:
    """Build the neighbour lists at x, optionally from pairs of blocks ``tiles``."""
    return make_lists(
        x, layout.near, layout.block_near, layout.neck_reach, layout.terms.nonbonded.cutoff,
        layout.exceptions, layout.groups, layout.block_group, tiles,
    )  # fmt: skip


def in_order(layout: Layout, order: Integers) -> Layout:
    """Return the layout of the same atoms in another order (na,)."""
    terms, n = layout.terms, layout.terms.n_atoms
    place = np.empty(n, np.int64)
    place[order] = np.arange(n)

    def reorder(bonds: Bonded) -> Bonded:
        return Bonded(np.ascontiguousarray(place[bonds.atoms]), bonds.parameters)

    pairs = terms.nonbonded
    nonbonded = replace(
        pairs, charge=pairs.charge[order], lj_type=pairs.lj_type[order], exceptions=reorder(pairs.exceptions)
    )
    solvent = terms.solvent
    if solvent is not None:
        per_atom = {
            name: getattr(solvent, name)[order]
            for name in ("charge", "offset_radius", "scaled_radius", "radius", "bend", "surface")
        }
        necks = solvent.necks and replace(solvent.necks, kind=solvent.necks.kind[order])
        solvent = replace(solvent, necks=necks, **per_atom)
    bonded = {kind: reorder(bonds) for kind, bonds in terms.bonded.items()}
    start, partner = layout.exceptions
    listed = np.stack([np.repeat(np.arange(n), np.diff(start)), partner], axis=1)
    return Layout(
        replace(terms, bonded=bonded, nonbonded=nonbonded, solvent=solvent),
        layout.groups[order],
        partners(np.sort(place[listed], axis=1), n),
    )
