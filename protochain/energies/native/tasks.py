"""One energy as tasks that any number of threads do in any order, with bit-identical results.

An energy has steps, each of which requires the previous one. A step has tasks of a few chunks. Tasks are
numbered through all steps and energies. A thread claims the next number if its step is open. The thread that
completes a step opens the next. No thread waits for a thread without a task, so threads that the operating
system does not run cause no delay.
"""

from typing import Any

import numpy as np

from protochain.core.arrays import Floats, Integers
from protochain.energies.native import bonded, born, expansion, neck, pairs
from protochain.energies.native.atomic import add, load, pause, replace, ticks, yield_processor
from protochain.energies.native.layout import (
    CHUNKS,
    Share,
    W,
    add_forces,
    atoms_of,
    chunk_kernel,
    collect_scalars,
    inline_kernel,
    part,
    put_positions,
)

COUNTERS = 96  # Length of the array of counters.
NEXT, OPEN, DONE, LAST, QUIT, TASKS, STEPS, ALL, LED, WAITED, TOOK = 0, 16, 32, 48, 64, 65, 66, 80, 81, 82, 83
"""Its elements, far apart for the cache: next task, tasks opened, tasks done, tasks of all energies so far,
whether helpers must quit, tasks of a step (a divisor of CHUNKS), number of steps. For the last energy: its
tasks, tasks of the leading thread, ticks that this thread waited, and its total ticks."""
_SPINS = 2000  # Checks of the counters before a waiting thread yields to the operating system: some 50 us.
_PATIENCE = 8000
"""Checks of the counters before a helper quits and must be woken for the next energy: some 200 us."""
IN_VACUUM, IN_SOLVENT, TO_RADII = 2, 6, 2
"""Steps of an energy in vacuum and in solvent, and steps up to the Born radii."""
Pairwise = tuple[float, float, float, float]
"""Smallest distance in tiles, cutoff, and the constants of the reaction field."""
Term = tuple[Integers, Floats]  # Atoms and parameters of the terms of one kind.
Maps = tuple[Integers, Integers, Floats]  # Atoms, number of the map and coefficients of CMAP.
Listed = tuple[
    tuple[Floats, Floats, Floats, Integers], Integers, Term, Term, Term, Term, Term, Term, Term, Maps
]
"""Charges, A, B and types of atoms, free pairs, exceptions, bonded terms by kind, and maps."""
BONDS, ANGLES, TORSIONS, IMPROPERS, MAPS, TIES, TIE_ANGLES, NONBONDED, POLAR, SURFACE = range(10)
"""Rows of ``parts``, the components of the energy."""


@chunk_kernel
def work(
    leads: bool, counters: Integers, state: Any, vacuum: Any, terms: Any, solvent: Any, necks: Any, far: Any,
    salt: Any,
) -> None:  # fmt: skip
    """Do tasks. The leading thread stops after its energy, a helper if no task has come for a while."""
    buffer = np.empty(2, np.int64)
    began = since = ticks(buffer)
    if leads:
        put_positions(state[0], state[1])
        counters[ALL] = counters[TASKS] * counters[STEPS]
        add(counters, LAST, counters[ALL])
        add(counters, OPEN, counters[TASKS])
    did, looks, waited = 0, 0, 0
    while (
        load(counters, DONE) < load(counters, LAST)
        if leads
        else looks < _PATIENCE and not load(counters, QUIT)
    ):
        if load(counters, NEXT) < load(counters, OPEN):
            waited += ticks(buffer) - since if looks else 0
            looks = 0
            did += take(counters, state, vacuum, terms, solvent, necks, far, salt)
            continue
        if looks == 0:
            since = ticks(buffer)
        looks += 1
        if leads and looks > _SPINS:
            yield_processor()
        else:
            pause()
    if leads:
        now = ticks(buffer)
        waited += now - since if looks else 0
        counters[LED], counters[WAITED], counters[TOOK] = did, waited, now - began


@inline_kernel
def take(
    counters: Integers, state: Any, vacuum: Any, terms: Any, solvent: Any, necks: Any, far: Any, salt: Any
) -> bool:  # fmt: skip
    """Do the next task, if one is open, and return whether there was one."""
    task = load(counters, NEXT)
    if task >= load(counters, OPEN) or not replace(counters, NEXT, task, task + 1):
        return False
    step, of_step = divmod(task, counters[TASKS])
    chunks_per_task = CHUNKS // counters[TASKS]
    chunks = of_step * chunks_per_task, (of_step + 1) * chunks_per_task
    # Its length is a constant, so that one branch alone is compiled.
    if len(solvent) == 0:
        in_vacuum(step % IN_VACUUM, chunks, state, vacuum, terms, far)
    else:
        in_solvent(step % IN_SOLVENT, chunks, state, vacuum, terms, solvent, necks, far, salt)
    n_done = add(counters, DONE, 1) + 1
    if n_done == load(counters, OPEN) and n_done < load(counters, LAST):
        add(counters, OPEN, counters[TASKS])
    return True


@inline_kernel
def in_vacuum(step: int, chunks: Share, state: Any, vacuum: Any, terms: Any, far: Any) -> None:
    """Do some chunks of a step of the energy in vacuum."""
    _, atoms, sums, is_written, parts, forces = state
    lj, lj_type, tiles, is_near, block_near, pairwise = vacuum
    near, cutoff, krf, crf = pairwise
    if step == 0:
        clear(chunks, sums, is_written, parts)
        pairs.pair_sums(
            chunks, atoms, lj, lj_type, tiles, is_near, near, block_near, cutoff, krf, crf, sums,
            parts[NONBONDED],
        )  # fmt: skip
        bonded_sums(chunks, state, pairwise, terms)
        if far is not None:
            far_moments(chunks, atoms, far[2][0], far)
    else:
        add_forces(*blocks_of(chunks, atoms), sums, is_written, forces)
        if far is not None:
            far_fields(chunks, far[2][0], far)
            far_forces(chunks, state, far)


@inline_kernel
def in_solvent(
    step: int, chunks: Share, state: Any, vacuum: Any, terms: Any, solvent: Any, necks: Any, far: Any,
    salt: Any,
) -> None:  # fmt: skip
    """Do some chunks of a step of the energy with generalised Born."""
    _, atoms, sums, is_written, parts, forces = state
    if step == 0:
        clear(chunks, sums, is_written, parts)
        integrals(chunks, state, vacuum, solvent, necks)
        if far is not None:
            far_moments(chunks, atoms, far[2][0], far)
    elif step == 1:
        if far is not None:
            far_fields(chunks, far[2][0], far)
        born_radii(chunks, state, solvent, far)
    elif step == 2:
        polar(chunks, state, solvent, salt)
        if far is not None:
            screened_tiles, screened_rows = far[3]
            born.screened_sums(chunks, atoms, screened_tiles, screened_rows, sums, parts[POLAR])
    elif step == 3:
        pulls(chunks, state, solvent, salt)
        if far is not None:
            put_pulls(chunks, atoms, solvent[2][3], far)
            far_moments(chunks, atoms, far[2][1], far)
    elif step == 4:
        solvated_pairs(chunks, state, vacuum, solvent, necks)
        bonded_sums(chunks, state, vacuum[5], terms)
        if far is not None:
            far_fields(chunks, far[2][1], far)
    else:
        add_forces(*blocks_of(chunks, atoms), sums, is_written, forces)
        if far is not None:
            far_forces(chunks, state, far)


@inline_kernel
def far_moments(chunks: Share, atoms: Floats, stage: Any, far: Any) -> None:
    """Put the moments of charges and of Born integral sources, or of dE/d(Born integral)."""
    (charges, moments, _, _), (_, nodes, roots, centre, _, _), settings, _ = far
    expansion.put_moments(chunks, atoms, charges, stage[0], nodes, roots, centre, settings[5], moments)


@inline_kernel
def far_fields(chunks: Share, stage: Any, far: Any) -> None:
    """Put the fields of the moments."""
    (_, moments, fields, _), (_, nodes, roots, centre, start, source), settings, _ = far
    expansion.put_fields(
        chunks, stage[1], stage[2], nodes, roots, centre, start, source, settings[5], moments, fields
    )  # fmt: skip


@inline_kernel
def put_pulls(chunks: Share, atoms: Floats, pull: Floats, far: Any) -> None:
    """Write dE/d(Born integral), the last kind of charge."""
    charges = far[0][0]
    begin, end = blocks_of(chunks, atoms)
    for block in range(begin, end):
        for k in range(W):
            charges[block, charges.shape[1] - 1, k] = pull[block * W + k]


@inline_kernel
def far_forces(chunks: Share, state: Any, far: Any) -> None:
    """Add forces and energies of all fields."""
    x, atoms, _, _, parts, forces = state
    (charges, _, fields, of_fields), (leaves, _, _, centre, _, _), settings, _ = far
    _, _, acts, orders, factors, tabled = settings
    expansion.put_far_forces(
        chunks, atoms, charges, orders, acts, factors, leaves, centre, tabled, fields, of_fields,
        parts[NONBONDED : POLAR + 1],
    )  # fmt: skip
    begin, end = atoms_of(*blocks_of(chunks, atoms), len(x))
    for i in range(begin, end):
        for axis in range(3):
            forces[i, axis] += of_fields[i // W, axis, i % W]


@inline_kernel
def clear(chunks: Share, sums: Floats, is_written: np.ndarray, parts: Floats) -> None:
    """Begin the sums of some chunks."""
    # Element by element, because an assignment of slices would compile for seconds.
    for c in range(*chunks):
        for block in range(sums.shape[1]):
            if is_written[c, block]:
                for k in range(sums.shape[2]):
                    sums[c, block, k] = 0.0
        for k in range(len(parts)):
            parts[k, c] = 0.0


@inline_kernel
def blocks_of(chunks: Share, atoms: Floats) -> Share:
    """Range of blocks that belong to some chunks, from the first to before the second number."""
    return part(len(atoms), chunks[0])[0], part(len(atoms), chunks[1] - 1)[1]


@inline_kernel
def integrals(chunks: Share, state: Any, vacuum: Any, solvent: Any, necks: Any) -> None:
    """Add the Born integrals."""
    x, atoms, sums, _, _, _ = state
    _, _, tiles, is_near, block_near, (near, _, _, _) = vacuum
    (offset_radius, _, _, scaled_radius, engulfs, _, _, cutoff), (close, _, _), (slopes, _, _, _) = solvent
    born.integral_sums(chunks, atoms, tiles, is_near, near, block_near, cutoff, sums)
    born.near_integral_sums(chunks, x, offset_radius, scaled_radius, engulfs, close, near, slopes, sums)
    if necks is not None:
        table, kind, neck_tiles, reach = necks
        neck.neck_sums(chunks, atoms, table, kind, neck_tiles, reach, cutoff, sums)


@inline_kernel
def born_radii(chunks: Share, state: Any, solvent: Any, far: Any) -> None:
    """Put the Born radii of some atoms."""
    x, atoms, sums, is_written, _, _ = state
    (offset_radius, radius, bend, _, _, _, _, _), (_, fixed, _), (_, integral, slope, _) = solvent
    blocks = blocks_of(chunks, atoms)
    collect_scalars(*blocks, sums, is_written, integral)
    if far is not None:
        (_, _, fields, _), (leaves, _, _, centre, _, _), (_, _, acts, orders, _, tabled), _ = far
        # The field of the integrals is the third from the end.
        expansion.add_potential(
            chunks, atoms, len(acts) - 3, orders[len(acts) - 3], leaves, centre, tabled, fields, integral
        )  # fmt: skip
    begin, end = atoms_of(*blocks, len(x))
    for i in range(begin, end):
        integral[i] += fixed[i]
    born.put_born_radii(begin, end, integral, offset_radius, radius, bend, atoms, slope)


@inline_kernel
def polar(chunks: Share, state: Any, solvent: Any, salt: Any) -> None:
    """Add energies and forces of generalised Born, and derivatives by Born radii."""
    _, atoms, sums, _, parts, _ = state
    # For all tiles, because Born radii also change in tiles of rigid groups.
    born.polar_sums(chunks, atoms, solvent[1][2], solvent[0][7], salt, sums, parts[POLAR])


@inline_kernel
def pulls(chunks: Share, state: Any, solvent: Any, salt: Any) -> None:
    """Put derivatives by the Born integrals of some atoms, and add their self energies."""
    x, atoms, sums, is_written, parts, _ = state
    (_, _, _, _, _, gb_charge, surface, _), _, (_, _, slope, pull) = solvent
    collect_scalars(*blocks_of(chunks, atoms), sums, is_written, pull)
    for c in range(*chunks):
        begin, end = atoms_of(*part(len(atoms), c), len(x))
        polar, area = born.add_self_energy(begin, end, gb_charge, surface, slope, atoms, salt, pull)
        parts[POLAR, c] += polar
        parts[SURFACE, c] += area


@inline_kernel
def solvated_pairs(chunks: Share, state: Any, vacuum: Any, solvent: Any, necks: Any) -> None:
    """Add energies and forces of pairs, with forces from the change of the Born radii."""
    x, atoms, sums, _, parts, _ = state
    lj, lj_type, tiles, is_near, block_near, (near, pair_cutoff, krf, crf) = vacuum
    (_, _, _, _, _, _, _, cutoff), (close, _, _), (slopes, _, _, pull) = solvent
    pairs.solvated_pair_sums(
        chunks, atoms, lj, lj_type, tiles, is_near, near, block_near, pair_cutoff, krf, crf, sums,
        parts[NONBONDED],
    )  # fmt: skip
    born.near_descreening_sums(chunks, x, pull, close, slopes, sums)
    if necks is not None:
        table, kind, neck_tiles, reach = necks
        neck.neck_force_sums(chunks, atoms, table, kind, neck_tiles, reach, cutoff, sums)


@inline_kernel
def bonded_sums(chunks: Share, state: Any, pairwise: Pairwise, terms: Listed) -> None:
    """Add listed pairs, exceptions and bonded terms."""
    x, _, sums, _, parts, _ = state
    kinds, free, exceptions, bonds, angles, torsions, impropers, ties, tie_angles, maps = terms
    near, _, krf, crf = pairwise
    pairs.near_sums(chunks, x, *kinds, free, near, krf, crf, sums, parts[NONBONDED])
    pairs.exception_sums(chunks, x, *kinds, *exceptions, *pairwise, sums, parts[NONBONDED])
    bonded.bond_sums(chunks, x, *bonds, sums, parts[BONDS])
    bonded.angle_sums(chunks, x, *angles, sums, parts[ANGLES])
    bonded.torsion_sums(chunks, x, *torsions, sums, parts[TORSIONS])
    bonded.improper_sums(chunks, x, *impropers, sums, parts[IMPROPERS])
    bonded.bond_sums(chunks, x, *ties, sums, parts[TIES])
    bonded.angle_sums(chunks, x, *tie_angles, sums, parts[TIE_ANGLES])
    bonded.map_sums(chunks, x, *maps, sums, parts[MAPS])
