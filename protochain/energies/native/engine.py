"""Native engine: compiled kernels behind the interface of all energies."""

from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from threading import Lock
from types import MappingProxyType
from typing import Any

import numba
import numpy as np
import openmm

from protochain.core.arrays import Floats, Integers, floats, read_only
from protochain.energies.native.evaluate import Layout, in_order, lists_of
from protochain.energies.native.evaluation import Evaluation, Workspace
from protochain.energies.native.far import FEWEST_BLOCKS, Far, Opening, least_distance, openings, same_charge
from protochain.energies.native.layout import BORN, ROWS, W, n_blocks, put_positions
from protochain.energies.native.neighbours import Lists, partners
from protochain.energies.native.reading import UnsupportedForceError
from protochain.energies.native.terms import Bonded, Terms, compile_system
from protochain.energies.native.tree import build_tree, screened_pairs
from protochain.energies.openmm_engine import OpenMMEnergy

_SETTINGS: Any = numba.config
MOST_THREADS: int = _SETTINGS.NUMBA_NUM_THREADS
"""Threads of numba: number of processors, or NUMBA_NUM_THREADS."""
_COARSE, _WATER = 0.9, 78.5  # Cutoff in nm, and dielectric constant.


class NativeEnergy:
    """Energy of an OpenMM System by compiled kernels, in double precision.

    A run repeats bit for bit on any number of threads. Energies at the same positions may differ in the last
    digits between runs with different paths, because neighbour lists, and so the order of sums, depend on the
    path.

    Parameters
    ----------
    by_openmm : OpenMMEnergy
        The same energy by OpenMM, with the System to compile.
    threads : int
        Number of threads.
    opening : Opening, optional
        Parameters of a tree for far pairs. By default all pairs are summed one by one.
    terms : Terms, optional
        Terms of the System, if they are known without it.

    Raises
    ------
    UnsupportedForceError
        If the System has a force without an exact native kernel.
    """

    engine, device, is_exact = "native", "cpu", True

    def __init__(
        self,
        by_openmm: OpenMMEnergy,
        threads: int,
        opening: Opening | None = None,
        terms: Terms | None = None,
    ) -> None:
        terms = terms or compile_system(by_openmm.system)
        no_groups = np.full((terms.n_atoms, 1), -1)
        layout = Layout(terms, no_groups, partners(terms.nonbonded.exceptions.atoms, terms.n_atoms))
        if terms.nonbonded.cutoff < layout.near:
            raise UnsupportedForceError(f"NonbondedForce with a cutoff below {layout.near:.2g} nm")
        self._set(by_openmm, threads, layout, opening)

    def _set(
        self, by_openmm: OpenMMEnergy, threads: int, layout: Layout, opening: Opening | None = None
    ) -> None:
        self.by_openmm, self.opening = by_openmm, opening
        self.errors: tuple[float, ...] = ()
        """RMS errors of the forces in kJ/mol/nm: the first and last measured values."""
        self.atoms = by_openmm.atoms
        self.forcefield, self.solvent = by_openmm.forcefield, by_openmm.solvent
        self.settings = by_openmm.settings
        self.threads = min(threads, MOST_THREADS)
        self.tree_measurement: tuple[Floats, tuple[float, Floats]] | None = None
        """Positions at which a tree was measured, with energy and forces of all pairs one by one."""
        self.left_out: Mapping[str, int] = MappingProxyType({})
        self._layout = layout
        self._lists: Lists | None = None
        self._evaluation: Evaluation | None = None
        self._lock = Lock()
        self._full: tuple[Layout, Lists, Lists, Floats] | None = None
        """If terms are omitted: layout of all terms, its lists, the reduced lists, and their positions."""

    def __reduce__(self) -> tuple[Any, ...]:
        """Rebuild the energy, without the neighbour lists of earlier evaluations."""
        rigid = None if self._full is None else (self._layout.groups, self._full[3])
        return _rebuild, (self.by_openmm, self.threads, self.opening, rigid)

    @property
    def system(self) -> openmm.System:
        """The OpenMM System."""
        return self.by_openmm.system

    @property
    def fingerprint(self) -> str:
        """SHA-256 of the System."""
        return self.by_openmm.fingerprint

    @property
    def reference(self) -> OpenMMEnergy:
        """The same energy on OpenMM's Reference platform."""
        return self.by_openmm.reference

    @property
    def reason(self) -> str:
        """Kernels, precision, threads, the accuracy of far pairs, and the omitted constant terms."""
        text = f"native kernels, double precision, {self.threads} threads"
        if self.opening is not None:
            text += "; far pairs by a tree"
        if self.errors:
            error = ", at last by ".join(f"{error:.2g}" for error in self.errors)
            text += f", forces differ by {error} kJ/mol/nm RMS from those of all pairs"
        if self.left_out:
            constant = ", ".join(f"{n} {kind}" for kind, n in self.left_out.items())
            text += f"; constant in this chain: {constant}"
        return f"{text}; {self.by_openmm.note}" if self.by_openmm.note else text

    @property
    def terms(self) -> Terms:
        """All terms of the System as arrays, including omitted terms."""
        return (self._layout if self._full is None else self._full[0]).terms

    @property
    def operation_counts(self) -> Mapping[str, int]:
        """Numbers of terms, pairs of atoms and list entries in an evaluation with the current lists."""
        terms = self._layout.terms
        n_terms = sum(len(subset.atoms) for subset in (*terms.bonded.values(), terms.nonbonded.exceptions))
        if self._lists is None:
            return {"terms": n_terms}
        return {
            "terms": n_terms, "pairs": self._layout.pairs_of(self._lists), "lists": len(self._lists.close),
        }  # fmt: skip

    @cached_property
    def exact(self) -> "NativeEnergy":
        """The same energy with all pairs summed one by one, which may be itself."""
        return self if self.opening is None else self.by_tree(None)

    def by_tree(self, opening: Opening | None) -> "NativeEnergy":
        """Return a copy whose far pairs are summed by a tree, or one by one for None."""
        return self._copy(self._layout, opening)

    def _copy(self, layout: Layout, opening: Opening | None = None) -> "NativeEnergy":
        """Return an energy with another layout or opening, without neighbour lists."""
        copy = NativeEnergy.__new__(NativeEnergy)
        copy._set(self.by_openmm, self.threads, layout, opening)
        return copy

    def to_accuracy(self, accuracy: float, x: Floats) -> "NativeEnergy":
        """Choose the fastest tree within an RMS error of forces at x (na, 3), measured against all pairs."""
        terms, cause = self._layout.terms, "no tree is as accurate as asked"
        if terms.nonbonded.cutoff < np.inf or (terms.solvent and terms.solvent.cutoff < np.inf):
            cause = "the System has a cutoff"
        elif terms.solvent and terms.solvent.salt:
            cause = "salt screens far pairs"
        elif not same_charge(terms):
            cause = "generalised Born has other charges than Coulomb"
        elif n_blocks(terms.n_atoms) < FEWEST_BLOCKS:
            cause = "so few are summed sooner than by a tree"
        else:
            exact = self.exact(x)
            self._lists = self._evaluation = None
            for opening in openings(accuracy, terms.solvent is not None):
                tree = self.by_tree(opening)
                if tree.note_error(tree(x)[1], exact[1]) <= accuracy:
                    tree.tree_measurement = read_only(x), exact
                    return tree
        note = f"all pairs one by one: {cause}"
        self.by_openmm.note = f"{self.by_openmm.note}; {note}".removeprefix("; ")
        return self

    def note_error(self, forces: Floats, exact: Floats) -> float:
        """Return the RMS error of its forces (na, 3). With a tree ``reason`` reports it."""
        error = float(np.sqrt(((forces - exact) ** 2).sum(axis=1).mean()))
        if self.opening is not None:
            self.errors = (*self.errors[:1], error)
        return error

    def __call__(self, x: Floats) -> tuple[float, Floats]:
        """Energy in kJ/mol and forces (na, 3) in kJ/mol/nm at positions x (na, 3) in nm."""
        # Coincident atoms give large finite numbers. NaN in the positions gives an infinite energy and NaN
        # forces, which the calling loop handles.
        parts, forces = self.parts(x)
        return sum(parts.values()) + self._constants[0], forces

    def parts(self, x: Floats) -> tuple[dict[str, float], Floats]:
        """Evaluate energies by kind, without the constant of omitted terms, as :meth:`Energy.parts`.

        Kinds are ``bonds``, ``angles``, ``torsions``, ``impropers``, ``maps`` (CMAP), ``nonbonded`` (Coulomb,
        Lennard-Jones), ``polar`` (generalised Born) and ``surface``. Kinds that the System lacks are 0.
        """
        x = floats(x, (self._layout.terms.n_atoms, 3), "x", "nanometer")
        if not np.isfinite(x).all():
            return {"bonds": np.inf}, np.full(x.shape, np.nan)
        with self._lock:
            return self._evaluation_at(x)(x)

    def born_radii(self, x: Floats) -> Floats:
        """(na,) float, nm: Born radii at x (na, 3) in nm, empty without a solvent model."""
        n = self._layout.terms.n_atoms
        x = floats(x, (n, 3), "x", "nanometer")
        if self._layout.terms.solvent is None:
            return np.empty(0)
        with self._lock:
            return self._with_born(x).reshape(-1, ROWS, W)[:, BORN].ravel()[:n].copy()

    def _with_born(self, x: Floats) -> Floats:
        """(blocks, ROWS * W) float: blocks of atoms at x, with Born radii if there is a solvent model."""
        # The neighbour lists remain unchanged, so a call between two runs changes no bit of the second.
        if self.opening is not None:
            return self.exact._with_born(x)
        if self._layout.terms.solvent is None:
            blocks = self._layout.blocks.copy()
            put_positions(x, blocks)
            return blocks
        before = self._lists
        try:
            evaluation = self._evaluation_at(x)
            if not evaluation.was_at(x):
                Evaluation(
                    self._layout, evaluation.lists, self._constants[1], evaluation.workspace, self.threads
                ).put_born_radii(x)
        finally:
            self._lists = before
        return evaluation.workspace.atoms

    def without_constants(self, groups: Integers, x: Floats) -> "NativeEnergy":
        """Omit terms that are constant while groups of atoms (na, k) stay rigid as at x (na, 3), nm.

        The group is -1 for none. An atom on a hinge's axis belongs to both its bodies. The energy is the same
        function of positions with rigid groups, with the same force and torque on each group. With a tree the
        result is the tree's energy, or changing pairs one by one if they are fewer than its near pairs.
        """
        if self.opening is not None:
            copy = self.exact.without_constants(groups, x)
            with self._lock:
                near = len(self._evaluation_at(x).lists.tiles)
            is_smaller = (
                self.terms.solvent is None and len(copy._full[2].changing) <= near if copy._full else False
            )
            return copy if is_smaller else self
        x = read_only(floats(x, (self._layout.terms.n_atoms, 3), "x"))
        terms = self._layout.terms
        moving_terms, left_out = {}, {}
        for kind, subset in (*terms.bonded.items(), ("exceptions", terms.nonbonded.exceptions)):
            moving = ~_in_one_group(groups, subset.atoms)
            moving_terms[kind] = Bonded(subset.atoms[moving], subset.parameters[moving])
            left_out[kind] = int(len(moving) - moving.sum())
        nonbonded = replace(terms.nonbonded, exceptions=moving_terms.pop("exceptions"))
        fewer = replace(terms, bonded=moving_terms, nonbonded=nonbonded)
        # Omitted exceptions must still be excluded from the list of free pairs.
        copy = self._copy(replace(self._layout, terms=fewer, groups=groups))
        # Lists at these positions, independent of earlier evaluations, so that runs repeat.
        all_lists, fewer_lists = lists_of(self._layout, x), lists_of(copy._layout, x)
        copy._lists, copy._full = fewer_lists, (self._layout, all_lists, fewer_lists, x)
        left_out["close pairs"] = len(all_lists.close) - len(fewer_lists.close)
        copy.left_out = MappingProxyType({kind: n for kind, n in left_out.items() if n})
        return copy

    @cached_property
    def coarse(self) -> "NativeEnergy":
        """A coarse copy, several times as fast: pairs up to ``_COARSE`` nm with a reaction field."""
        terms = self._layout.terms
        krf = (_WATER - 1.0) / (2.0 * _WATER + 1.0) / _COARSE**3
        crf = 3.0 * _WATER / (2.0 * _WATER + 1.0) / _COARSE
        nonbonded = replace(terms.nonbonded, cutoff=_COARSE, krf=krf, crf=crf)
        fewer = replace(terms, nonbonded=nonbonded, solvent=None)
        return self._copy(replace(self._layout, terms=fewer))

    @cached_property
    def bonded_terms(self) -> "NativeEnergy":
        """A copy with only the bonded terms, without pairs or exceptions."""
        terms = self.terms
        near = Layout(replace(terms, solvent=None), self._layout.groups, self._layout.exceptions).near
        pairs = terms.nonbonded
        nothing = replace(
            pairs, charge=0.0 * pairs.charge, a12=0.0 * pairs.a12, b6=0.0 * pairs.b6, cutoff=near,
            exceptions=Bonded(pairs.exceptions.atoms[:0], pairs.exceptions.parameters[:0]),
        )  # fmt: skip
        fewer = replace(terms, nonbonded=nothing, solvent=None)
        return self._copy(replace(self._layout, terms=fewer))

    def cutoff_error(self, x: Floats) -> str:
        """Report the error of the forces from the cutoff at x (na, 3) in nm, by one sum over all pairs."""
        terms = self._layout.terms
        nonbonded = replace(terms.nonbonded, cutoff=np.inf, krf=0.0, crf=0.0)
        solvent = replace(terms.solvent, cutoff=np.inf) if terms.solvent else None
        layout = replace(self._layout, terms=replace(terms, nonbonded=nonbonded, solvent=solvent))
        full = Evaluation(layout, lists_of(layout, x), np.zeros(len(x)), Workspace(layout), self.threads)
        rms_error = np.sqrt(((self(x)[1] - full(x)[1]) ** 2).sum(axis=1).mean())
        return f"with the cutoff, forces differ by {rms_error:.2g} kJ/mol/nm RMS from those of all pairs"

    @cached_property
    def _constants(self) -> tuple[float, Floats]:
        """Energy of the omitted terms, and constant Born integrals between atoms of one group."""
        fixed = np.zeros(self._layout.terms.n_atoms)
        if self._full is None:
            return 0.0, fixed
        layout, lists, own_lists, x = self._full
        full = Evaluation(layout, lists, fixed, Workspace(layout), self.threads)
        moving = Evaluation(self._layout, own_lists, fixed, Workspace(self._layout), self.threads)
        (all_parts, _), (reduced_parts, _) = full(x), moving(x)
        if self._layout.terms.solvent is not None:
            fixed = (full.workspace.integral - moving.workspace.integral)[: len(x)]
            reduced_parts, _ = Evaluation(self._layout, own_lists, fixed, moving.workspace, self.threads)(x)
        return sum(all_parts.values()) - sum(reduced_parts.values()), fixed

    @property
    def lists_at(self) -> Floats | None:
        """(na, 3) float, nm: positions at which the neighbour lists in use were built."""
        return self._lists.x if self._lists else None

    def list_at(self, x: Floats) -> None:
        """Build the neighbour lists at positions x (na, 3) in nm."""
        x = floats(x, (self._layout.terms.n_atoms, 3), "x")
        if self._lists is None or not np.array_equal(self._lists.x, x):
            self._lists = lists_of(self._layout, x)

    def _evaluation_at(self, x: Floats) -> Evaluation:
        """Evaluation with neighbour lists that are valid at x."""
        if self.opening is not None:
            return self._by_tree(x, self.opening)
        if self._lists is None or not self._lists.are_valid(x):
            self._lists = lists_of(self._layout, x)
        last = self._evaluation
        if last is None or last.lists is not self._lists:
            workspace = last.workspace if last else Workspace(self._layout)
            self._evaluation = Evaluation(
                self._layout, self._lists, self._constants[1], workspace, self.threads
            )
            if last:
                last.dismiss()
        assert self._evaluation is not None
        return self._evaluation

    def _by_tree(self, x: Floats, opening: Opening) -> Evaluation:
        """Evaluation with a tree that is valid at x."""
        last, old = self._evaluation, self._lists
        if last is not None and old is not None and last.lists is old and old.are_valid(x):
            return last
        x0 = old.x if old is not None and old.are_valid(x) else x
        tree = build_tree(x0, opening.angle, least_distance(self._layout))
        layout = in_order(self._layout, tree.order)
        lists = replace(lists_of(layout, x0[tree.order], tree.near), x=x0.copy())
        workspace = last.workspace if last else Workspace(layout)
        workspace.atoms[:] = layout.blocks
        far, fixed = Far(layout, opening, tree), np.zeros(len(x))
        if layout.terms.solvent is not None:
            first = Evaluation(layout, lists, fixed, workspace, self.threads, far)
            first.put_born_radii(x0)
            far = replace(far, screened=screened_pairs(tree, x0[tree.order], first.born, opening.screened))
        self._lists = lists
        self._evaluation = Evaluation(layout, lists, fixed, workspace, self.threads, far)
        if last:
            last.dismiss()
        return self._evaluation

    def __repr__(self) -> str:
        return f"<NativeEnergy {self.forcefield}, {self.solvent}: {self.reason}>"


def _rebuild(
    by_openmm: OpenMMEnergy, threads: int, opening: Opening | None, rigid: tuple[Integers, Floats] | None
) -> NativeEnergy:
    energy = NativeEnergy(by_openmm, threads, opening)
    return energy if rigid is None else energy.without_constants(*rigid)


def _in_one_group(groups: Integers, atoms: Integers) -> np.ndarray:
    """(n,) bool: whether all atoms of a term share a group."""
    is_together = np.zeros(len(atoms), dtype=bool)
    if not atoms.size:
        return is_together
    for column in range(groups.shape[1]):
        group = groups[atoms[:, 0], column]
        shares_group = (groups[atoms] == group[:, None, None]).any(axis=2).all(axis=1)
        is_together |= shares_group & (group >= 0)
    return is_together
