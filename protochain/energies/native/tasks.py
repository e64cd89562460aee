"""One energy as tasks that any number of threads do in any order, to the same bits.

An energy has steps, of which each needs the one before; a step is a number of tasks, of a few chunks each.
Tasks are numbered through all steps and energies. A thread takes the next number if its step is open; who
finishes a step opens the next. No thread waits for one that has not begun a task: threads that the operating
system does not run cost nothing.
"""

from typing import Any

import numpy as np

from protochain.core.arrays import Floats, Integers
from protochain.energies.native import bonded, born, expansion, neck, pairs
from protochain.energies.native.atomic import add, give_way, load, pause, replace, ticks
from protochain.energies.native.layout import (
    CHUNKS,
    Share,
    W,
    add_forces,
    atoms_of,
    inlined,
    part,
    put_positions,
    shared,
    take_scalars,
)

COUNTERS = 96
"""Length of the array of counters."""
NEXT, OPEN, DONE, LAST, QUIT, TASKS, STEPS, ALL, LED, WAITED, TOOK = 0, 16, 32, 48, 64, 65, 66, 80, 81, 82, 83
"""Places in it, far apart for the cache: next task to take; tasks opened; done; of all energies so far;
whether helpers shall leave; tasks of a step, a divisor of CHUNKS; steps to take; of the last energy, its
tasks, those that the leading thread did, the ticks that it waited, and those that it took."""
_SPINS = 2000
"""Looks at the counters before a waiting thread lets the operating system run others: some 50 us."""
_PATIENCE = 8000
"""Looks at the counters before a helper leaves, and must be woken for the next energy: some 200 us."""
IN_VACUUM, IN_SOLVENT, TO_RADII = 2, 6, 2
"""Steps of an energy, and up to the Born radii."""
Pairwise = tuple[float, float, float, float]
"""Least distance in tiles, cutoff, and the constants of the reaction field."""
Term = tuple[Integers, Floats]
"""Atoms and parameters of the terms of one kind."""
Maps = tuple[Integers, Integers, Floats]
"""Atoms, number of the map and coefficients of CMAP."""
Listed = tuple[
    tuple[Floats, Floats, Floats, Integers], Integers, Term, Term, Term, Term, Term, Term, Term, Maps
]
"""Charges, A, B and types of atoms; free pairs; exceptions; bonded terms by kind, and maps."""
BONDS, ANGLES, TORSIONS, IMPROPERS, MAPS, TIES, TIE_ANGLES, NONBONDED, POLAR, SURFACE = range(10)
"""Rows of ``parts``, the components of the energy."""


@shared
def work(
    leads: bool, counters: Integers, state: Any, vacuum: Any, terms: Any, solvent: Any, necks: Any, far: Any
) -> None:  # fmt: skip
    """Do tasks: the thread that leads until its energy is done, a helper until none has come for a while."""
    room = np.empty(2, np.int64)
    began = since = ticks(room)
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
            waited += ticks(room) - since if looks else 0
            looks = 0
            did += take(counters, state, vacuum, terms, solvent, necks, far)
            continue
        if looks == 0:
            since = ticks(room)
        looks += 1
        if leads and looks > _SPINS:
            give_way()
        else:
            pause()
    if leads:
        now = ticks(room)
        waited += now - since if looks else 0
        counters[LED], counters[WAITED], counters[TOOK] = did, waited, now - began


@inlined
def take(counters: Integers, state: Any, vacuum: Any, terms: Any, solvent: Any, necks: Any, far: Any) -> bool:
    """Do the next task, if one is open, and return whether one was."""
    task = load(counters, NEXT)
    if task >= load(counters, OPEN) or not replace(counters, NEXT, task, task + 1):
        return False
    step, of_step = divmod(task, counters[TASKS])
    each = CHUNKS // counters[TASKS]
    mine = of_step * each, (of_step + 1) * each
    if solvent is None:
        in_vacuum(step % IN_VACUUM, mine, state, vacuum, terms, far)
    else:
        in_solvent(step % IN_SOLVENT, mine, state, vacuum, terms, solvent, necks, far)
    done = add(counters, DONE, 1) + 1
    if done == load(counters, OPEN) and done < load(counters, LAST):
        add(counters, OPEN, counters[TASKS])
    return True


@inlined
def in_vacuum(step: int, mine: Share, state: Any, vacuum: Any, terms: Any, far: Any) -> None:
    """Do some chunks of a step of the energy in vacuum."""
    _, atoms, sums, touched, parts, forces = state
    lj, lj_type, tiles, is_near, block_near, pairwise = vacuum
    near, cutoff, krf, crf = pairwise
    if step == 0:
        clear(mine, sums, touched, parts)
        pairs.pair_sums(
            mine, atoms, lj, lj_type, tiles, is_near, near, block_near, cutoff, krf, crf, sums,
            parts[NONBONDED],
        )  # fmt: skip
        bonded_sums(mine, state, pairwise, terms)
        if far is not None:
            far_moments(mine, atoms, far[2][0], far)
    else:
        add_forces(*blocks_of(mine, atoms), sums, touched, forces)
        if far is not None:
            far_fields(mine, far[2][0], far)
            far_forces(mine, state, far)


@inlined
def in_solvent(
    step: int, mine: Share, state: Any, vacuum: Any, terms: Any, solvent: Any, necks: Any, far: Any
) -> None:  # fmt: skip
    """Do some chunks of a step of the energy with generalised Born."""
    _, atoms, sums, touched, parts, forces = state
    if step == 0:
        clear(mine, sums, touched, parts)
        integrals(mine, state, vacuum, solvent, necks)
        if far is not None:
            far_moments(mine, atoms, far[2][0], far)
    elif step == 1:
        if far is not None:
            far_fields(mine, far[2][0], far)
        born_radii(mine, state, solvent, far)
    elif step == 2:
        polar(mine, state, solvent)
        if far is not None:
            screened_tiles, screened_rows = far[3]
            born.screened_sums(mine, atoms, screened_tiles, screened_rows, sums, parts[POLAR])
    elif step == 3:
        pulls(mine, state, solvent)
        if far is not None:
            put_pulls(mine, atoms, solvent[2][3], far)
            far_moments(mine, atoms, far[2][1], far)
    elif step == 4:
        solvated_pairs(mine, state, vacuum, solvent, necks)
        bonded_sums(mine, state, vacuum[5], terms)
        if far is not None:
            far_fields(mine, far[2][1], far)
    else:
        add_forces(*blocks_of(mine, atoms), sums, touched, forces)
        if far is not None:
            far_forces(mine, state, far)


@inlined
def far_moments(mine: Share, atoms: Floats, stage: Any, far: Any) -> None:
    """Moments of charges and of what makes Born integrals, or of dE/d(Born integral)."""
    (charges, moments, _, _), (_, nodes, roots, centre, _, _), settings, _ = far
    expansion.put_moments(mine, atoms, charges, stage[0], nodes, roots, centre, settings[5], moments)


@inlined
def far_fields(mine: Share, stage: Any, far: Any) -> None:
    """Fields of these."""
    (_, moments, fields, _), (_, nodes, roots, centre, start, source), settings, _ = far
    expansion.put_fields(
        mine, stage[1], stage[2], nodes, roots, centre, start, source, settings[5], moments, fields
    )  # fmt: skip


@inlined
def put_pulls(mine: Share, atoms: Floats, pull: Floats, far: Any) -> None:
    """Write dE/d(Born integral), the last kind of charge."""
    charges = far[0][0]
    begin, end = blocks_of(mine, atoms)
    for block in range(begin, end):
        for k in range(W):
            charges[block, charges.shape[1] - 1, k] = pull[block * W + k]


@inlined
def far_forces(mine: Share, state: Any, far: Any) -> None:
    """Add forces and energies of all fields."""
    x, atoms, _, _, parts, forces = state
    (
        (charges, _, fields, of_fields),
        (leaves, _, _, centre, _, _),
        (_, _, acts, orders, factors, tabled),
        _,
    ) = far
    expansion.put_far_forces(
        mine, atoms, charges, orders, acts, factors, leaves, centre, tabled, fields, of_fields,
        parts[NONBONDED : POLAR + 1],
    )  # fmt: skip
    begin, end = atoms_of(*blocks_of(mine, atoms), len(x))
    for i in range(begin, end):
        for axis in range(3):
            forces[i, axis] += of_fields[i // W, axis, i % W]


@inlined
def clear(mine: Share, sums: Floats, touched: np.ndarray, parts: Floats) -> None:
    """Begin the sums of some chunks."""
    # Element by element: an assignment of slices takes seconds to compile.
    for c in range(*mine):
        for block in range(sums.shape[1]):
            if touched[c, block]:
                for k in range(sums.shape[2]):
                    sums[c, block, k] = 0.0
        for k in range(len(parts)):
            parts[k, c] = 0.0


@inlined
def blocks_of(mine: Share, atoms: Floats) -> Share:
    """Blocks of atoms that belong to some chunks: the first, and that after the last."""
    return part(len(atoms), mine[0])[0], part(len(atoms), mine[1] - 1)[1]


@inlined
def integrals(mine: Share, state: Any, vacuum: Any, solvent: Any, necks: Any) -> None:
    """Born integrals."""
    x, atoms, sums, _, _, _ = state
    _, _, tiles, is_near, block_near, (near, _, _, _) = vacuum
    (offset_radius, _, _, scaled_radius, engulfs, _, _, cutoff), (close, _, _), (slopes, _, _, _) = solvent
    born.integral_sums(mine, atoms, tiles, is_near, near, block_near, cutoff, sums)
    born.near_integral_sums(mine, x, offset_radius, scaled_radius, engulfs, close, near, slopes, sums)
    if necks is not None:
        table, kind, necked, reach = necks
        neck.neck_sums(mine, atoms, table, kind, necked, reach, cutoff, sums)


@inlined
def born_radii(mine: Share, state: Any, solvent: Any, far: Any) -> None:
    """Born radii of some atoms."""
    x, atoms, sums, touched, _, _ = state
    (offset_radius, radius, bend, _, _, _, _, _), (_, fixed, _), (_, integral, slope, _) = solvent
    blocks = blocks_of(mine, atoms)
    take_scalars(*blocks, sums, touched, integral)
    if far is not None:
        (_, _, fields, _), (leaves, _, _, centre, _, _), (_, _, acts, orders, _, tabled), _ = far
        # That of the integrals is the last but two.
        expansion.add_potential(
            mine, atoms, len(acts) - 3, orders[len(acts) - 3], leaves, centre, tabled, fields, integral
        )  # fmt: skip
    begin, end = atoms_of(*blocks, len(x))
    for i in range(begin, end):
        integral[i] += fixed[i]
    born.put_born_radii(begin, end, integral, offset_radius, radius, bend, atoms, slope)


@inlined
def polar(mine: Share, state: Any, solvent: Any) -> None:
    """Energies of generalised Born, their forces, and derivatives by Born radii."""
    _, atoms, sums, _, parts, _ = state
    # Of all tiles: where no atom has moved relative to another, Born radii have changed.
    born.polar_sums(mine, atoms, solvent[1][2], solvent[0][7], sums, parts[POLAR])


@inlined
def pulls(mine: Share, state: Any, solvent: Any) -> None:
    """Derivatives by the Born integrals of some atoms, and their own energies."""
    x, atoms, sums, touched, parts, _ = state
    (_, _, _, _, _, gb_charge, surface, _), _, (_, _, slope, pull) = solvent
    take_scalars(*blocks_of(mine, atoms), sums, touched, pull)
    for c in range(*mine):
        begin, end = atoms_of(*part(len(atoms), c), len(x))
        polar, area = born.add_self_energy(begin, end, gb_charge, surface, slope, atoms, pull)
        parts[POLAR, c] += polar
        parts[SURFACE, c] += area


@inlined
def solvated_pairs(mine: Share, state: Any, vacuum: Any, solvent: Any, necks: Any) -> None:
    """Energies and forces of pairs, with the forces by the change of the Born radii."""
    x, atoms, sums, _, parts, _ = state
    lj, lj_type, tiles, is_near, block_near, (near, pair_cutoff, krf, crf) = vacuum
    (_, _, _, _, _, _, _, cutoff), (close, _, _), (slopes, _, _, pull) = solvent
    pairs.solvated_pair_sums(
        mine, atoms, lj, lj_type, tiles, is_near, near, block_near, pair_cutoff, krf, crf, sums,
        parts[NONBONDED],
    )  # fmt: skip
    born.near_descreening_sums(mine, x, pull, close, slopes, sums)
    if necks is not None:
        table, kind, necked, reach = necks
        neck.neck_force_sums(mine, atoms, table, kind, necked, reach, cutoff, sums)


@inlined
def bonded_sums(mine: Share, state: Any, pairwise: Pairwise, terms: Listed) -> None:
    """Listed pairs, exceptions and bonded terms."""
    x, _, sums, _, parts, _ = state
    kinds, free, exceptions, bonds, angles, torsions, impropers, ties, tie_angles, maps = terms
    near, _, krf, crf = pairwise
    pairs.near_sums(mine, x, *kinds, free, near, krf, crf, sums, parts[NONBONDED])
    pairs.exception_sums(mine, x, *kinds, *exceptions, *pairwise, sums, parts[NONBONDED])
    bonded.bond_sums(mine, x, *bonds, sums, parts[BONDS])
    bonded.angle_sums(mine, x, *angles, sums, parts[ANGLES])
    bonded.torsion_sums(mine, x, *torsions, sums, parts[TORSIONS])
    bonded.improper_sums(mine, x, *impropers, sums, parts[IMPROPERS])
    bonded.bond_sums(mine, x, *ties, sums, parts[TIES])
    bonded.angle_sums(mine, x, *tie_angles, sums, parts[TIE_ANGLES])
    bonded.map_sums(mine, x, *maps, sums, parts[MAPS])
