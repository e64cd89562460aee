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
"""What a row may say, and how; it has no torque (not a number) where all atoms move."""


def progress(title: str = "") -> Callable[[Mapping[str, float], Floats], None]:
    """Return a watcher that shows a bar: ``minimise(..., watch=pc.progress("lbfgs"))``.

    Parameters
    ----------
    title : str
        What to call it. As ``compare(..., watch=pc.progress)`` each run gets a bar under its method's name.

    Returns
    -------
    callable
        For ``watch`` of :func:`protochain.minimise` and :func:`protochain.simulate`. The bar stops when
        nothing holds the watcher any more.
    """
    from tqdm.auto import tqdm

    # How many evaluations a run takes nobody knows before.
    bar: Any = tqdm(desc=title, unit=" evaluations")

    def watch(row: Mapping[str, float], x: Floats) -> None:
        if "step" in row:
            bar.unit = " steps"
        said = [text.format(row[key]) for key, text in _SHOWN.items() if row.get(key, 0.0) == row.get(key)]
        bar.set_postfix_str(", ".join(said), refresh=False)
        bar.update(row.get("evaluations", row.get("step", 0)) - bar.n)

    return watch
