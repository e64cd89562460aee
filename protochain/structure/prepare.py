"""What a file lacks is added: heavy atoms by PDBFixer, disulfides, hydrogens by OpenMM's Modeller.

Both tools place atoms at random and then relax them, on whatever platform is fastest; seeded and on the
Reference platform the same file gives the same coordinates, bit for bit.
"""

import io
import random
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import gemmi
import numpy as np
import openmm
from openmm import app, unit
from pdbfixer import PDBFixer

from protochain.errors import StructureError
from protochain.residues import describe
from protochain.structure.model import Structure
from protochain.structure.read import Draft, read

PH = 7.0
_HYDROGEN_FORCE_FIELD = str(Path(app.__file__).parent / "data" / "amber14" / "protein.ff14SB.xml")
"""The whole path: OpenMM looks for a bare name in the working directory first."""


def load(path: str | Path) -> Structure:
    """Read a PDB or mmCIF file and prepare its protein: complete, all-atom, one conformation.

    The first model is read; waters, ligands and other alternate locations are left out; chains are
    split where they break; missing heavy atoms are added by PDBFixer, disulfides found from geometry,
    and missing hydrogens added at pH 7 by OpenMM's Modeller. The same file gives the same bits.

    Parameters
    ----------
    path : path-like
        PDB or mmCIF, by its suffix or its content.

    Returns
    -------
    Structure
        Every change is a line in ``repairs``.

    Raises
    ------
    StructureError
        One line naming the file, the place and the mend.
    """
    return prepare(read(path))


def prepare(draft: Draft) -> Structure:
    """Complete a draft: heavy atoms, disulfides, hydrogens.

    Raises
    ------
    StructureError
        If a residue's atoms fit no known residue.
    """
    fixer = PDBFixer(pdbxfile=_as_mmcif(draft), platform=_reference())
    with _seeded():
        _add_heavy_atoms(draft, fixer)
        topology, positions = fixer.topology, fixer.positions
        topology.createDisulfideBonds(positions)
        for bond in topology.bonds():
            if bond.atom1.name == bond.atom2.name == "SG":
                first, second = (_describe(draft, atom.residue) for atom in bond)
                draft.repairs.append(f"disulfide bond between {first} and {second}")
        topology, positions = _add_hydrogens(draft, topology, positions)
    topology.setPeriodicBoxVectors(None)
    for chain, chain_id in zip(topology.chains(), draft.chain_ids, strict=True):
        chain.id = chain_id
    for residue in topology.residues():
        atoms = {atom.name: atom for atom in residue.atoms()}
        if "H" in atoms and "H3" in atoms:
            # OpenMM calls the first hydrogen of a charged N terminus H; the PDB calls it H1.
            atoms["H"].name = "H1"
    x = np.array(positions.value_in_unit(unit.nanometer))
    return Structure(draft.name, topology, x, tuple(draft.repairs), dict(draft.left_out))


def _as_mmcif(draft: Draft) -> io.StringIO:
    """Write the draft in the one format that keeps long chain ids and every insertion code."""
    structure = gemmi.Structure()
    structure.name = draft.name
    structure.add_model(draft.model)
    structure.setup_entities()
    structure.assign_label_seq_id()
    return io.StringIO(structure.make_mmcif_document().as_string())


def _add_heavy_atoms(draft: Draft, fixer: PDBFixer) -> None:
    fixer.missingResidues = {}
    fixer.findMissingAtoms()
    added = {residue: [atom.name for atom in atoms] for residue, atoms in fixer.missingAtoms.items()}
    for residue, names in fixer.missingTerminals.items():
        added.setdefault(residue, []).extend(names)
    for residue, names in sorted(added.items(), key=lambda item: item[0].index):
        draft.repairs.append(f"{_describe(draft, residue)}: missing {', '.join(names)} added")
    fixer.addMissingAtoms(seed=1)


def _add_hydrogens(draft: Draft, topology: app.Topology, positions: Any) -> tuple[app.Topology, Any]:
    present = _count_hydrogens(topology)
    force_field = _hydrogen_force_field()
    modeller = app.Modeller(topology, positions)
    try:
        variants = modeller.addHydrogens(force_field, pH=PH, platform=_reference())
    except ValueError:
        # Hydrogens in the file that fit no template, or a residue that does not: tell which.
        modeller = _without_unfit_hydrogens(draft, topology, positions)
        try:
            variants = modeller.addHydrogens(force_field, pH=PH, platform=_reference())
        except ValueError as error:
            raise _unfit(draft, modeller, error) from None
    added = _count_hydrogens(modeller.topology) - present
    if added:
        draft.repairs.append(f"{added} hydrogens added at pH {PH:g} ({present} were in the file)")
    for residue, variant in zip(modeller.topology.residues(), variants, strict=True):
        if residue.name == "HIS":
            draft.repairs.append(f"{_describe(draft, residue)} taken as {variant}")
    return modeller.topology, modeller.positions


def _without_unfit_hydrogens(draft: Draft, topology: app.Topology, positions: Any) -> app.Modeller:
    """Strip the hydrogens of every residue that fits no template as it stands, to be built anew."""
    trial = app.Modeller(topology, positions)
    trial.addHydrogens(pH=PH, platform=_reference())
    unfit = {residue.index for residue in _hydrogen_force_field().getUnmatchedResidues(trial.topology)}
    modeller = app.Modeller(topology, positions)
    strange = [
        atom
        for atom in topology.atoms()
        if atom.residue.index in unfit and atom.element == app.element.hydrogen
    ]
    for residue, count in Counter(atom.residue for atom in strange).items():
        draft.repairs.append(f"{_describe(draft, residue)}: its {count} hydrogens fit no template: rebuilt")
    modeller.delete(strange)
    return modeller


def _unfit(draft: Draft, modeller: app.Modeller, error: ValueError) -> StructureError:
    trial = app.Modeller(modeller.topology, modeller.positions)
    trial.addHydrogens(pH=PH, platform=_reference())
    unfit = _hydrogen_force_field().getUnmatchedResidues(trial.topology)
    where = f"{_describe(draft, unfit[0])}: " if unfit else ""
    reason = " ".join(str(error).split()).split("No template found for residue", 1)[-1]
    return StructureError(
        f"{draft.source}: {where}its atoms fit no known residue ({reason.strip()}); mend or remove it"
    )


def _describe(draft: Draft, residue: Any) -> str:
    number = f"{residue.id}{residue.insertionCode.strip()}"
    return describe(number, residue.name, draft.chain_ids[residue.chain.index])


def _count_hydrogens(topology: app.Topology) -> int:
    return sum(atom.element == app.element.hydrogen for atom in topology.atoms())


@cache
def _hydrogen_force_field() -> app.ForceField:
    return app.ForceField(_HYDROGEN_FORCE_FIELD)


def _reference() -> openmm.Platform:
    return openmm.Platform.getPlatform("Reference")


@contextmanager
def _seeded() -> Iterator[None]:
    """Run with the global generator that Modeller draws from at a fixed state, then put it back."""
    state = random.getstate()
    random.seed(1)
    try:
        yield
    finally:
        random.setstate(state)
