"""What a feature costs a run that does not use it: held against a build in which its code cannot be called.

The build is the code's own text without the lines that call the feature, compiled beside it. Where the text
has changed so that a line is not found, the study says so and fails.
"""

import inspect
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from types import ModuleType
from typing import Any

import numba
import numpy as np

from protochain.analysis.studies.scenes.cells import Material, least
from protochain.analysis.studies.scenes.energies import summed
from protochain.analysis.studies.scenes.runs import begun, calm, propagator
from protochain.dynamics.loop import advance
from protochain.dynamics.thermostats import Isolated
from protochain.energies import NativeEnergy
from protochain.energies.native import tasks
from protochain.errors import ProtochainError
from protochain.minimisers.problem import evaluate
from protochain.minimisers.spaces import Torsions
from protochain.motion.leapfrog import Leapfrog
from protochain.motion.system import System

ALLOWED = 2.0
"""Per cent that a feature may cost where it is not used."""
Edit = tuple[str, str]
"""Text of a module, and what stands in its place."""


@dataclass(frozen=True)
class Cost:
    """Cost of a feature that is not used: a line of ``features.csv``."""

    feature: str
    of: str
    structure: str
    verdict: str
    here_ms: float = field(default=np.nan, compare=False)
    without_ms: float = field(default=np.nan, compare=False)
    percent: float = field(default=np.nan, compare=False)
    is_within: bool = field(default=False, compare=False)
    message: str = ""


@dataclass(frozen=True)
class Feature:
    """A feature, and how its code is taken out.

    Parameters
    ----------
    name, of : str
        Feature, and what is timed.
    where : function, class or module
        Where it is called.
    edits : tuple of (str, str)
        Texts of it, and what replaces them.
    call : callable
        Material and names made by :func:`without` -> a call to time, whose answer is compared.
    in_quick : bool
        Whether ``--quick`` has it; kernels take seconds to compile.
    """

    name: str
    of: str
    where: Any
    edits: tuple[Edit, ...]
    call: "Callable[[Material, Mapping[str, Any]], Callable[[], Any]]"
    in_quick: bool = True


@cache
def without(where: Any, edits: tuple[Edit, ...]) -> dict[str, Any]:
    """Names of a module, with a function or class of it, or all of it, made from edited text.

    Raises
    ------
    ProtochainError
        If a text is not there.
    """
    text, name = inspect.getsource(where), where.__name__
    for old, new in edits:
        if old not in text:
            raise ProtochainError(f"{name} has no longer {old.strip()!r}: edit features.py")
        text = text.replace(old, new)
    whole = isinstance(where, ModuleType)
    names = {"__name__": name} if whole else dict(vars(sys.modules[where.__module__]))
    # Kernels compiled for this alone: the cache of the module's own must not hold them.
    names["_compiled"] = numba.njit(error_model="numpy", nogil=True)
    exec(compile(text.replace("@shared", "@_compiled"), f"<{name} without>", "exec"), names)
    return names


def costs(material: Material, seconds: float, features: "Iterable[Feature]") -> Iterator[Cost]:
    """Time the absence of features."""
    for feature in features:
        named = (feature.name, feature.of, material.structure.name)
        try:
            here = feature.call(material, without(feature.where, ()))
            removed = feature.call(material, without(feature.where, feature.edits))
            same = _equal(here(), removed())
        except Exception as failure:  # whatever it is, the cell is wrong and the others go on
            yield Cost(*named, "wrong", message=f"{type(failure).__name__}: {failure}")
            continue
        a, b = least([here, removed], seconds)
        percent = 100.0 * (a / b - 1.0)
        verdict = "right" if same else "wrong"
        yield Cost(*named, verdict, 1e3 * a, 1e3 * b, percent, percent <= ALLOWED)


def _equal(a: Any, b: Any) -> bool:
    return all(np.array_equal(one, other) for one, other in zip(a, b, strict=True))


def _evaluation(material: Material, names: Mapping[str, Any]) -> Callable[[], Any]:
    """Evaluation of a minimiser in torsions and vacuum."""
    chain = calm(material)
    space, whole = Torsions(chain), material.energy("vacuum")

    def call() -> Any:
        found = names["evaluate"](space, whole, chain.q0)
        return found.energy, found.torque

    return call


def _energy(material: Material, names: Mapping[str, Any]) -> Callable[[], Any]:
    """Energy and forces in vacuum, by the class as it is edited."""
    made = names["NativeEnergy"](material.energy("vacuum").by_openmm, 1)
    return lambda: made(material.structure.positions)


def _kernel(solvent: str) -> "Callable[[Material, Mapping[str, Any]], Callable[[], Any]]":
    """All kernels of an energy, as one thread calls them."""

    def make(material: Material, names: Mapping[str, Any]) -> Callable[[], Any]:
        x = material.structure.positions
        evaluation = summed(material.energy(solvent).terms, x)
        evaluation(x)
        given, workspace = evaluation.given, evaluation.workspace

        def call() -> Any:
            names["work"](*given)
            return workspace.parts, workspace.forces

        return call

    return make


def _step(material: Material, names: Mapping[str, Any]) -> Callable[[], Any]:
    """A step at constant energy, by the loop as it is edited."""
    of = propagator(material, Isolated())
    start = begun(of, calm(material))

    def call() -> Any:
        at = names["advance"](of, start).at
        return at.q, at.p, at.potential

    return call


def _leapfrog(material: Material, names: Mapping[str, Any]) -> Callable[[], Any]:
    """A step of the leapfrog as it is edited."""
    of = propagator(material, Isolated())
    start, method = begun(of, calm(material)).at, names["Leapfrog"]()

    def call() -> Any:
        at = method.step(of.system, start, of.time_step)
        return at.q, at.p, at.potential

    return call


def _unloaded(material: Material, names: Mapping[str, Any]) -> Callable[[], Any]:
    """A step of the leapfrog, of a system as it is edited."""
    of = propagator(material, Isolated())
    start, system = begun(of, calm(material)).at, names["System"](of.system.tree, of.system.potential)

    def call() -> Any:
        at = Leapfrog().step(system, start, of.time_step)
        return at.q, at.p, at.potential

    return call


_TIES = (
    ("    bonded.bond_sums(mine, x, *ties, sums, parts[TIES])\n", ""),
    ("    bonded.angle_sums(mine, x, *tie_angles, sums, parts[TIE_ANGLES])\n", ""),
)
_SOLVENT = (
    (
        "    if solvent is None:\n        in_vacuum(step % _IN_VACUUM, mine, state, vacuum, terms, maps)\n"
        "    else:\n"
        "        in_solvent(step % _IN_SOLVENT, mine, state, vacuum, terms, maps, solvent, necks)\n",
        "    in_vacuum(step % _IN_VACUUM, mine, state, vacuum, terms, maps)\n",
    ),
    ("(_IN_VACUUM if solvent is None else _IN_SOLVENT)", "_IN_VACUUM"),
)
_NECKS = (
    ("    if necks is not None:\n        table, kind, necked, reach = necks\n"
     "        neck.neck_sums(mine, atoms, table, kind, necked, reach, cutoff, sums)\n", ""),
    ("    if necks is not None:\n        table, kind, necked, reach = necks\n"
     "        neck.neck_force_sums(mine, atoms, table, kind, necked, reach, cutoff, sums)\n", ""),
)  # fmt: skip
_REGIONS = (
    (" + self._constants[0], forces", ", forces"),
    ("self._constants[1], workspace", "np.zeros(len(x)), workspace"),
)
_FIXED = (("    for i in range(begin, end):\n        integral[i] += fixed[i]\n", ""),)
_SPRINGS = (
    ("    if restraint is not None:\n        penalty, pull = restraint(pose.x)\n"
     "        forces = forces + pull\n", ""),
)  # fmt: skip
_THERMOSTAT = (
    ("    rng = noise(propagator.seed, step) if thermostat.draws else _UNUSED\n", ""),
    ("    at, bath = thermostat.apply(system, at, state.bath, propagator.time_step, rng)\n",
     "    bath = state.bath\n"),
)  # fmt: skip
_DAMPERS = (
    ("    shake = noise(propagator.seed, step, 1) if dampers is not None else _UNUSED\n"
     "    if dampers is not None:\n"
     "        at, damped = _damped(propagator, dampers, at, damped, shake)\n", ""),
    ("    if dampers is not None:\n"
     "        at, damped = _damped(propagator, dampers, at, damped, shake)\n", ""),
)  # fmt: skip
_CLOSURES = (
    ("        if system.constraint is None:\n            return kicked\n"
     "        there = system.with_velocities(kicked, kicked.qd)\n"
     "        # The power at the end is that of velocities on the constraint.\n"
     "        work = kicked.work + 0.5 * time_step * (there.power - kicked.power)\n"
     "        return there if kicked.loads is None else replace(there, work=work)\n",
     "        return kicked\n"),
    ("        if system.constraint is None:\n            return self.drift(at, kicked, time_step)\n"
     "        return system.constraint.drift(self.drift, at, kicked, time_step)\n",
     "        return self.drift(at, kicked, time_step)\n"),
)  # fmt: skip
_LOADS = (
    ("        if not self.loads:\n            return potential, torque, None\n"
     "        loads = np.array([self.along(load, time, q, qd, factors) for load in self.loads])\n"
     "        return potential, torque + loads.sum(axis=0), loads\n",
     "        return potential, torque, None\n"),
    ("        if loads is None:\n            return at\n"
     "        return replace(at, work=before.work + 0.5 * time_step * (before.power + at.power))\n",
     "        return at\n"),
)  # fmt: skip

FEATURES = (
    Feature("solvent", "kernels, vacuum", tasks, _SOLVENT, _kernel("vacuum")),
    Feature("necks", "kernels, OBC2", tasks, _NECKS, _kernel("obc2"), False),
    Feature("kept molecules", "kernels, vacuum", tasks, _TIES, _kernel("vacuum"), False),
    Feature("regions", "energy, vacuum", NativeEnergy, _REGIONS, _energy),
    Feature("regions", "kernels, OBC2", tasks, _FIXED, _kernel("obc2"), False),
    Feature("springs", "evaluation, vacuum", evaluate, _SPRINGS, _evaluation),
    Feature("closures", "leapfrog, vacuum", Leapfrog, _CLOSURES, _leapfrog),
    Feature("loads", "leapfrog, vacuum", System, _LOADS, _unloaded),
    Feature("thermostat", "step, vacuum", advance, _THERMOSTAT, _step),
    Feature("dampers", "step, vacuum", advance, _DAMPERS, _step),
)
"""Each is compared to the bit with its absence; solvent and necks are compiled away where they are None."""
