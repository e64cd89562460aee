"""A progress bar for notebooks and terminals."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from protochain.core.arrays import Floats, Watcher

_SHOWN = {
    "energy_kj_mol": "{:.1f} kJ/mol",
    "max_torque_kj_mol_rad": "{:.3g} kJ/mol/rad",
    "rms_force_kj_mol_nm": "{:.3g} kJ/mol/nm",
    "time_ps": "{:.2f} ps",
    "temperature_k": "{:.0f} K",
}
"""Values shown beside the bar, where a row has them; where hinges turn the force is nan, else the torque."""


def progress(title: str = "") -> Watcher:
    """Show a progress bar, with the stage of the run: ``minimise(..., watch=pc.progress("lbfgs"))``.

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
    return _Bar(title)


class _Bar:
    """Watcher of a run; the number of evaluations is not known in advance."""

    def __init__(self, title: str) -> None:
        from tqdm.auto import tqdm

        self.title = title
        self.bar: Any = tqdm(desc=title, unit=" evaluations")

    def at_stage(self, name: str, evaluations: int) -> None:
        """Show the stage of the run before the bar."""
        said = f"{self.title}: {name}" if self.title else name
        self.bar.set_description_str(said, refresh=not self.bar.desc.startswith(said))
        self.bar.update(evaluations - self.bar.n)

    def __call__(self, row: Mapping[str, float], x: Floats) -> None:
        if "step" in row:
            self.bar.unit = " steps"
        said = [text.format(row[key]) for key, text in _SHOWN.items() if row.get(key, 0.0) == row.get(key)]
        self.bar.set_postfix_str(", ".join(said), refresh=False)
        self.bar.update(row.get("evaluations", row.get("step", 0)) - self.bar.n)
