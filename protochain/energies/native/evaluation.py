"""An energy with its neighbour lists, for any positions at which they are valid."""

import threading
from time import monotonic, perf_counter, thread_time
from typing import Any

import numpy as np

from protochain.core.arrays import Floats
from protochain.core.timings import count_kernel
from protochain.energies.native import tasks
from protochain.energies.native.atomic import TICK
from protochain.energies.native.evaluate import Layout, mark_written, written_blocks
from protochain.energies.native.far import Far
from protochain.energies.native.helpers import Helpers, Worth, helpers
from protochain.energies.native.layout import BORN, CHUNKS, ROWS, SUMS, W, aligned_zeros
from protochain.energies.native.neighbours import Lists

KINDS = (
    "bonds", "angles", "torsions", "impropers", "maps", "ties", "tie angles", "nonbonded", "polar", "surface",
)  # fmt: skip
"""Components of the energy, in the order of the rows of ``tasks``."""
_FEW_BLOCKS = 32
"""Largest number of blocks for which a task of one of 16 chunks is too small for two threads."""
_BONDED = ("bonds", "angles", "torsions", "impropers", "ties", "tie angles")


class Workspace:
    """Arrays that an evaluation writes to, for any lists."""

    def __init__(self, layout: Layout) -> None:
        n = layout.terms.n_atoms
        self.x, self.forces = np.empty((n, 3)), np.empty((n, 3))
        self.atoms = aligned_zeros(layout.blocks.shape)
        self.atoms[:] = layout.blocks
        self.sums = aligned_zeros((CHUNKS, len(self.atoms), SUMS * W))
        self.parts = np.empty((len(KINDS), CHUNKS))
        self.worth = Worth()
        self.integral, self.slope, self.pull = np.empty((3, len(self.atoms) * W))
        self.owner: Evaluation | None = None
        """Evaluation whose sums are stored, None during a computation."""


class Evaluation:
    """An energy with its lists."""

    # fixed (na,): Constant parts of the Born integrals.
    # workspace: Workspace of the same layout. Only one evaluation at a time may use it.
    # far: Interactions by a tree. Its order of atoms applies to layout, lists and workspace.

    def __init__(
        self, layout: Layout, lists: Lists, fixed: Floats, workspace: Workspace, threads: int,
        far: Far | None = None,
    ) -> None:  # fmt: skip
        self.lists, self.workspace = lists, workspace
        self.order = far.tree.order if far else None
        self._counters = np.zeros(tasks.COUNTERS, np.int64)
        self._arguments = arguments(layout, lists, fixed, workspace, far)
        self._max_helpers = min(threads, CHUNKS) - 1
        self._counters[tasks.TASKS] = tasks_of_a_step(threads, len(workspace.atoms))
        self._counters[tasks.STEPS] = tasks.IN_VACUUM if layout.terms.solvent is None else tasks.IN_SOLVENT
        self._state = threading.Lock()
        self._is_running, self._n_helping, self._helpers = False, 0, helpers()

    def __call__(self, x: Floats) -> tuple[dict[str, float], Floats]:
        """Evaluate energies by kind in kJ/mol, and forces (na, 3) in kJ/mol/nm, at x (na, 3) in nm."""
        w = self.workspace
        w.owner = None
        if self.order is None:
            np.copyto(w.x, x)
        else:
            np.take(x, self.order, axis=0, out=w.x)
        uses_helpers = self._max_helpers > 0 and w.worth.should_ask(monotonic())
        self._counters[tasks.QUIT] = not uses_helpers
        self._is_running, cpu_start, start = True, thread_time(), perf_counter()
        try:
            with count_kernel():
                if uses_helpers:
                    self._call_helpers(helpers())
                tasks.work(True, self._counters, *self._arguments)
        finally:
            self._is_running = False  # Also on Ctrl-C, because helpers would otherwise wait forever.
        # Includes the wait for the interpreter, which may be long on a busy machine.
        elapsed = perf_counter() - start
        if uses_helpers:
            n_tasks, led, waited = self._counters[[tasks.ALL, tasks.LED, tasks.WAITED]].tolist()
            worked = min(elapsed - TICK * waited, thread_time() - cpu_start)
            w.worth.note(monotonic(), elapsed, worked, led / n_tasks)
        w.owner = self
        forces = w.forces.copy()
        if self.order is not None:
            forces[self.order] = w.forces
        return dict(zip(KINDS, w.parts.sum(axis=1).tolist(), strict=True)), forces

    @property
    def born(self) -> Floats:
        """(blocks * W,) float, nm: Born radii of the last evaluation, in the order of the layout."""
        return self.workspace.atoms.reshape(-1, ROWS, W)[:, BORN].ravel()

    def put_born_radii(self, x: Floats) -> None:
        """Compute only Born radii at x. Later evaluations with this object also stop there."""
        self._counters[tasks.STEPS] = tasks.TO_RADII
        self(x)

    def was_at(self, x: Floats) -> bool:
        """Whether the workspace has the results of this evaluation at x (na, 3)."""
        at = self.workspace.x
        return self.workspace.owner is self and np.array_equal(at, x if self.order is None else x[self.order])

    def _call_helpers(self, helper_pool: Helpers) -> None:
        with self._state:
            if helper_pool is not self._helpers:
                self._helpers, self._n_helping = helper_pool, 0
            missing = self._max_helpers - self._n_helping
            self._n_helping = self._max_helpers
        if missing:
            helper_pool.ask(self.help_out, missing, self._max_helpers)

    def help_out(self) -> None:
        """Do tasks as a helper until none has come for a while."""
        while True:
            tasks.work(False, self._counters, *self._arguments)
            with self._state:
                if not self._is_running or self._counters[tasks.QUIT]:
                    self._n_helping -= 1
                    return

    def dismiss(self) -> None:
        """Release the helpers, because the lists have changed."""
        self._counters[tasks.QUIT] = 1


def tasks_of_a_step(threads: int, n_blocks: int) -> int:
    """Tasks per step: few for small systems, to reduce overhead, many for large ones, to balance threads."""
    if threads == 1:
        return 1
    return CHUNKS if threads > 2 or n_blocks > _FEW_BLOCKS else CHUNKS // 2


def arguments(
    layout: Layout, lists: Lists, fixed: Floats, w: Workspace, far: Far | None = None
) -> tuple[Any, ...]:
    """Return the arguments of :func:`tasks.work` after its counters, by subject, None for absent parts."""
    terms, nonbonded, solvent = layout.terms, layout.terms.nonbonded, layout.terms.solvent
    is_written = written_blocks(layout, lists)
    tree_part = None
    if far is not None:
        mark_written(is_written, far.screened[0])
        settings = tuple(_views(*s) if isinstance(s, tuple) else _views(s)[0] for s in far.arguments())
        tree_part = far.work_arrays(), _views(*far.geometry()), settings, _views(*far.screened)
    state = w.x, w.atoms, w.sums, *_views(is_written), w.parts, w.forces
    pairwise = tuple(map(float, (layout.near, nonbonded.cutoff, nonbonded.krf, nonbonded.crf)))
    vacuum = *_views(layout.lj, layout.lj_type, lists.changing, lists.is_near, layout.block_near), pairwise
    kinds = _views(nonbonded.charge, nonbonded.a12, nonbonded.b6, nonbonded.lj_type)
    bonded = (_views(terms.bonded[kind].atoms, terms.bonded[kind].parameters) for kind in _BONDED)
    exceptions = _views(nonbonded.exceptions.atoms, nonbonded.exceptions.parameters)
    maps = terms.bonded["maps"]
    map_terms = _views(maps.atoms, maps.parameters[:, 0].astype(np.int64), terms.map_coefficients)
    listed = kinds, *_views(lists.free), exceptions, *bonded, map_terms
    if solvent is None:
        return state, vacuum, listed, (), None, tree_part, None
    per_atom = (
        *_views(solvent.offset_radius, solvent.radius, solvent.bend, solvent.scaled_radius),
        bool(solvent.engulfs), *_views(solvent.charge, solvent.surface), float(solvent.cutoff),
    )  # fmt: skip
    written = np.empty((len(lists.close), 2)), w.integral, w.slope, w.pull
    born = per_atom, _views(lists.close, fixed, lists.tiles), written
    if solvent.necks is None:
        return state, vacuum, listed, born, None, tree_part, solvent.salt
    necks = *_views(layout.necks, layout.neck_type, lists.tiles[lists.is_necked]), layout.neck_reach
    return state, vacuum, listed, born, necks, tree_part, solvent.salt


def _views(*arrays: Any) -> tuple[Any, ...]:
    """Read-only contiguous views. Numba compiles for each kind of array, and may round differently."""
    views = tuple(np.ascontiguousarray(array).view() for array in arrays)
    for view in views:
        view.flags.writeable = False
    return views
