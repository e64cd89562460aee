"""A progress bar for notebooks and terminals."""

from collections.abc import Callable, Mapping
from typing import Any

from protochain.arrays import Floats

_SHOWN = {
    "energy_kj_mol": "{:.1f} kJ/mol",
    "max_torque_kj_mol_rad": "{:.3g} kJ/mol/rad",
    "time_ps": "{:.2f} ps",
    "temperature_k": "{:.0f} K",
}
"""Values shown beside the bar, where a row has them; the torque is nan where all atoms move."""


def progress(title: str = "") -> Callable[[Mapping[str, float], Floats], None]:
    """Show a progress bar: ``minimise(..., watch=pc.progress("lbfgs"))``.

    Parameters
    ----------
    title : str
        Name of the bar. With ``compare(..., watch=pc.progress)``, each run has a bar named after its method.

    Returns
    -------
    callable
        Watcher for :func:`protochain.minimise` and :func:`protochain.simulate`. The bar closes when the
        watcher is no longer referenced.
    """
    from tqdm.auto import tqdm

    # The number of evaluations is not known in advance.
    bar: Any = tqdm(desc=title, unit=" evaluations")

    def watch(row: Mapping[str, float], x: Floats) -> None:
        if "step" in row:
            bar.unit = " steps"
        said = [text.format(row[key]) for key, text in _SHOWN.items() if row.get(key, 0.0) == row.get(key)]
        bar.set_postfix_str(", ".join(said), refresh=False)
        bar.update(row.get("evaluations", row.get("step", 0)) - bar.n)

    return watch
