"""``compare``: several methods from one prepared start, with ends judged by the same rules."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from typing import Any

from protochain.chains.articulate import with_energy
from protochain.comparison.comparison import Comparison
from protochain.core import checks, defaults
from protochain.core.arrays import Watcher
from protochain.core.errors import ProtochainError
from protochain.core.interrupts import held_interrupts
from protochain.minimisers import METHODS, Recipe, Solution, Status, recipe_of
from protochain.minimisers.minimise_settings import MinimiseSettings
from protochain.minimisers.minimise_structure import Minimisation, minimise_from
from protochain.minimisers.start import Start
from protochain.structure import as_structure
from protochain.structure.matching import match

SETTINGS = tuple(
    f.name for f in fields(MinimiseSettings) if f.name not in ("tolerance", "restraints", "max_rmsd")
)
"""Settings of a minimisation that a comparison has too, without restraints to the start."""


@checks.check_arguments(methods=checks.several, repeats=checks.at_least(1), watch=checks.function("method"))
@held_interrupts()
def compare(
    structure: Any,
    methods: str | Sequence[Any] = defaults.COMPARED,
    energy: Any = None,
    tolerance: float = defaults.TOLERANCE,
    *,
    repeats: int = defaults.REPEATS,
    reference: Any = None,
    watch: Callable[[str], Watcher] | None = None,
    **settings: Any,
) -> Comparison:
    """Minimise one structure by several methods from the same prepared start.

    Parameters
    ----------
    structure : Chain, Structure, path, or anything that :func:`protochain.as_structure` accepts
        The common start.
    methods : str, or sequence of str, Recipe, or object with ``init`` and ``step``
        As in :func:`protochain.minimise`.
    energy : Energy or callable, optional
        As in :func:`protochain.minimise`. All methods share one energy function.
    tolerance : float
        As in :func:`protochain.minimise`.
    repeats : int
        Runs of each method that does not repeat exactly (it draws random numbers, or OpenMM sums on several
        threads), with consecutive seeds. The first is shown, and ``Comparison.spread`` covers all.
    reference : Structure, path, or anything that :func:`protochain.as_structure` accepts, optional
        Structure to measure the ends against, for example an experimental one.
    watch : callable, optional
        Function of a method's name that returns the ``watch`` of its run.
    **settings
        As in :func:`protochain.minimise`: ``max_evaluations``, ``seed``, ``curvature``, ``judge``.

    Returns
    -------
    Comparison
        Solutions, with all ends judged by the same judge in double precision. An interrupt ends the
        current run and skips the remaining runs.

    Raises
    ------
    ProtochainError
        If a method is unknown or the input cannot be used.

    Examples
    --------
    >>> found = pc.compare(pc.from_sequence("GAG"), methods="lbfgs,cartesian")
    >>> [record["method"] for record in found.records()]
    ['lbfgs', 'cartesian']
    """
    recipes: dict[str, Recipe] = {}
    for recipe in map(recipe_of, methods):
        if recipes.setdefault(recipe.name, recipe) != recipe:
            raise ProtochainError(
                f"two methods are named {recipe.name!r}; rename one: Recipe(name, (Run(method),))"
            )
    if not recipes:
        raise ProtochainError(f"no methods to compare; choose from {', '.join(METHODS)}")
    for name in settings:
        checks.refuse_misplaced("compare", name)
        checks.refuse_unknown(name, "setting", SETTINGS)
    runs = [Minimisation(recipe, tolerance=tolerance, **settings) for recipe in recipes.values()]
    chain, energy = with_energy(structure, energy)
    if reference is not None:
        reference = as_structure(reference)
        match(reference, chain.structure)  # Raises before the work if nothing matches.
    for run in runs:
        run.recipe.check(energy)
    # All runs share one start. Methods that do not repeat exactly run with several seeds.
    start = Start(chain, energy, runs[0].judge)
    plan = [(run, k) for run in runs for k in range(1 if run.recipe.repeats_exactly(energy) else repeats)]
    solutions: list[Solution] = []
    repeat_runs: list[Solution] = []
    for run, k in plan:
        watcher = watch(run.recipe.name) if watch else None
        try:
            solution = minimise_from(start, replace(run, seed=run.seed + k), watcher)
        except KeyboardInterrupt:
            if not solutions:
                raise
            break
        interrupted = solution.status is Status.INTERRUPTED
        if not (interrupted and k):
            (repeat_runs if k else solutions).append(solution)
        if interrupted:
            break
    return Comparison(chain.structure, tuple(solutions), reference=reference, repeats=tuple(repeat_runs))
