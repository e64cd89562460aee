"""Umbrella sampling: windows along a dihedral or a distance, combined by MBAR."""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from protochain.chains.articulate import with_energy
from protochain.chains.restraint import Restraint
from protochain.chains.restraint_list import Restraints
from protochain.core import defaults
from protochain.core.arrays import Floats, Integers, finite
from protochain.core.checks import at_least, brief, check_arguments, instance, quantity
from protochain.core.errors import Argument, ProtochainError, refusal
from protochain.core.lazy_pandas import pd
from protochain.core.optional_libraries import library
from protochain.core.units import ANGSTROM_PER_NM, MOLAR_GAS
from protochain.dynamics.simulate_chain import simulate

_COORDINATE = instance(Restraint, 'pc.Restraint("dihedral", ("phi A:3",), 0, 0, 100)')


@check_arguments(coordinate=_COORDINATE, n_equilibrate=at_least(0), temperature=quantity("kelvin"))
def umbrella(
    chain: Any, energy: Any, coordinate: Restraint, centres: Sequence[float], *,
    edges: Sequence[float] | None = None, n_equilibrate: int = 20,
    temperature: float = defaults.TEMPERATURE, **options: Any,
) -> "pd.DataFrame":  # fmt: skip
    """Free energy along a dihedral or a distance, by umbrella windows and MBAR.

    Parameters
    ----------
    chain, energy : Chain, Energy
        As in :func:`protochain.simulate`. Each window continues from the end of the previous one.
    coordinate : Restraint
        Dihedral or distance, with the stiffness of all windows. Its bounds are replaced.
    centres : sequence of float, degrees or angstrom
        Centres of the windows, all different. Centres of a dihedral must span less than a full circle.
    edges : sequence of float, degrees or angstrom, optional
        Edges of the bins in rising order. Default: halfway between centres.
    n_equilibrate : int
        Rows at the start of the log of each window that are skipped.
    temperature : float, K
        Temperature of all windows.
    **options
        Further options of :func:`protochain.simulate`: ``n_steps`` of a window, ``every``, ``fixman`` ...

    Returns
    -------
    pandas.DataFrame
        A row per bin with samples. ``value`` is its middle, ``samples`` the number of rows in it.
        ``free_energy_kj_mol`` is -kT ln of the probability per degree or angstrom, above the lowest bin.
        ``error_kj_mol`` is the standard error of this difference.

    Raises
    ------
    ProtochainError
        If pymbar is not installed, the centres or edges define no bins, a window has too few samples, or no
        sample lies between the edges.

    Notes
    -----
    MBAR: Shirts, Chodera, J. Chem. Phys. 129:124105 (2008), equation 11, by pymbar. The rows of a window are
    correlated. The N rows of a window therefore count as N / g, with g the statistical inefficiency of their
    contributions to the error (Chodera et al., J. Chem. Theory Comput. 3:26, 2007, equation 17). Motions that
    are slower than a window do not affect it.
    """
    turns = coordinate.kind == "dihedral"
    if np.size(centres) < 2 or coordinate.kind == "position":
        raise ProtochainError("umbrella: give two centres or more, of a dihedral or a distance")
    if of_windows := sorted({"q", "restraints", "watch"} & {*options}):
        raise ProtochainError("umbrella: ", Argument(of_windows[0]), " is set by the windows; remove it")
    at = np.sort(finite(centres, (np.size(centres),), "centres"))
    bins = _bins(at, 360.0 if turns else np.inf, edges)
    cut, energy = with_energy(chain, energy)
    pymbar = library("pymbar", "umbrella")
    unit = 180.0 / np.pi if turns else ANGSTROM_PER_NM
    windows = [replace(coordinate, lower=float(c), upper=float(c)) for c in at]
    restraints = Restraints.of(cut.structure, windows)
    q, x, counts = None, list[Any](), list[int]()
    for window in windows:
        rows = list[Any]()
        watch = partial(_append, rows)
        result = simulate(cut, energy, q, temperature, restraints=window, watch=watch, **options)
        if not result.is_sound:
            raise ProtochainError(f"umbrella: window {window}: {result.message}")
        if len(rows) < n_equilibrate + 2:
            few = f"umbrella: window {window}: {len(rows)} rows, of which {n_equilibrate} are skipped; "
            raise ProtochainError(few, "give more ", Argument("n_steps"))
        cut, q = result.chain, result.q
        x += rows[n_equilibrate:]
        counts.append(len(rows) - n_equilibrate)
    thermal_energy = MOLAR_GAS * temperature
    at_windows = np.array([restraints.values(positions) for positions in x])
    # Energies (windows, rows) of all springs at all rows, in units of kT.
    bias = np.array([restraints.energies(row) for row in at_windows]).T / thermal_energy
    values = unit * at_windows[:, 0]
    for window, part in zip(windows, np.split(values, np.cumsum(counts)[:-1]), strict=True):
        if np.ptp(part) == 0.0:
            raise ProtochainError(f"umbrella: window {window}: no hinge changes it; open one that does")
    # Values of a dihedral are moved to the turn that begins at the first edge.
    values = bins[0] + (values - bins[0]) % 360.0 if turns else values
    of_bin = np.digitize(values, bins) - 1
    of_bin[of_bin == len(bins) - 1] = -1
    filled, samples = np.unique(of_bin[of_bin >= 0], return_counts=True)
    if not len(filled):
        reach = f"{values.min():.4g} to {values.max():.4g}"
        raise refusal("edges", brief(bins.tolist()), f"no samples between them, but from {reach}")
    with warnings.catch_warnings():
        # Its solvers warn of options of other solvers.
        warnings.simplefilter("ignore")
        mbar = pymbar.MBAR(bias, np.array(counts))
    shares = np.exp(mbar.Log_W_nk)
    # The second eigenvalue of the overlap matrix is 1 if the windows form two groups (Klimovich, Shirts,
    # Mobley, J. Comput.-Aided Mol. Des. 29:397, 2015): no row then relates the groups.
    if len(x) * mbar.compute_overlap()["scalar"] < 1.0:
        remedy = "the windows do not overlap; give more, or a softer spring"
        raise refusal("centres", brief(at.tolist()), remedy)
    # Weights without a bias, by bin: equation 13 of Shirts and Chodera with u = 0.
    unbiased = np.asarray(mbar.Log_W_nk)[:, 0] + bias[0]
    weights = np.exp(unbiased - unbiased.max())[:, None] * (of_bin[:, None] == filled)
    density = weights.sum(axis=0) / np.diff(bins)[filled]
    free = thermal_energy * np.log(density.max() / density)
    noise = _noise(np.hstack([shares, weights / weights.sum(axis=0)]), np.array(counts))[:, len(at) :]
    # Errors are of the differences to the lowest bin.
    parts = np.split(noise - noise[:, [np.argmax(density)]], np.cumsum(counts)[:-1])
    g = pymbar.timeseries.statistical_inefficiency
    variance = np.sum([[_variance(series, g) for series in part.T] for part in parts], axis=0)
    return pd.DataFrame({
        "value": 0.5 * (bins[1:] + bins[:-1])[filled], "free_energy_kj_mol": free,
        "error_kj_mol": thermal_energy * np.sqrt(variance), "samples": samples,
    })  # fmt: skip


def _append(rows: list[Any], row: Any, x: Any) -> None:
    rows.append(x)


def _variance(series: Floats, inefficiency: Callable[[Floats], float]) -> float:
    """Variance of the sum of a series (n,) of correlated numbers."""
    return 0.0 if np.ptp(series) == 0.0 else float(inefficiency(series) * len(series) * np.var(series))


def _bins(at: Floats, circle: float, edges: Any) -> Floats:
    """Edges of the bins, as requested, or halfway between sorted centres, also across the circle."""
    if np.isinf(circle) and at[0] < 0.0:
        raise refusal("centres", f"{at[0]:g}", "give distances of 0 or more")
    gaps = np.diff(at, append=at[0] + circle)
    # Nearer centres, in degrees or angstrom, count as equal.
    if np.min(gaps) < 1e-6:
        near = int(np.argmin(gaps))
        pair = f"{at[near]:g} and {at[(near + 1) % len(at)]:g}"
        full_circle = " or more than a full circle apart" if np.isfinite(circle) else ""
        raise refusal("centres", pair, f"these are equal{full_circle}; give different ones")
    if edges is None:
        low, high = (0.5 * min(gaps[k], gaps[-1]) for k in (0, -2))
        low = at[0] - low if np.isfinite(circle) else max(at[0] - low, 0.0)
        return np.array([low, *(0.5 * (at[1:] + at[:-1])), at[-1] + high])
    bins = finite(edges, (np.size(edges),), "edges")
    if len(bins) < 2 or np.min(np.diff(bins)) <= 0.0 or bins[-1] - bins[0] > circle:
        turn = " within 360 degrees" if np.isfinite(circle) else ""
        raise refusal("edges", brief(bins.tolist()), f"give two or more in rising order{turn}")
    return bins


def _noise(shares: Floats, counts: Integers) -> Floats:
    """Share (n, m) of each row in the errors of the reduced free energies of m states, by weights (n, m).

    The first states are the windows. MBAR solves sum_n W_ni(f) = 1. To first order the error of f is the sum
    over rows of A^-1 W_n, with the slope A = 1 - W^T W N of these equations (Tan, J. Am. Stat. Assoc.
    99:1027, 2004).
    """
    m = shares.shape[1]
    rows = np.pad(counts, (0, m - len(counts)))
    # A constant added to all free energies has no effect. Without it the slope has an inverse.
    slope = np.eye(m) - shares.T @ shares * rows + rows / rows.sum()
    return np.asarray(np.linalg.solve(slope, shares.T).T)
