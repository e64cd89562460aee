"""The native engine: compiled terms behind the interface that every energy has."""

import logging
from collections.abc import Mapping
from dataclasses import replace
from functools import cache, cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numba
import numpy as np

from protochain.arrays import Floats, Integers, floats, read_only
from protochain.energies.native import pairs
from protochain.energies.native.evaluate import Layout, born_integrals, evaluate, lists_of
from protochain.energies.native.neighbours import Lists, partners
from protochain.energies.native.reading import UnsupportedForceError
from protochain.energies.native.terms import Bonded, compile_system
from protochain.energies.openmm_engine import OpenMMEnergy

_LOG = logging.getLogger(__name__)
_SETTINGS: Any = numba.config
MOST_THREADS: int = _SETTINGS.NUMBA_NUM_THREADS
"""What numba was started with: processors, or NUMBA_NUM_THREADS."""


class NativeEnergy:
    """An OpenMM System's energy by kernels of our own, in double precision.

    A run repeats bit for bit on any number of threads. The same positions reached on another way may differ
    in the last digits: neighbour lists, and with them the order of sums, are those of where it came by.

    Parameters
    ----------
    twin : OpenMMEnergy
        The same energy by OpenMM: its System is what is compiled.
    threads : int
        Threads to compute on.

    Raises
    ------
    UnsupportedForceError
        If the System has a force without an exact counterpart here.
    """

    engine = "native"

    def __init__(self, twin: OpenMMEnergy, threads: int) -> None:
        terms = compile_system(twin.system)
        nobody = np.full((terms.n_atoms, 1), -1)
        layout = Layout(terms, nobody, partners(terms.nonbonded.exceptions.atoms, terms.n_atoms))
        if terms.nonbonded.cutoff < layout.near:
            raise UnsupportedForceError(f"NonbondedForce with a cutoff below {layout.near:.2g} nm")
        self._set(twin, threads, layout)

    def _set(self, twin: OpenMMEnergy, threads: int, layout: Layout) -> None:
        self.twin = twin
        self.threads = min(threads, MOST_THREADS)
        self.left_out: Mapping[str, int] = MappingProxyType({})
        self._layout = layout
        self._lists: Lists | None = None
        self._all: tuple[Layout, Lists, Lists, Floats] | None = None
        """With terms left out: the layout of all of them, its lists and one's own, and their positions."""

    @property
    def atoms(self) -> str:
        """Fingerprint of the structure it was built for; empty if the System was given."""
        return self.twin.atoms

    @property
    def reason(self) -> str:
        """Which kernels run, and what they leave out, in a sentence."""
        text = f"native kernels, double precision, {self.threads} threads"
        if self.left_out:
            text += "; constant in this chain: " + ", ".join(
                f"{n} {kind}" for kind, n in self.left_out.items()
            )
        return f"{text}; {self.twin.note}" if self.twin.note else text

    @property
    def system(self) -> Any:
        """The OpenMM System it evaluates."""
        return self.twin.system

    @property
    def forcefield(self) -> str:
        """Name of the force field."""
        return self.twin.forcefield

    @property
    def solvent(self) -> str:
        """Name of the solvent model."""
        return self.twin.solvent

    @property
    def reference(self) -> OpenMMEnergy:
        """The same energy on OpenMM's Reference platform."""
        return self.twin.reference

    @property
    def is_exact(self) -> bool:
        """Double precision: nothing to gain from going on elsewhere."""
        return True

    @property
    def fingerprint(self) -> str:
        """SHA-256 of the System."""
        return self.twin.fingerprint

    def __call__(self, x: Floats) -> tuple[float, Floats]:
        """Energy in kJ/mol and forces (na, 3) in kJ/mol/nm at positions x (na, 3) in nm.

        Raises
        ------
        ProtochainError
            If x does not fit the System.

        Notes
        -----
        Atoms on top of one another give large finite numbers. Positions that are not numbers give an
        infinite energy and forces that are not numbers: the caller's loop decides what that means.
        """
        parts, forces = self.parts(x)
        return sum(parts.values()) + self._constant, forces

    def parts(self, x: Floats) -> tuple[dict[str, float], Floats]:
        """Energy by kind, without the constant of what is left out, and forces.

        Parameters
        ----------
        x : (na, 3) float, nm

        Returns
        -------
        dict of str to float, kJ/mol; (na, 3) float, kJ/mol/nm
        """
        x = floats(x, (self._layout.terms.n_atoms, 3), "x")
        if not np.isfinite(x).all():
            return {"bonds": np.inf}, np.full(x.shape, np.nan)
        return evaluate(self._layout, self._lists_for(x), x, self._fixed_integral)

    def without_constants(self, groups: Integers, x: Floats) -> "NativeEnergy":
        """Leave out what keeps its value as long as each group of atoms moves as one rigid body.

        Parameters
        ----------
        groups : (na, k) int
            Groups of each atom, -1 for none. An atom on a hinge's axis belongs to both its bodies.
        x : (na, 3) float, nm
            Any positions with these groups as they stay.

        Returns
        -------
        NativeEnergy
            The same function of positions that keep the groups rigid; its forces add up to the same on
            each group.
        """
        x = read_only(floats(x, (self._layout.terms.n_atoms, 3), "x"))
        terms = self._layout.terms
        kept, left_out = {}, {}
        for kind, some in (*terms.bonded.items(), ("exceptions", terms.nonbonded.exceptions)):
            moving = ~_in_one_group(groups, some.atoms)
            kept[kind] = Bonded(some.atoms[moving], some.parameters[moving])
            left_out[kind] = int(len(moving) - moving.sum())
        nonbonded = replace(terms.nonbonded, exceptions=kept.pop("exceptions"))
        fewer = replace(terms, bonded=kept, nonbonded=nonbonded)
        less = NativeEnergy.__new__(NativeEnergy)
        # Exceptions left out still mark what the list of free pairs may not hold.
        less._set(self.twin, self.threads, replace(self._layout, terms=fewer, groups=groups))
        # Lists of these very positions, whatever was computed before: so runs repeat.
        mine, its = lists_of(self._layout, x), lists_of(less._layout, x)
        less._lists, less._all = its, (self._layout, mine, its, x)
        left_out["close pairs"] = len(mine.close) - len(its.close)
        less.left_out = MappingProxyType({kind: n for kind, n in left_out.items() if n})
        return less

    @cached_property
    def _fixed_integral(self) -> Floats:
        """(na,) float: what atoms of one group give to each other's Born integrals."""
        if self._all is None or self._layout.terms.solvent is None:
            return np.zeros(self._layout.terms.n_atoms)
        layout, lists, own_lists, x = self._all
        return born_integrals(layout, lists, x) - born_integrals(self._layout, own_lists, x)

    @cached_property
    def _constant(self) -> float:
        """Energy of what is left out."""
        if self._all is None:
            return 0.0
        layout, lists, own_lists, x = self._all
        whole, _ = evaluate(layout, lists, x, np.zeros(len(x)))
        moving, _ = evaluate(self._layout, own_lists, x, self._fixed_integral)
        return sum(whole.values()) - sum(moving.values())

    @property
    def lists_at(self) -> Floats | None:
        """(na, 3) float, nm: positions that the neighbour lists in use were made at."""
        return self._lists.x if self._lists else None

    def list_at(self, x: Floats) -> None:
        """Make the neighbour lists as they are at positions x (na, 3), as after computing there first."""
        self._lists = lists_of(self._layout, floats(x, (self._layout.terms.n_atoms, 3), "x"))

    def _lists_for(self, x: Floats) -> Lists:
        """Neighbour lists that hold at x; all computing passes here first."""
        _announce()
        numba.set_num_threads(self.threads)
        lists = self._lists
        if lists is None or not lists.still_hold(x):
            lists = self._lists = lists_of(self._layout, x)
        return lists

    def __repr__(self) -> str:
        return f"<NativeEnergy {self.forcefield}, {self.solvent}: {self.reason}>"


@cache
def _announce() -> None:
    """Say that kernels have to be compiled, which takes a minute on a fresh installation."""
    kernel: Any = pairs.exception_sums
    if not any(Path(kernel._cache.cache_path).glob("pairs.exception_sums*.nbi")):
        _LOG.warning("compiling the energy kernels for this machine; this happens once")


def _in_one_group(groups: Integers, atoms: Integers) -> np.ndarray:
    """(n,) bool: whether all atoms of a term have a group in common."""
    together = np.zeros(len(atoms), dtype=bool)
    if not atoms.size:
        return together
    for column in range(groups.shape[1]):
        group = groups[atoms[:, 0], column]
        shared = (groups[atoms] == group[:, None, None]).any(axis=2).all(axis=1)
        together |= shared & (group >= 0)
    return together
