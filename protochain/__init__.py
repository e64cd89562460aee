"""Minimise the energy of protein chains in torsion space, and compare how.

Names are imported when first used, so that ``import protochain`` and ``protochain --help`` are quick.
"""

from importlib import import_module
from typing import Any

_WHERE = {
    "Chain": "chain",
    "Comparison": "analysis",
    "ProtochainError": "errors",
    "Simulation": "dynamics",
    "Solution": "minimisers",
    "Status": "minimisers",
    "Starts": "minimisers",
    "Structure": "structure",
    "as_structure": "structure",
    "build_chain": "articulate",
    "ca_rmsd": "structure",
    "compare": "analysis",
    "energy": "energies",
    "explore": "minimisers",
    "from_sequence": "structure",
    "load": "structure",
    "log_det_mass": "chain",
    "mass_matrix": "chain",
    "minimise": "minimisers",
    "minimize": "minimisers",
    "pose": "chain",
    "pull_back": "chain",
    "save": "structure",
    "simulate": "dynamics",
    "solve_mass": "chain",
    "to_mdanalysis": "structure",
    "to_mdtraj": "structure",
}

__all__ = [
    "Chain", "Comparison", "ProtochainError", "Simulation", "Solution", "Starts", "Status", "Structure",
    "as_structure", "build_chain", "ca_rmsd", "compare", "energy", "explore", "from_sequence", "load",
    "log_det_mass", "mass_matrix", "minimise", "minimize", "multibody", "pose", "pull_back", "save",
    "simulate", "solve_mass", "to_mdanalysis", "to_mdtraj",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    if name == "multibody":
        return import_module("protochain.multibody")
    if name not in _WHERE:
        raise AttributeError(f"module 'protochain' has no attribute {name!r}")
    return getattr(import_module(f"protochain.{_WHERE[name]}"), "minimise" if name == "minimize" else name)


def __dir__() -> list[str]:
    return sorted(__all__)
