"""Small molecules: their chemistry, and parameters for it."""

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from protochain.core import defaults
from protochain.core.arrays import Floats, Value, floats
from protochain.core.checks import CHARGE_RULES, acidity, check_arguments, file_name, optional, path, text
from protochain.core.errors import Argument, StructureError
from protochain.core.settings import document_fields
from protochain.ligands import charges as charging
from protochain.ligands import energy, nagl, smirnoff
from protochain.ligands.molecule import Molecule
from protochain.ligands.protonation import Charged, at_ph, unsure
from protochain.ligands.sources import read

__all__ = ["Ligand", "ligand"]


@document_fields
@dataclass(frozen=True, eq=False)
class Ligand(Value):
    """A small molecule with its parameters, see :func:`protochain.ligand`."""

    molecule: Molecule  # Elements, bonds, formal charges, stereo, positions and source.
    parameters: energy.Parameters  # Arrays of its energy.
    charged: tuple[Charged, ...] = ()  # Atoms whose formal charge the pH changed.
    # Atoms outside the domain of NAGL's model. If there are any, MMFF94's charges replace the model's.
    outside: tuple[str, ...] = ()
    # Atoms whose charge at the pH is uncertain: no rule covers them, and their class of sites is wide.
    unsure: tuple[str, ...] = ()

    def __repr__(self) -> str:
        molecule = self.molecule
        return f"<Ligand {molecule.source}: {molecule.n_atoms} atoms, charge {molecule.charge:+d}>"

    def terms(self, x: Floats | None = None) -> dict[str, float]:
        """Energies by term.

        Parameters
        ----------
        x : (na, 3) float, nm, optional
            Positions in the order of the molecule's atoms, by default from the file.

        Returns
        -------
        dict of str to float
            ``bonds``, ``angles``, ``torsions`` (impropers included), ``lj`` and ``coulomb`` in kJ/mol, over
            all pairs without a cutoff.

        Raises
        ------
        ProtochainError
            If positions are missing or have another shape.
        """
        positions = self.molecule.positions if x is None else x
        if positions is None:
            raise StructureError(
                f"{self.molecule.source}: has no coordinates in space; give a file that has, or ",
                Argument("x"),
            )
        return energy.terms(self.parameters, floats(positions, (self.molecule.n_atoms, 3), "x", "nanometer"))


def _file_or_smiles(value: Any, name: str) -> str | Path:
    return value if isinstance(value, Path) else text(value, name)


@check_arguments(molecule=_file_or_smiles, charges=file_name, forcefield=optional(path), ph=optional(acidity))
def ligand(
    molecule: str | Path,
    charges: str | Path = defaults.LIGAND_CHARGES,
    forcefield: str | Path | None = None,
    ph: float | None = None,
) -> Ligand:
    """Assign chemistry and parameters to a small molecule.

    It needs ``pip install "protochain[ligands]"``.

    Parameters
    ----------
    molecule : str or path-like
        An SDF or MOL2 file with one molecule, or SMILES. RDKit adds hydrogens that lack.
    charges : str or path-like
        ``nagl`` is AM1-BCC charges by OpenFF's graph network [1]_, outside its domain ``mmff94``. Others are
        ``mmff94`` [2]_, ``gasteiger``, or a file: MOL2 with the same atoms in the same order, or a line with
        name and charge of each atom. They sum to the formal charge. All atoms share the rounding error.
    forcefield : path-like, optional
        An .offxml file [3]_. Sage without constraints [4]_ comes with the package.
        ``openff_unconstrained-2.3.0.offxml``, the default, was fitted with ``nagl``.
        ``openff_unconstrained-2.2.1.offxml`` is the default with ``mmff94`` and ``gasteiger``.
    ph : float, optional
        Acids and bases get the charges that are most populated at this pH. By default they are as given.

    Returns
    -------
    Ligand
        With ``molecule``, ``parameters`` as arrays, and ``terms()``, the energies at the file's coordinates.

    Raises
    ------
    StructureError
        If the molecule cannot be read.
    ForceFieldError
        If the force field cannot be read or lacks parameters for an atom, for example metals and boron in
        Sage, or if charges do not fit. The message names the atom.

    References
    ----------
    .. [1] openff-gnn-am1bcc-1.0.0 of OpenFF NAGL, doi:10.5281/zenodo.15770227.
    .. [2] Halgren, J. Comput. Chem. 17:490 (1996).
    .. [3] SMIRNOFF: Mobley et al., J. Chem. Theory Comput. 14:6076 (2018).
    .. [4] Boothroyd et al., J. Chem. Theory Comput. 19:3251 (2023).

    Examples
    --------
    >>> len(pc.ligand("CC(=O)N").molecule.elements)
    9
    """
    chemistry = read(molecule)
    state, charged = (chemistry, ()) if ph is None else at_ph(chemistry, ph)
    result = assign_parameters(state, charges, forcefield, charged)
    return result if ph is None else replace(result, unsure=unsure(state, ph))


def assign_parameters(
    molecule: Molecule,
    charges: str | Path = defaults.LIGAND_CHARGES,
    forcefield: str | Path | None = None,
    charged: tuple[Charged, ...] = (),
) -> Ligand:
    """Assign parameters to a molecule, with the arguments of :func:`ligand`."""
    by_rule = charges in CHARGE_RULES
    outside = nagl.outside(molecule) if charges == "nagl" else ()
    rule = "mmff94" if outside else str(charges)
    by_file = partial(charging.from_file, path=Path(charges))
    model = partial(charging.by_rule, rule=rule) if by_rule else by_file
    default = smirnoff.SAGE_2_2 if by_rule and charges != "nagl" else smirnoff.SAGE_2_3
    rules = smirnoff.read(default if forcefield is None else Path(forcefield))
    return Ligand(molecule, smirnoff.assign_parameters(molecule, rules, model, not by_rule), charged, outside)
