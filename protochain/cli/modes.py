"""``protochain modes``."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from protochain.chains.setup import Setup
from protochain.cli import options
from protochain.cli.first import METHOD, announce_duration, minimise_first
from protochain.cli.terminal import print_outlook
from protochain.core import defaults
from protochain.core.checks import at_least, one_of
from protochain.core.errors import ProtochainError
from protochain.core.interrupts import held_interrupts, open_to_interrupts
from protochain.core.storage import claim_folder

if TYPE_CHECKING:
    from protochain.chains.chain import Chain
    from protochain.comparison.modes import NormalModes
    from protochain.core.arrays import Floats
    from protochain.energies import Energy

_RELAXED = 0.1  # kJ/mol/rad. Largest torque of a minimised start, a tenth of the limit for a minimum.

_SHOWN = 10  # Printed modes. The table has all.

Output = Annotated[
    Path | None, typer.Option("-o", "--output", metavar="DIR", help="Folder [default: NAME-modes].")
]


@options.with_settings()
def modes(
    context: typer.Context,
    source: options.Input,
    output: Output = None,
    modes: Annotated[int, typer.Option(help="Number of modes, the lowest first.")] = 20,
    to: Annotated[
        Path | None, typer.Option(help="Structure whose difference is compared with the modes.")
    ] = None,
    method: Annotated[
        str, typer.Option(help="auto, dense (the whole Hessian, and the entropy) or products.")
    ] = "auto",
    temperature: Annotated[float, typer.Option(help="Temperature of fluctuations and entropy, K.")] = 300.0,
    amplitude: Annotated[float, typer.Option(help="C-alpha RMSD along each mode, angstrom.")] = 1.0,
    trajectory: Annotated[str, typer.Option(help="Trajectory format: dcd or xtc.")] = defaults.TRAJECTORY,
    relax: Annotated[bool, typer.Option(help="Minimise first, unless at a minimum.")] = True,
    as_json: options.AsJson = False,
    *,
    setup: Setup,
) -> None:
    """Compute the normal modes of a structure in torsions. Write tables, trajectories and a page.

    The structure is minimised in torsions first if torques remain. --no-relax omits this.
    """
    from protochain.comparison.modes import positive
    from protochain.comparison.modes_folder import files_of, write_modes
    from protochain.comparison.normal_modes import DENSE, METHODS, normal_modes
    from protochain.comparison.pair_hessian import applies
    from protochain.structure.formats.trajectory import check_trajectory
    from protochain.structure.matching import structure_to_measure

    at_least(1)(modes, "modes")
    one_of(METHODS)(method, "method")
    temperature = positive(temperature, "temperature", "kelvin")
    amplitude = positive(amplitude, "amplitude", "angstrom")
    stem, suffix = options.named_after(source)
    output = output or Path(f"{stem}-modes")
    check_trajectory(output / f"mode-1.{trajectory}")
    options.check_outputs([source, to], files_of(output, modes, suffix, trajectory), setup)
    context.with_resource(claim_folder(output, "analysis of modes"))
    target = structure_to_measure(to) if to else None
    chain, energy, preparation = options.prepare(source, setup)
    # Two evaluations for each row of the Hessian, or for about 700 products. An analytic one costs a hundred.
    evaluations = 100 if applies(energy) else 2 * min(chain.n_v, DENSE)
    announce_duration(chain, energy, evaluations, int(relax))
    with held_interrupts():
        q, first = _minimise(source, chain, energy) if relax else (chain.q0, "not minimised first")
        with open_to_interrupts():
            analysis = normal_modes(chain, energy, q, modes, method=method)
    entries = {
        "input": str(source), "output": str(output), "first": first, "seconds_preparation": preparation,
    }  # fmt: skip
    record = write_modes(
        analysis, output, entries, temperature, suffix=suffix, trajectory=trajectory, amplitude=amplitude,
        model=target,
    )  # fmt: skip
    if as_json:
        options.print_json(record)
    else:
        _print(analysis, record)
    raise typer.Exit(options.CONVERGED if analysis.is_minimum else options.UNCONVERGED)


def _minimise(source: Path, chain: "Chain", energy: "Energy") -> tuple["Floats", str]:
    """Coordinates of a minimum in torsions, and a line about the minimisation, if any."""
    from protochain.comparison.hessian import torques_at
    from protochain.comparison.modes import FLAT

    if torques_at(chain, energy, None).largest <= FLAT:
        return chain.q0, "a minimum as it is: not minimised first"
    print_outlook(chain.structure, METHOD)
    solution, line = minimise_first(chain, energy, _RELAXED)
    if not solution.is_usable:
        raise ProtochainError(f"{source}: {solution.message}")
    print(line, file=sys.stderr)
    return solution.q, line


def _print(analysis: "NormalModes", record: dict[str, Any]) -> None:
    """Print the lowest frequencies, and quantities from the modes."""
    print(f"{record['structure']}: {record['message']}")
    shown = ", ".join(f"{frequency:.2f}" for frequency in analysis.frequencies[:_SHOWN])
    ellipsis = " ..." if analysis.n_modes > _SHOWN else ""
    print(f"frequencies of {analysis.n_modes} modes: {shown}{ellipsis} 1/cm")
    if record["b_factor_correlation"] is not None:
        print(f"correlation of B factors with those of the file: {record['b_factor_correlation']:.2f}")
    elif record["b_factor_column"] != "B factor":
        print(f"column of B factors in the file: {record['b_factor_column']}, not compared")
    if "cumulative_overlap" in record:
        print(f"share of the change to {record['other']}: {record['cumulative_overlap']:.3f}")
    if record["entropy_kj_mol_k"] is not None:
        print(f"entropy at {record['temperature_k']:g} K: {record['entropy_kj_mol_k']:.4f} kJ/mol/K")
    if record["largest_stable_step_ps"] is not None:
        print(f"longest stable step of the leapfrog: {1000.0 * record['largest_stable_step_ps']:.1f} fs")
    options.print_lost([record])
    print(f"written: {record['output']}")
