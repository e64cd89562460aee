"""A progress bar for notebooks and terminals."""

from __future__ import annotations

from collections.abc import Mapping
from time import monotonic
from weakref import finalize

from protochain.core.arrays import Floats, Watcher
from protochain.core.checks import at_least, check_arguments, optional

_SHOWN = {
    "energy_kj_mol": "{:.1f} kJ/mol",
    "max_torque_kj_mol_rad": "{:.3g} kJ/mol/rad",
    "rms_force_kj_mol_nm": "{:.3g} kJ/mol/nm",
    "time_ps": "{:.2f} ps",
    "temperature_k": "{:.0f} K",
}
"""Values shown next to the bar, if present. The force is nan in runs in torsions, else the torque is."""
_EVERY = 0.1  # s between updates of the bar.


@check_arguments(total=optional(at_least(1)))
def progress(title: str = "", *, total: int | None = None) -> Watcher:
    """Show a progress bar, with the stage of the run: ``minimise(..., watch=pc.progress("lbfgs"))``.

    Parameters
    ----------
    title : str
        Name of the bar. With ``compare(..., watch=pc.progress)``, each run has a bar named after its method.
    total : int, optional
        Expected steps or evaluations, such as ``n_steps`` of a simulation. Also shows the remaining time.

    Returns
    -------
    callable
        Watcher for :func:`protochain.minimise` and :func:`protochain.simulate`. The bar closes when the
        watcher is no longer referenced.

    Examples
    --------
    >>> watch = pc.progress("run", total=20)
    >>> pc.simulate("structures/ala10.pdb", n_steps=20, watch=watch).n_steps
    20
    """
    return _Bar(title, total)


class _Bar:
    def __init__(self, title: str, total: int | None) -> None:
        from rich.console import Console
        from rich.progress import Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
        from rich.table import Column

        # A notebook shows the terminal output, too, if it is one line without colours.
        console = Console(stderr=True, force_terminal=True, force_jupyter=False, color_system=None)
        text = "{task.description}{task.completed:.0f} {task.fields[unit]}{task.fields[now]}"
        line = TextColumn(text, markup=False, table_column=Column(no_wrap=True))
        left = (TextColumn("left"), TimeRemainingColumn()) if total else ()
        self.bar = Progress(
            line, TimeElapsedColumn(), *left, console=console, auto_refresh=False,
            redirect_stdout=False, redirect_stderr=False,
        )  # fmt: skip
        self.title = f"{title}: " if title else ""
        self.task = self.bar.add_task(self.title, total=total, unit="evaluations", now="")
        self.shown = 0.0
        self.bar.start()
        finalize(self, self.bar.stop)

    def at_stage(self, name: str, evaluations: int) -> None:
        """Show the stage of the run before the bar."""
        self.bar.update(self.task, description=f"{self.title}{name}: ", completed=evaluations, refresh=True)

    def __call__(self, row: Mapping[str, float], x: Floats) -> None:
        now = [text.format(row[key]) for key, text in _SHOWN.items() if row.get(key, 0.0) == row.get(key)]
        is_due = monotonic() - self.shown > _EVERY
        self.bar.update(
            self.task,
            completed=row.get("evaluations", row.get("step", 0)),
            unit="steps" if "step" in row else "evaluations",
            now="".join(f", {value}" for value in now),
            refresh=is_due,
        )
        self.shown = monotonic() if is_due else self.shown
