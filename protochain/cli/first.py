"""Initial minimisation in torsions, for simulate and modes."""

from typing import TYPE_CHECKING

from protochain.cli.terminal import foretell, run_progress, typical_evaluations
from protochain.core import defaults

if TYPE_CHECKING:
    from collections.abc import Sequence

    from protochain.chains.chain import Chain
    from protochain.chains.restraint import Restraint
    from protochain.energies import Energy
    from protochain.minimisers import Solution

METHOD = "lbfgs"


def announce_duration(chain: "Chain", energy: "Energy", evaluations: int, times: int) -> None:
    """Report the expected time of a long run, with a minimisation of ``times`` the usual length."""
    typical = times * typical_evaluations(METHOD, defaults.MAX_EVALUATIONS)
    limit = defaults.MAX_EVALUATIONS if times else 0
    foretell(chain, energy, evaluations + typical, evaluations + limit)


def minimise_first(
    chain: "Chain", energy: "Energy", tolerance: float, seed: int = defaults.SEED,
    restraints: "Sequence[Restraint]" = (),
) -> "tuple[Solution, str]":  # fmt: skip
    """Minimise to a largest torque (kJ/mol/rad), with restraints. Return also a line about the changes."""
    from protochain.minimisers import minimise

    with run_progress(METHOD, defaults.MAX_EVALUATIONS, tolerance, writes=False) as watch:
        solution = minimise(chain, energy, METHOD, tolerance, seed=seed, restraints=restraints, watch=watch)
    if solution.status == "interrupted":
        raise KeyboardInterrupt
    energies = f"{solution.start.energy:.1f} -> {solution.end.energy:.1f} kJ/mol"
    energies += ", restraints {:.1f} -> {:.1f}".format(*solution.restraints) if solution.restraints else ""
    return solution, f"minimised first: {energies}, C-alpha RMSD {solution.ca_rmsd_angstrom:.2f} angstrom"
