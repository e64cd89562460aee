"""Recipes: every method by name, as the stages it runs."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib import import_module
from inspect import signature
from types import MappingProxyType
from typing import Any

import numpy as np

from protochain.chains.chain import Chain
from protochain.chains.contacts import overlaps
from protochain.core import defaults
from protochain.core.arrays import Floats
from protochain.core.checks import check_arguments, number, one_of, refuse_class
from protochain.core.errors import Argument, ProtochainError, refusal
from protochain.core.settings import document_fields
from protochain.energies.factory import lacks_dihedrals
from protochain.energies.protocol import Energy
from protochain.minimisers.annealing import Annealing
from protochain.minimisers.clash_resolution import (
    STRAINED_TORQUE,
    TetheredModel,
    all_atom_clash_stages,
    run_if_unstrained,
    torsion_clash_stages,
)
from protochain.minimisers.curvature import near_terms
from protochain.minimisers.descent import Descent
from protochain.minimisers.entropy_bound import METRIC_NAMES, EntropyBound, MetricName, TurnBound
from protochain.minimisers.fire import Fire
from protochain.minimisers.kcm import KCM, Proportional, by_length, by_sign
from protochain.minimisers.lbfgs import LBFGS, NEAR_MEMORY
from protochain.minimisers.loop import Method
from protochain.minimisers.metrics import NEAR_REFRESH, Damped, Mass, Stiffness
from protochain.minimisers.newton import Newton, PseudoTransient
from protochain.minimisers.problem import Force, Space
from protochain.minimisers.restraints import Hold, tethers_in
from protochain.minimisers.spaces import spaces
from protochain.minimisers.stages import PATIENCE, Answer, Stage, last, lowest, moving_part, with_reference
from protochain.minimisers.steps import AcceptReject, Armijo, Decaying, Fixed, StrongWolfe
from protochain.validation.rings import threaded_rings


@document_fields
@dataclass(frozen=True)
class Run:
    """A stage of a recipe, for any chain and energy."""

    method: Method  # As the loop runs it.
    in_torsions: bool = True  # Whether hinges turn; otherwise all atoms move.
    tolerance: float | None = None  # Default: the tolerance of the whole minimisation.
    patience: int = PATIENCE  # As of :class:`Stage`.
    answer: Answer = lowest  # As of :class:`Stage`.
    # Whether to continue on the energy's double-precision reference if single precision fails.
    continued: bool = True
    # Replaces ``method`` if the near terms of an energy are not known, e.g. for a callable.
    by_springs: Method | None = None

    def stages(self, space: Space, energy: Energy, tolerance: float, restraint: Force | None) -> list[Stage]:
        """Stage on an energy, and a second one on its reference if this is another engine."""
        tolerance = tolerance if self.tolerance is None else self.tolerance
        method = _add_tethers(self.method, tethers_in(restraint))
        stage = Stage(
            space, method, energy, tolerance, restraint, patience=self.patience, answer=self.answer,
            name="torsions" if self.in_torsions else "all atoms",
        )  # fmt: skip
        return with_reference(stage) if self.continued else [stage]


def check_dihedrals(energy: Energy, subject: str) -> None:
    """Raise an error for a method that moves all atoms and an energy without dihedral terms."""
    # A System of the caller is used as it is.
    if energy.atoms and lacks_dihedrals(energy):
        raise ProtochainError(
            f"{subject} moves all atoms, and an energy without dihedral terms would twist peptide bonds; "
            "choose a method that only turns hinges, as lbfgs, or all terms"
        )


def _add_tethers(method: Any, tether: Floats | None) -> Method:
    """Method whose model of the Hessian includes the springs (na,) of a restraint."""
    metric = getattr(getattr(method, "direction", None), "metric", None)
    has_stiffness = isinstance(method, Descent) and isinstance(method.direction, LBFGS | Newton | KCM)
    if tether is None or not has_stiffness or not isinstance(metric, Stiffness):
        return method
    model = TetheredModel(tether, refresh_every=metric.refresh_every)
    return replace(method, direction=replace(method.direction, metric=model))


@document_fields
@dataclass(frozen=True)
class Recipe:
    """A named method, as the stages it runs."""

    name: str  # A method of ``METHODS``, or a custom one.
    # In order of execution, the last once for each restraint. OpenMM's methods have none.
    runs: tuple[Run, ...] = ()
    # Whether overlapping atoms are separated locally first, while springs restrain all others. Methods that
    # turn hinges do this also at large torques. KCM follows the torques alone.
    parts_overlaps: bool = False
    draws_random: bool = False  # Whether its result depends on the seed.
    by_openmm: bool = False  # Whether OpenMM's own minimiser runs.
    typical: int = 0  # Usual evaluations to converge, or 0 if they are not known or usually all are used.

    @property
    def keeps_geometry(self) -> bool:
        """Whether only hinges turn.

        Bond lengths and angles are then constant, except opened ones and at closures of rings and disulfides.
        """
        return not self.by_openmm and all(run.in_torsions for run in self.runs)

    def tolerance(self, user_tolerance: float | None = None) -> float:
        """Tolerance of the user, or the default for the freedoms of the last run."""
        default = defaults.TOLERANCE if self.keeps_geometry else defaults.TOLERANCE_IN_ALL_ATOMS
        return default if user_tolerance is None else user_tolerance

    @property
    def in_torsions(self) -> bool:
        """Whether hinges turn in any of its runs."""
        return any(run.in_torsions for run in self.runs)

    @property
    def states(self) -> tuple[type, ...]:
        """Classes of the states that a checkpoint stores, or none if a method lists none."""
        classes = [getattr(run.method, "states", ()) for run in self.runs]
        return tuple(state for states in classes for state in states) if all(classes) else ()

    @property
    def moves_masses(self) -> bool:
        """Whether bodies move in proportion to their masses. A fixed root would have infinite mass."""
        methods: list[Any] = [run.method for run in self.runs]
        metrics = [getattr(getattr(method, "direction", method), "metric", None) for method in methods]
        return any(isinstance(part, Annealing | Mass) for part in (*methods, *metrics))

    def repeats_exactly(self, energy: Energy) -> bool:
        """Whether runs from one start are equal bit for bit."""
        # OpenMM's CPU platform, which also runs OpenMM's methods, has no fixed order of sums on several
        # threads, nor do its other devices.
        sums_in_order = energy.threads == 1 or (energy.engine != "openmm" and not self.by_openmm)
        return not self.draws_random and sums_in_order and energy.device == "cpu"

    def check(self, energy: Energy) -> None:
        """Raise a ProtochainError for an energy that the method cannot use."""
        if self.by_openmm and energy.system is None:
            raise ProtochainError(
                f"method {self.name!r} requires an OpenMM System, which a callable lacks; choose another"
            )
        if not self.keeps_geometry:
            check_dihedrals(energy, f"method {self.name!r}")

    def plan(
        self, chain: Chain, energy: Energy, reduced: Energy, tolerance: float, hold: Hold, seed: int,
        max_torque: float = 0.0,
    ) -> list[Stage]:  # fmt: skip
        """Stages of this recipe.

        ``reduced`` is the energy without terms that are constant in the chain. ``max_torque`` is the largest
        torque at the start.
        """
        terms = near_terms(energy)
        torsions, atoms = spaces(chain, terms)
        restraints = hold.restraints(chain.structure)
        overlap = self.parts_overlaps and bool(overlaps(chain.structure, chain.structure.positions))
        is_strained = overlap
        if self.parts_overlaps and self.in_torsions:
            # Turned bonds have long levers.
            is_strained |= not max_torque <= STRAINED_TORQUE
        elif self.runs and not self.in_torsions:
            # Even free atoms do not leave a ring by themselves.
            is_strained |= bool(threaded_rings(chain.structure))
        # Stages that resolve clashes.
        plan: list[Stage] = []
        if is_strained and self.keeps_geometry:
            plan += torsion_clash_stages(torsions, reduced, tolerance, restraints[0], overlap)
        elif is_strained:
            plan += all_atom_clash_stages(torsions, atoms, energy, tolerance, restraints[0], overlap)
        # Stages of each run, of the last one for each restraint.
        for run in self.runs:
            space, run_energy = (torsions, reduced) if run.in_torsions else (atoms, energy)
            method: Any = run.by_springs if terms is None and run.by_springs else run.method
            if hasattr(method, "seed") and hasattr(method, "__dataclass_fields__"):
                method = replace(method, seed=seed)
            for restraint in restraints if run is self.runs[-1] else restraints[:1]:
                stages = replace(run, method=method).stages(space, run_energy, tolerance, restraint)
                if is_strained and run.in_torsions:
                    all_terms = None if self.keeps_geometry else energy
                    stages = [run_if_unstrained(stage, all_terms) for stage in stages]
                if not run.in_torsions and not chain.moving.all():
                    stages = [moving_part(stage, chain.moving) for stage in stages]
                plan += stages
        return plan


_LBFGS = Descent(LBFGS(Stiffness(refresh_every=NEAR_REFRESH), NEAR_MEMORY), StrongWolfe())
_TORSIONS = Run(_LBFGS, by_springs=Descent(LBFGS(), StrongWolfe()))
_ALL_ATOMS = Run(
    _LBFGS, in_torsions=False, by_springs=Descent(LBFGS(Stiffness(refresh_every=40)), StrongWolfe())
)
"""Springs are renewed less often: bonds and angles, most of them, change little, and the matrix is costly."""
_NEAR = replace(_ALL_ATOMS, method=replace(_LBFGS, direction=LBFGS(Damped(NEAR_REFRESH), NEAR_MEMORY)))
HYBRID_TORQUE = 300.0
"""kJ/mol/rad. Tolerance in torsions before all atoms move. The remaining strain is in bonds and angles."""
_TYPICAL = {
    "lbfgs": 50, "newton": 400, "cartesian": 70, "hybrid": 80, "openmm": 1500, "openmm-md": 3000,
}  # fmt: skip
"""Evaluations to a tolerance of 1: rounded medians of proteins of 20 to 129 residues. To 5, about half."""


def _in_torsions(name: str, method: Method, parts_overlaps: bool = False) -> Recipe:
    return Recipe(name, (Run(method),), parts_overlaps)


def _dynamics(name: str, annealing: Annealing, draws_random: bool) -> Recipe:
    """Dynamics, then minimisation from its last point."""
    run = Run(annealing, tolerance=0.0, patience=annealing.n_steps, answer=last, continued=False)
    typical = annealing.n_steps + _TYPICAL["lbfgs"]
    return Recipe(name, (run, _TORSIONS), True, draws_random, typical=typical)


ANGLE = 0.0005
"""rad. Turn of the hinge of largest torque in a step of ``kcm``, and in the first of adaptive variants."""
ENTROPY_RATE = 0.5
"""nm/rad. Bound of ``kcm-entropy``. At a start, C-alphas move by 2 to 3 nm per radian (RMS) in ``kcm``."""
_TABLE = (
    _in_torsions("kcm", Descent(KCM(), Fixed(ANGLE))),
    _in_torsions("kcm-2norm", Descent(KCM(norm=by_length), Fixed(0.002))),
    _in_torsions("kcm-sign", Descent(KCM(norm=by_sign), AcceptReject(ANGLE))),
    _in_torsions("kcm-proportional", Descent(Proportional(), Fixed(1.0))),
    _in_torsions("kcm-decaying", Descent(KCM(), Decaying(0.002, 200.0))),
    _in_torsions("kcm-adaptive", Descent(KCM(), AcceptReject(ANGLE))),
    _in_torsions("kcm-armijo", Descent(KCM(), Armijo(ANGLE, window=5))),
    _in_torsions("kcm-transient", PseudoTransient()),
    _in_torsions("kcm-metric", Descent(KCM(Mass()), AcceptReject(ANGLE))),
    _in_torsions("kcm-stiffness", Descent(KCM(Stiffness()), AcceptReject(ANGLE))),
    _in_torsions("kcm-entropy", Descent(EntropyBound(rate=ENTROPY_RATE), Fixed(ANGLE))),
    _in_torsions("fire", Fire()),
    _in_torsions("quench", Fire(mixing=1.0, fade=1.0)),
    _dynamics("md", Annealing(), draws_random=False),
    _dynamics("anneal", Annealing(temperature=600.0, n_steps=2000), draws_random=True),
    _in_torsions("newton", Descent(Newton(), StrongWolfe()), parts_overlaps=True),
    Recipe("lbfgs", (_TORSIONS,), parts_overlaps=True),
    Recipe("cartesian", (_NEAR,), parts_overlaps=True),
    Recipe("hybrid", (replace(_TORSIONS, tolerance=HYBRID_TORQUE), _ALL_ATOMS), parts_overlaps=True),
    Recipe("openmm", by_openmm=True),
    Recipe("openmm-md", by_openmm=True, draws_random=True),
)
RECIPES: Mapping[str, Recipe] = MappingProxyType(
    {recipe.name: replace(recipe, typical=_TYPICAL.get(recipe.name, recipe.typical)) for recipe in _TABLE}
)
"""``cartesian`` moves all atoms, ``hybrid`` turns hinges first, ``openmm`` is OpenMM's minimiser and
``openmm-md`` its constrained dynamics between two minimisations. All others turn hinges."""

METHODS = tuple(RECIPES)


@check_arguments(metric=one_of(METRIC_NAMES))
def kcm(
    angle: float = ANGLE,
    entropy_bound: float | None = None,
    metric: MetricName = "positions",
    turn_bound: float | None = None,
) -> Recipe:
    """KCM with a fixed angle, and optionally a bound on each step, for ``method=`` of other functions.

    Parameters
    ----------
    angle : float, rad
        Turn of the hinge of largest torque, in every step.
    entropy_bound : float, optional
        Largest step in the metric. A longer step is replaced by the nearest one within the bound.
    metric : str
        Measure of a step: ``positions`` (RMS movement of the C-alphas, nm), ``contacts`` (the same, weighted
        by the contacts of each C-alpha), ``mass`` (RMS movement of all atoms, weighted by mass, nm) or
        ``turns`` (RMS turn, rad).
    turn_bound : float, optional, rad
        Largest turn of any hinge in a step. Larger turns are limited to it.

    Returns
    -------
    Recipe
        Its name contains the settings, so that one comparison can have several.

    Raises
    ------
    ProtochainError
        If an angle or a bound is not above 0, or both bounds are set.

    Examples
    --------
    >>> c = pc.build_chain(pc.from_sequence("GAG"))
    >>> r = pc.minimise(c, method=pc.kcm(angle=0.01, entropy_bound=0.001), max_evaluations=20)
    >>> r.end.energy < r.start.energy
    True
    """
    recipe = at_angle(RECIPES["kcm"], angle)
    if entropy_bound is None and turn_bound is None:
        return recipe
    if entropy_bound is not None and turn_bound is not None:
        raise ProtochainError("entropy_bound and turn_bound cannot be combined; set one of them")
    # A direction is a step for an angle of 1 rad.
    if entropy_bound is not None:
        rate = _above_zero(entropy_bound, "entropy_bound") / angle
        direction: KCM = EntropyBound(rate=rate, within=metric)
        label = f"entropy-{metric}-{entropy_bound:g}"
    else:
        direction = TurnBound(limit=_above_zero(turn_bound, "turn_bound") / angle)
        label = f"turns-{turn_bound:g}"
    (run,) = recipe.runs
    bounded = replace(run, method=Descent(direction, Fixed(float(angle))))
    return replace(recipe, name=f"{recipe.name}-{label}", runs=(bounded,))


def _above_zero(value: Any, name: str) -> float:
    if not number(value, name) > 0.0:
        raise refusal(name, f"{value:g}", "give a number above 0")
    return float(value)


def at_angle(recipe: Recipe, angle: float) -> Recipe:
    """Method of KCM with another initial or fixed angle, rad."""
    if not 0.0 < number(angle, "angle") <= np.pi:
        raise refusal("angle", f"{angle:g}", "give a number above 0, at most pi, in rad")
    if not _has_angle(recipe):
        names = ", ".join(name for name, candidate in RECIPES.items() if _has_angle(candidate))
        raise ProtochainError(Argument("angle"), f": does not apply to {recipe.name!r}; choose from {names}")
    (run,) = recipe.runs
    method: Any = run.method
    adjusted = replace(method, rule=replace(method.rule, length=float(angle)))
    return replace(recipe, name=f"{recipe.name}-{angle:g}", runs=(replace(run, method=adjusted),))


def _has_angle(recipe: Recipe) -> bool:
    methods: list[Any] = [run.method for run in recipe.runs]
    return len(methods) == 1 and isinstance(methods[0], Descent) and isinstance(methods[0].direction, KCM)


def recipe_of(method: Any) -> Recipe:
    """Recipe of a method.

    Parameters
    ----------
    method : str, Recipe, or Method
        A name of ``METHODS``, the import path ``module:name`` of a method, or any object with ``init`` and
        ``step`` (or a direction and a step rule in a :class:`Descent`), which minimises in torsions. Objects
        with a field ``seed`` count as random, and a dataclass receives the seed of its run.

    Returns
    -------
    Recipe
        An object is named after its class, a descent after the class of its direction.

    Raises
    ------
    ProtochainError
        If the method does not exist.
    """
    if isinstance(method, Recipe):
        return method
    if isinstance(method, str):
        if method in RECIPES:
            return RECIPES[method]
        if ":" not in method:
            raise ProtochainError(
                f"method {method!r} is not known; choose from {', '.join(METHODS)}, or give module:name"
            )
        module, _, name = method.partition(":")
        try:
            imported = getattr(import_module(module), name)
        except (ImportError, AttributeError, ValueError) as error:
            raise ProtochainError(f"method {method!r} cannot be imported: {error}") from None
        return recipe_of(imported() if isinstance(imported, type) else imported)
    refuse_class(method, "method")
    if callable(getattr(method, "step", None)) and "direction" in signature(method.step).parameters:
        raise ProtochainError(
            f"method {method!r} is a step rule: add a direction, as Descent(direction, {method!r})"
        )
    if not (hasattr(method, "init") and hasattr(method, "step")):
        raise ProtochainError(
            f"method {method!r}: give a name, or an object with init and step, as Descent(direction, rule)"
        )
    name = type(method.direction if isinstance(method, Descent) else method).__name__
    return Recipe(name, (Run(method),), draws_random=hasattr(method, "seed"))
