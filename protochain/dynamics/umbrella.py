"""Umbrella sampling: windows along a dihedral or a distance, put together by MBAR."""

import warnings
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from protochain.chains.articulate import with_energy
from protochain.chains.restraint import Restraint
from protochain.chains.restraint_list import Restraints
from protochain.core import defaults
from protochain.core.arrays import floats
from protochain.core.checks import at_least, checked, instance, quantity
from protochain.core.errors import ProtochainError
from protochain.core.extras import library
from protochain.core.units import ANGSTROM_PER_NM, MOLAR_GAS
from protochain.dynamics.simulate_chain import simulate

if TYPE_CHECKING:
    import pandas as pd

_COORDINATE = instance(Restraint, 'pc.Restraint("dihedral", ("phi A:3",), 0, 0, 100)')


@checked(coordinate=_COORDINATE, n_equilibrate=at_least(0), temperature=quantity("kelvin"))
def umbrella(
    chain: Any, energy: Any, coordinate: Restraint, centres: Sequence[float], *,
    edges: Sequence[float] | None = None, n_equilibrate: int = 20,
    temperature: float = defaults.TEMPERATURE, **options: Any,
) -> "pd.DataFrame":  # fmt: skip
    """Free energy along a dihedral or a distance, by umbrella windows and MBAR.

    Parameters
    ----------
    chain, energy : Chain, Energy
        As in :func:`protochain.simulate`; each window goes on from the end of the one before.
    coordinate : Restraint
        Dihedral or distance, with the stiffness of all windows; its bounds are replaced.
    centres : sequence of float, degrees or angstrom
        Of the windows.
    edges : sequence of float, degrees or angstrom, optional
        Edges of the bins; by default halfway between centres.
    n_equilibrate : int
        Rows of the log of each window that are left out.
    temperature : float, K
        Of all windows.
    **options
        Further ones of :func:`protochain.simulate`: ``n_steps`` of a window, ``every``, ``fixman`` ...

    Returns
    -------
    pandas.DataFrame
        A row a bin: ``value``, ``free_energy_kj_mol`` above the lowest, ``error_kj_mol``, ``samples``.

    Raises
    ------
    ProtochainError
        If pymbar is not installed, or a window has no samples.

    Notes
    -----
    MBAR: Shirts, Chodera, J. Chem. Phys. 129:124105 (2008), by pymbar.
    """
    import pandas as pd

    at = np.sort(floats(centres, (np.size(centres),), "centres"))
    if len(at) < 2 or coordinate.kind == "position":
        raise ProtochainError("umbrella: give two centres or more, of a dihedral or a distance")
    bins = 0.5 * (at[1:] + at[:-1]) if edges is None else floats(edges, (np.size(edges),), "edges")
    if edges is None:
        bins = np.array([2 * at[0] - bins[0], *bins, 2 * at[-1] - bins[-1]])
    cut, energy = with_energy(chain, energy)
    pymbar = library("pymbar", "umbrella")
    unit = 180.0 / np.pi if coordinate.kind == "dihedral" else ANGSTROM_PER_NM
    windows = [replace(coordinate, lower=float(c), upper=float(c)) for c in at]
    held = [Restraints.of(cut.structure, each) for each in windows]
    q, samples = None, list[list[Any]]()
    for window in windows:
        kept = list[Any]()
        done = simulate(cut, energy, q, temperature, restraint=window, watch=partial(_keep, kept), **options)
        if not done.is_sound or len(kept) <= n_equilibrate:
            raise ProtochainError(f"umbrella: window {window}: {done.message}")
        cut, q = done.chain, done.q
        samples.append(kept[n_equilibrate:])
    x = [each for its in samples for each in its]
    bias = np.array([[its(each)[0] for each in x] for its in held]) / (MOLAR_GAS * temperature)
    values = unit * np.array([held[0].values(each)[0] for each in x])
    if coordinate.kind == "dihedral":
        values = bins[0] + (values - bins[0]) % 360.0
    inside = (values >= bins[0]) & (values < bins[-1])
    middle = 0.5 * (bins[1:] + bins[:-1])
    count = np.histogram(values, bins)[0]
    there = middle[count > 0]
    how = {"bin_edges": np.array([-np.inf, *bins, np.inf]) if not inside.all() else bins}
    with warnings.catch_warnings():
        # Its solvers warn of options of one another.
        warnings.simplefilter("ignore")
        fes = pymbar.FES(bias, np.array([len(its) for its in samples]))
    fes.generate_fes(np.zeros(len(x)), values, fes_type="histogram", histogram_parameters=how)
    found = fes.get_fes(there, reference_point="from-lowest", uncertainty_method="analytical")
    scale = MOLAR_GAS * temperature
    lowest = np.min(found["f_i"])
    return pd.DataFrame({
        "value": there, "free_energy_kj_mol": scale * (found["f_i"] - lowest),
        "error_kj_mol": scale * np.asarray(found["df_i"]), "samples": count[count > 0],
    })  # fmt: skip


def _keep(kept: list[Any], row: Any, x: Any) -> None:
    kept.append(x)
