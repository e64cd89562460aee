"""Columns of an added pose: its title, whether it is valid, and its measures before and after."""

from typing import TYPE_CHECKING, Any

import numpy as np

from protochain.core import defaults
from protochain.core.arrays import Floats, Integers
from protochain.energies.decomposed import interaction, native_of
from protochain.results.columns import Kind
from protochain.structure.ligand_files import title_of_last
from protochain.validation.ligands import POSEBUSTERS

if TYPE_CHECKING:
    from protochain.relaxation.result import Relaxation

_ENDS = ("start", "end")
COLUMNS: dict[str, Kind] = {
    "pose_title": str, "pose_chain": str, "pose_residue": str, "pose_valid": bool | None,
    **{f"pose_interaction_energy_{when}_kj_mol": float | None for when in _ENDS},
    **{f"pose_strain_{when}_kj_mol": float | None for when in _ENDS},
    **{f"pose_clashes_{when}": int | None for when in _ENDS},
    "pose_rmsd_angstrom": float | None,
    **{f"pose_{test}": bool | None for test in POSEBUSTERS},
}  # fmt: skip
"""Names and kinds. The tests are PoseBusters', at the end."""


def pose_record(result: "Relaxation") -> dict[str, Any]:
    """Columns of the last pose that was added to the structure of a result, empty without one."""
    posed = [k for k, ligand in enumerate(result.start.ligands) if ligand.posed]
    if not posed:
        return {}
    k = posed[-1]
    atoms, source = result.start.ligands[k].atoms, result.start.ligands[k].ligand.molecule.source
    ends = dict(zip(_ENDS, (result.ligands_start[k], result.ligands_end[k]), strict=True))
    end = ends["end"]
    values: dict[str, Any] = {
        "title": title_of_last([source]), "chain": end.residue.chain, "residue": end.residue.number,
        "valid": end.is_valid, "rmsd_angstrom": result.ligand_motion[k, 0], **(end.posebusters or {}),
    }  # fmt: skip
    for (when, ligand), x in zip(ends.items(), (result.start.positions, result.x), strict=True):
        values[f"interaction_energy_{when}_kj_mol"] = _interaction(result, atoms, x)
        values[f"strain_{when}_kj_mol"] = ligand.strain_kj_mol
        values[f"clashes_{when}"] = ligand.clashes
    return {f"pose_{name}": value for name, value in values.items()}


def _interaction(result: "Relaxation", atoms: Integers, x: Floats) -> float | None:
    """Energy of a complex at x (na, 3) nm minus the energy of its rigid parts apart, kJ/mol.

    As of :func:`protochain.score_interface`, without springs to metals. None if it is too large.
    """
    energy, s = native_of(result.energy_function), result.start
    if energy is None or s.n_atoms > defaults.FULL_UP_TO:
        return None
    pose = np.isin(np.arange(s.n_residues), s.atom_residue[atoms])
    return float(sum(shares.sum() for shares in interaction(s, energy, x, pose, ~pose)))
