"""Status of a result, from its judge's energy and forces."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from protochain.chains.articulate import build_chain
from protochain.chains.chain import Chain, Pose
from protochain.chains.contacts import overlaps
from protochain.core.arrays import Floats, Integers
from protochain.core.markup import abridge, plural
from protochain.core.settings import document_fields
from protochain.minimisers.loop import Stop
from protochain.minimisers.problem import Force
from protochain.minimisers.spaces import spaces
from protochain.structure.molecule.chirality import atom_names, changed_stereocentres, mirror_images
from protochain.structure.molecule.model import Structure
from protochain.validation.fixed import FixedFaults, count_fixed, fixed_faults
from protochain.validation.ligands import describe_double_bonds, inverted_double_bonds
from protochain.validation.omega import isomerised_bonds
from protochain.validation.rings import threaded_rings
from protochain.validation.stereocentres import inverted_stereocentres
from protochain.validation.strain import bond_lines, wrong_bonds

_REMEDY = "remove such hydrogens from the file to place them again, or relax the structure"
"""Remedy for bonds of wrong lengths."""
Concerns = Callable[[Integers], NDArray[np.bool_]]  # Rows of atoms (n, k) that count, as (n,) bool.
_METAL_CHANGE = 0.05  # Angstrom, largest change of a metal bond that is not reported.


def every_row(atoms: Integers) -> NDArray[np.bool_]:
    """Rows that count if all atoms may move."""
    return np.ones(len(atoms), dtype=bool)


class Status(StrEnum):
    """How a run ended, as judged in double precision.

    Examples
    --------
    >>> pc.Status("converged") is pc.Status.CONVERGED
    True
    """

    CONVERGED = "converged"
    STALLED = "stalled"
    BUDGET = "budget"
    CLASH = "clash"
    NON_FINITE = "non-finite"
    INTERRUPTED = "interrupted"
    INVERTED = "inverted"
    ISOMERISED = "isomerised"
    VIOLATIONS = "violations"
    SADDLE = "saddle"
    MEASURED = "measured"


OTHER_ISOMER = (Status.INVERTED, Status.ISOMERISED)
"""Statuses of runs whose end is another molecule than their start."""


@document_fields
@dataclass(frozen=True)
class Judgement:
    """Energy and forces of one set of positions, in double precision."""

    energy: float  # kJ/mol: Of the force field alone.
    # kJ/mol/rad: Over the freedoms of the chain. The force on a free root counts as its moment at 0.1 nm.
    max_torque: float
    # kJ/mol/nm: Over all Cartesian components of the moving atoms. OpenMM's minimiser uses the RMS of the
    # lengths of the forces, which is sqrt(3) times larger.
    rms_force: float
    # These two, the RMS torque, and the largest force on an atom, by their names in a trace.
    sizes: Mapping[str, float] = field(default_factory=dict)


def judge(chain: Chain, at: Pose, values: tuple[float, Floats], restraint: Force | None = None) -> Judgement:
    """Judge a pose of a chain by energy and forces. A restraint counts in the residuals only."""
    value, forces = values
    total = forces + restraint(at.x)[1] if restraint else forces
    torsions, atoms = spaces(chain)
    torque, force = torsions.torque(at, total), atoms.torque(at, total)
    sizes = torsions.sizes(torque) | atoms.sizes(force)
    return Judgement(value, torsions.residual(torque), atoms.residual(force), sizes)


def rebuilt(chain: Chain, x: Floats) -> Chain:
    """Rebuild a chain at other positions, whose bond lengths and angles may differ."""
    return build_chain(chain.structure.with_positions(x), chain.opened, chain.root, move=chain.move)


def verdict(
    stop: Stop,
    met: bool,
    measured: str,
    structure: Structure,
    x: Floats,
    n_evaluations: int,
    inverted: Sequence[str] | None = None,
    isomerised: Sequence[str] | None = None,
    problems: Sequence[str] | None = None,
    concerns: Concerns = every_row,
) -> tuple[Status, str]:
    """Status and message, from the reason for the end of a run and the residual by the judge."""
    # x (na, 3) nm. Overlaps and rings count if their atoms do.
    problems = describe_rejections(structure, x) if problems is None else problems
    if bonds := _changed_metal_bonds(structure, x):
        measured += f"; bonds of metals that changed by over {_METAL_CHANGE:g} angstrom: {abridge(bonds, 3)}"
    status, message = _force_status(
        stop, met, measured, structure, x, n_evaluations, inverted, isomerised, concerns
    )
    if problems and status is Status.CONVERGED:
        return Status.VIOLATIONS, f"violations: {'; '.join([*problems, measured])}"
    return status, message if status is Status.CLASH else "; ".join([message, *problems])


def _changed_metal_bonds(structure: Structure, x: Floats) -> list[str]:
    """Bonds of metals whose lengths at x (na, 3), nm, differ from the input."""
    atoms = structure.bonds[structure.coordination].tolist()
    lengths = {tuple(sorted(tie.atoms)): tie.rest for tie in structure.ties if len(tie.atoms) == 2}
    lines = []
    for pair in map(tuple, atoms):
        before, after = (10.0 * d for d in (lengths[pair], float(np.linalg.norm(x[pair[0]] - x[pair[1]]))))
        if abs(after - before) > _METAL_CHANGE:
            ends = (structure.atom(atom) for atom in pair)
            names = (f"{e.residue.chain}:{e.residue.name}{e.residue.number} {e.name}" for e in ends)
            lines.append(f"{' and '.join(names)} {before:.2f} to {after:.2f}")
    return lines


def describe_rejections(structure: Structure, x: Floats, concerns: Concerns = every_row) -> list[str]:
    """Describe errors that no result may have: mirror images, other isomers, fixed chains, faults."""
    # x (na, 3) nm.
    problems = [
        f"chain {chain} is a mirror image, D-amino acids with L names (relax with mirror if intended)"
        for chain in mirror_images(structure.with_positions(x))
    ]
    centres = [
        centre for centre in inverted_stereocentres(structure, x).tolist()
        if concerns(np.array([[centre, *structure.neighbours[centre]]]))[0]
    ]  # fmt: skip
    inverted = atom_names(structure, np.array(centres, dtype=np.int64))
    problems += [f"inverted stereocentres: {abridge(inverted)}"] if inverted else []
    # A substituent that moves may invert a double bond of fixed atoms.
    near = structure.neighbours
    double_bonds = [
        ends for ends in inverted_double_bonds(structure, x).tolist()
        if concerns(np.array([[*ends, *near[ends[0]], *near[ends[1]]]]))[0]
    ]  # fmt: skip
    bonds = describe_double_bonds(structure, np.array(double_bonds, dtype=np.int64).reshape(-1, 2))
    problems += [f"double bonds with inverted E/Z: {abridge(bonds)}"] if bonds else []
    n_fixed, n = count_fixed(structure)
    problems += [f"{n_fixed} of {n} residues of the protein have no parameters: fixed"] * (2 * n_fixed > n)
    # Torsions change no bond length: such a run would end converged.
    wrong_pairs = wrong_bonds(structure, x)
    wrong_pairs = wrong_pairs[~structure.kept[wrong_pairs].all(axis=1) & concerns(wrong_pairs)]
    if len(wrong_pairs):
        lines = abridge(bond_lines(structure, x, wrong_pairs), 3)
        problems.append(f"{plural(len(wrong_pairs), 'bond')} of a wrong length: {lines}; {_REMEDY}")
    faults = FixedFaults(*(pairs[concerns(pairs)] for pairs in fixed_faults(structure, x)))
    summary = faults.summary(structure, x)
    return [*problems, summary] if summary else problems


def _force_status(
    stop: Stop,
    met: bool,
    measured: str,
    structure: Structure,
    x: Floats,
    n_evaluations: int,
    inverted: Sequence[str] | None,
    isomerised: Sequence[str] | None,
    concerns: Concerns,
) -> tuple[Status, str]:
    """Status and message from forces, overlaps, and changes of isomers."""
    # Changed isomers.
    remedy = "rebuild these residues first"
    if inverted is None:
        inverted = changed_stereocentres(structure, x, structure.positions)
        remedy = "lbfgs preserves stereocentres: it turns bonds only"
    if isomerised is None:
        isomerised = isomerised_bonds(structure, x, structure.positions)
    changes: dict[Status, str] = {}
    if inverted:
        changes[Status.INVERTED] = f"{abridge(inverted)} inverted; {remedy}"
    if isomerised:
        bonds = f"the peptide bond{'s' * (len(isomerised) > 1)} {abridge(isomerised, 3)}"
        changes[Status.ISOMERISED] = f"{bonds} changed between cis and trans; a restraint prevents it"
    if changes:
        status = next(iter(changes))
        measured = "; ".join([*changes.values(), measured])
        if stop is not Stop.INTERRUPTED:
            return status, f"{status}: {measured}"
        met = False
    # A minimum with overlapping atoms, or with a bond through a ring, is not a usable result.
    overlap = [pair for pair in overlaps(structure, x) if concerns(np.array([pair.atoms]))[0]]
    threaded = [
        ring for ring in threaded_rings(structure, x) if concerns(np.array([[*ring.atoms, *ring.bond]]))[0]
    ]
    if met and not (overlap or threaded):
        if stop is Stop.SADDLE:
            return Status.SADDLE, f"saddle: {stop.value}: {measured}"
        return Status.CONVERGED, f"converged: {measured}"
    if stop is Stop.INTERRUPTED:
        return Status.INTERRUPTED, f"interrupted after {n_evaluations} evaluations: {measured}"
    if overlap:
        suffix = f", and {len(overlap) - 1} more" if len(overlap) > 1 else ""
        return Status.CLASH, f"clash: {overlap[0]}{suffix}; {measured}"
    if threaded:
        remedy = "cartesian and relax try to pull it out; otherwise rebuild these side chains"
        return Status.CLASH, f"clash: {threaded[0]}; {remedy}; {measured}"
    if stop is Stop.NON_FINITE:
        return (
            Status.NON_FINITE,
            f"non-finite: {stop.value}; the last finite structure is returned: {measured}",
        )
    if stop is Stop.BUDGET:
        return Status.BUDGET, f"budget: {n_evaluations} evaluations used: {measured}"
    if stop is Stop.TOLERANCE:
        return Status.STALLED, f"stalled: the tolerance was met only above the lowest energy: {measured}"
    return Status.STALLED, f"stalled: {stop.value}: {measured}"
