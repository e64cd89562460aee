"""Energies of pairs by atom: half of each to either, in the chunks of an evaluation."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np

from protochain.core.arrays import Floats
from protochain.energies.native.evaluate import Layout
from protochain.energies.native.layout import BORN, CHUNKS, ROWS, W, aligned, n_blocks
from protochain.energies.native.shares import HALVES, atom_sums


def halves(layout: Layout, blocks: Floats, threads: int) -> tuple[Floats, Floats]:
    """Energies (3, na) in kJ/mol, Born radii (na,) in nm or none, of blocks (blocks, ROWS * W)."""
    terms, n = layout.terms.nonbonded, n_blocks(layout.terms.n_atoms)
    solvent = layout.terms.solvent
    tiles = np.column_stack(np.triu_indices(n))
    start, partners = layout.exceptions
    first = np.repeat(np.arange(len(start) - 1), np.diff(start))
    of_tile = n * (first // W) + partners // W
    order = np.argsort(of_tile, kind="stable")
    begin = np.searchsorted(of_tile[order], np.append(tiles @ [n, 1], n * n))
    excluded = np.column_stack([first, partners])[order] % W
    sums = aligned((CHUNKS, n, HALVES * W))
    gb_cutoff = float(solvent.cutoff) if solvent else 0.0

    def add(share: tuple[int, int]) -> None:
        atom_sums(
            share, blocks, layout.lj, layout.lj_type, tiles, begin, excluded, float(terms.cutoff),
            float(terms.krf), float(terms.crf), gb_cutoff, sums,
        )  # fmt: skip

    if threads == 1:
        add((0, CHUNKS))
    else:
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(add, [(c, c + 1) for c in range(CHUNKS)]))
    by_atom = sums.sum(axis=0).reshape(n, HALVES, W).swapaxes(0, 1).reshape(HALVES, -1)
    born = blocks.reshape(-1, ROWS, W)[:, BORN].ravel() if solvent else np.empty(0)
    return by_atom[:, : layout.terms.n_atoms], born[: layout.terms.n_atoms].copy()
