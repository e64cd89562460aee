"""Energy against dihedrals: rigid, or with all other hinges relaxed."""

from collections.abc import Callable, Iterator, Mapping
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from protochain.chains.articulate import build_chain, with_energy
from protochain.chains.chain import Chain, pose
from protochain.core.arrays import floats
from protochain.core.checks import check_arguments, flag, function
from protochain.core.errors import ProtochainError
from protochain.core.interrupts import held_interrupts
from protochain.core.lazy_pandas import pd
from protochain.minimisers import minimise

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ENERGY = "energy_kj_mol"
_MOST = 60.0  # kJ/mol above the lowest: upper limit of the map.
_STEEP = 1000.0  # kJ/mol above the lowest, more if atoms overlap: limit of the linear part of a curve.


@check_arguments(relax=flag, watch=function("done", "total"))
def scan(
    chain: Any, energy: Any = None, grids: Mapping[str, Any] | None = None, *, relax: bool = False,
    watch: Callable[[int, int], None] | None = None,
) -> "pd.DataFrame":  # fmt: skip
    """Compute the energy on a grid of dihedrals.

    Parameters
    ----------
    chain : Chain, Structure, path, or anything that :func:`protochain.as_structure` accepts
        Chain whose hinges turn. Each point starts from its input pose.
    energy : Energy or callable, optional
        As in :func:`protochain.minimise`.
    grids : mapping of str to sequence of float, degrees
        Values of each hinge by its name, as ``{"phi A:3": range(-180, 180, 10)}``, all combined.
    relax : bool
        Whether all other hinges are minimised at each point, by ``lbfgs``.
    watch : callable, optional
        Called after each point with the number of computed points, and of all points.

    Returns
    -------
    pandas.DataFrame
        A row for each point: a column for each hinge, ``energy_kj_mol``, and with ``relax`` ``status``.

    Raises
    ------
    ProtochainError
        If no hinge of a name turns, or a grid is empty.

    Examples
    --------
    >>> c = pc.build_chain(pc.from_sequence("GAG"))
    >>> table = pc.scan(c, None, {"phi A:2": [-120, -60]})
    >>> table["energy_kj_mol"].idxmin()
    1
    """
    cut, energy = with_energy(chain, energy)
    if not isinstance(grids, Mapping) or not grids:
        raise ProtochainError("grids: give values by the names of hinges, as {'phi A:3': [-60, 60]}")
    axes = {str(name): floats(values, (np.size(values),), "grids") for name, values in grids.items()}
    for name, values in axes.items():
        cut.hinge(name)
        if not len(values) or not np.isfinite(values).all():
            raise ProtochainError(f"grids: {name}: give finite numbers, in degrees")
    rows, total = [], int(np.prod([len(values) for values in axes.values()]))
    with held_interrupts() as interrupts:
        for row in _points(cut, energy, axes, relax):
            if interrupts:
                raise KeyboardInterrupt
            rows.append(row)
            if watch:
                watch(len(rows), total)
    return pd.DataFrame(rows)


def _points(cut: Chain, energy: Any, axes: Mapping[str, Any], relax: bool) -> Iterator[dict[str, Any]]:
    closed = " ".join(f"-{cut.hinges[cut.hinge(name)].name.replace(' ', '@')}" for name in axes)
    for values in product(*(axis_values.tolist() for axis_values in axes.values())):
        row: dict[str, Any] = dict(zip(axes, values, strict=True))
        x = pose(cut, cut.set(row)).x
        if relax:
            at = build_chain(
                cut.structure.with_positions(x), f"{cut.opened} {closed}", cut.root, move=cut.move,
                hydrogen_mass=cut.hydrogen_mass,
            )  # fmt: skip
            solution = minimise(at, energy, "lbfgs", curvature=False)
            yield row | {ENERGY: solution.end.energy, "status": str(solution.status)}
        else:
            yield row | {ENERGY: energy(x)[0]}


def energy_map(table: "pd.DataFrame") -> "Figure":
    """Curve of one dihedral, or map of two: energy above the lowest, contours every 5 kJ/mol."""
    from protochain.results.figures import panels, plain

    names = [str(name) for name in table.columns if name not in (ENERGY, "status")]
    above = table[ENERGY] - table[ENERGY].min()
    figure, (ax,) = panels(None, 1, (5.2, 4.2))
    lowest = table.nsmallest(1, ENERGY).iloc[0]
    ax.set_title("lowest at " + ", ".join(f"{name} = {lowest[name]:g}" for name in names) + " degrees")
    ax.set_xlabel(f"{names[0]}, degrees")
    if len(names) == 1:
        ax.plot(table[names[0]], above)
        ax.set_ylabel("energy above the lowest, kJ/mol")
        if above.max() > _STEEP:
            ax.set_yscale("symlog", linthresh=_STEEP)
            ax.set_ylim(bottom=0.0)
        plain(ax)
        return figure
    with_above = table.assign(above=above.clip(upper=_MOST))
    grid = with_above.pivot_table(index=names[1], columns=names[0], values="above", aggfunc="min")
    levels = np.arange(0.0, _MOST + 1.0, 5.0)
    shown = ax.contourf(grid.columns, grid.index, grid, levels=levels, cmap="viridis")
    ax.contour(grid.columns, grid.index, grid, levels=levels, colors="white", linewidths=0.4)
    ax.set_ylabel(f"{names[1]}, degrees")
    figure.colorbar(shown, ax=ax, label="energy above the lowest, kJ/mol")
    return figure
