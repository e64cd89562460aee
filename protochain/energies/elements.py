"""Parameters by element, without internal energy, for molecules that a force field does not support.

The molecules are fixed obstacles, so only their interaction with the protein matters. They have Lennard-Jones
parameters by element, formal charges from the file if present, and the solvent model's radii of elements.
"""

import copy
import csv
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache
from itertools import combinations
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import openmm
from openmm import app
from scipy.spatial import KDTree

from protochain.core.arrays import Integers
from protochain.core.errors import ForceFieldError
from protochain.core.graph import pairs_within
from protochain.core.units import KJ_PER_KCAL
from protochain.energies.native.terms import TIES
from protochain.structure.molecule.links import is_metal
from protochain.structure.molecule.model import BoundLigand, Structure, Tie
from protochain.structure.molecule.sugars import GLYCOSYLATED
from protochain.structure.molecule.templates import HAS_GLYCAM, PHOSPHATE_END

_UNLISTED = (3.4, 0.1)
_MONOVALENT = {
    ("Cu", 1): (0.2139939, 0.0046986), ("Ag", 1): (0.2389390, 0.0342432), ("Tl", 1): (0.3034401, 0.5866722),
}  # fmt: skip
"""Sigma (nm) and epsilon (kJ/mol) of ions that OpenMM's set for TIP3P lacks: Li, Song, Merz, J. Chem. Theory
Comput. 11:1645 (2015), fitted to free energies of hydration. OpenMM's ions with two or more charges are from
Li, Roberts, Chakravorty, Merz, J. Chem. Theory Comput. 9:2733 (2013)."""
_TOUCHING = 0.4
"""nm. Obstacles closer than this do not interact, because their distance never changes, and alternate
positions or bonds between them would add a large constant."""
_DONATED, _RETAINED = 0.37, 0.26
"""Charge that a donor receives from a metal of charge 2 (e), and smallest share that the metal retains, from
Zn(CYS)4 in ZAFF (Peters, Yang, Wang, Fusti-Molnar, Weaver, Merz, J. Chem. Theory Comput. 6:2935, 2010).
A donor receives the same charge from a smaller metal charge, and in proportion from a larger one."""
_ALONG = ("P", "O3'"), ("O3'", "P")  # Atoms that join nucleotides: of a nucleotide, and of its neighbour.
_IMIDAZOLE = ("CG", "ND1", "CD2", "CE1", "NE2")  # Atoms over which the charge of imidazolate is spread.


@cache
def _universal() -> dict[str, tuple[float, float]]:
    """Distance of the minimum (angstrom) and well depth (kcal/mol) of each element."""
    # Universal force field, table 1 of Rappe, Casewit, Colwell, Goddard, Skiff, JACS 114:10024 (1992).
    with (Path(__file__).parent / "data" / "uff.csv").open(newline="") as file:
        rows = list(csv.reader(file))[1:]
    return {element: (float(minimum), float(depth)) for element, minimum, depth in rows}


def lennard_jones(element: str, charge: float = 0.0) -> tuple[float, float]:
    """Sigma (nm) and epsilon (kJ/mol) of an element with a charge (e)."""
    minimum, depth = _universal().get(element, _UNLISTED)
    by_element = 0.1 * minimum / 2.0 ** (1.0 / 6.0), KJ_PER_KCAL * depth
    return _MONOVALENT.get((element, round(charge)), by_element)


def create_system(
    structure: Structure,
    force_field: app.ForceField,
    reload: Callable[[], app.ForceField],
    pairs: dict[str, Any],
) -> openmm.System:
    """Create the System of a structure with obstacles, by element if they have no parameters."""
    # Atoms near bonds between the protein and obstacles do not repel one another. The force field remains
    # unchanged: ``reload`` returns a new one, which receives templates. ``pairs`` are the arguments of
    # ``createSystem`` for the cutoff.
    bound_ligands = (*structure.ligands, *structure.fragments)
    sugars = structure.glycans
    ions = _ions(structure, force_field)
    ligand_atoms = [_ligand_atoms(structure, bound) for bound in bound_ligands]
    ligand_residues = {r for places in ligand_atoms for r in places}
    topology, unknown = _match_residues(force_field, structure, [*sugars, *ions], ligand_residues)
    unknown = sorted({*unknown, *(r for r, name in ions.items() if not name)})
    _refuse_unknown_mobile(structure, unknown)
    _refuse_without_glycam(structure, force_field)
    linked_atoms = {r: atoms for r, atoms in _linked_atoms(structure).items() if r not in ligand_residues}
    if unknown or linked_atoms or ligand_residues:
        force_field = reload()
    residues = list(topology.residues())
    # Templates of residues that the force field does not match by itself.
    templates = {residues[r]: _element_template(force_field, structure, residues[r]) for r in unknown}
    for r, atoms in linked_atoms.items():
        has_sugar = any(structure.mobile[k] for atom in atoms for k in structure.neighbours[atom])
        templates[residues[r]] = (
            _glycam_name(residues[r]) if has_sugar else _linked_template(force_field, residues[r], atoms)
        )
    templates |= {residues[r]: code for r, code in sugars.items()}
    templates |= {residues[r]: name for r, name in ions.items() if name}
    for bound, places in zip(bound_ligands, ligand_atoms, strict=True):
        templates |= _register_templates(force_field, structure, residues, bound, places)
    system = force_field.createSystem(topology, rigidWater=False, residueTemplates=templates, **pairs)
    for bound in bound_ligands:
        _add_terms(system, bound)
    if structure.ligands:
        _scale_pairs(system, structure.ligands)
    _refuse_unbonded(structure, system)
    by_element = np.isin(structure.atom_residue, list(unknown))
    exclude_pairs(system, _excluded_pairs(structure, by_element))
    _share_charges(system, structure)
    for force in _springs(structure.ties):
        system.addForce(force)
    return system


def _ions(structure: Structure, force_field: app.ForceField) -> dict[int, str]:
    """Template of each monatomic ion, by element and charge, or an empty name if there is none."""
    names = {
        (atom.element, round(atom.parameters.get("charge", 0.0))): template.name
        for template in reversed(force_field._templates.values())
        for atom in template.atoms
        if len(template.atoms) == 1
    }
    count = np.bincount(structure.atom_residue)
    ions = np.flatnonzero(structure.kept & (count[structure.atom_residue] == 1))
    elements = [atom.element for atom in structure.topology.atoms()] if len(ions) else []
    charge = structure.formal_charge
    return {
        int(structure.atom_residue[k]): names.get((elements[k], int(charge[k])), "") for k in ions.tolist()
    }


def _match_residues(
    force_field: app.ForceField, structure: Structure, small: Iterable[int], ligand_residues: set[int]
) -> tuple[app.Topology, list[int]]:
    """Topology for the force field, without bonds unknown to it, and indices of unknown obstacles."""
    # Residues of ``small`` and ``ligand_residues`` have other parameters. The latter are bonded to others.
    residue = structure.atom_residue
    atoms = structure.kept & ~np.isin(residue, [*small])
    bonds = structure.bonds
    is_hetero = structure.kept[bonds]
    is_known = (is_hetero[:, 0] == is_hetero[:, 1]) | structure.mobile[bonds].any(axis=1)
    bonds = bonds[is_known & ~structure.coordination]
    unknown: set[int] = set()
    while True:
        unmatched = {
            int(res.id) for res in force_field.getUnmatchedResidues(_topology(structure, bonds, only=atoms))
        } - ligand_residues
        if not unmatched - unknown:
            return _topology(structure, bonds), sorted(unknown)
        unknown |= unmatched
        # Radii of hydrogens depend on their bonded atom. Other bonds would only add constants.
        has_hydrogen = (structure.atom_element[bonds] == "H").any(axis=1)
        # The strand continues beyond a nucleotide without parameters.
        continues_strand = structure.mobile[bonds].sum(axis=1) == 1
        bonds = bonds[has_hydrogen | continues_strand | ~np.isin(residue[bonds], list(unknown)).any(axis=1)]


def _refuse_unknown_mobile(structure: Structure, unknown: Iterable[int]) -> None:
    """Refuse a moving molecule without parameters, because it would fall apart."""
    if free := {*structure.atom_residue[structure.mobile].tolist()} & {*unknown}:
        raise ForceFieldError(
            f"{structure.describe_residue(min(free))} moves and has no parameters here; give the force field "
            "with which the structure was loaded, or load it without"
        )


def _refuse_without_glycam(structure: Structure, force_field: app.ForceField) -> None:
    """Refuse moving glycans if the force field is not compatible with GLYCAM."""
    if missing := [r for r, code in structure.glycans.items() if code not in force_field._templates]:
        raise ForceFieldError(
            f"{structure.describe_residue(missing[0])} moves with GLYCAM-06j, which goes with {HAS_GLYCAM} "
            "only; load the structure with this force field, so that its glycans stay in place"
        )


def _refuse_unbonded(structure: Structure, system: openmm.System) -> None:
    """Refuse a moving molecule with a bond that has no term. OpenMM omits such bonds silently."""
    pairs = {tuple(sorted(system.getConstraintParameters(k)[:2])) for k in range(system.getNumConstraints())}
    for force in system.getForces():
        if isinstance(force, openmm.HarmonicBondForce | openmm.CustomBondForce):
            pairs |= {tuple(sorted(force.getBondParameters(k)[:2])) for k in range(force.getNumBonds())}
    bonds = structure.bonds
    # Springs replace the bonds to obstacles.
    is_mobile = structure.mobile[bonds].any(axis=1) & ~structure.obstacle[bonds].any(axis=1)
    for i, j in bonds[is_mobile & ~structure.coordination].tolist():
        if (i, j) not in pairs:
            raise ForceFieldError(
                f"the bond of {structure.describe(i)} to {structure.atom_name[j]} has no parameters, and the "
                "molecule moves: add them to its file (HarmonicBondForce)"
            )


def _topology(structure: Structure, bonds: Integers, only: Any = None) -> app.Topology:
    """Topology of all or selected atoms with the given bonds. The id of a residue is its index."""
    topology = app.Topology()
    atoms: dict[int, app.topology.Atom] = {}
    for chain in structure.topology.chains():
        new_chain = topology.addChain(chain.id)
        for residue in chain.residues():
            residue_atoms = [a for a in residue.atoms() if only is None or only[a.index]]
            if not residue_atoms:
                continue
            new_residue = topology.addResidue(residue.name, new_chain, str(residue.index))
            for a in residue_atoms:
                atoms[a.index] = topology.addAtom(a.name, a.element, new_residue)
    for first, second in bonds.tolist():
        if first in atoms and second in atoms:
            topology.addBond(atoms[first], atoms[second])
    return topology


def _element_template(force_field: app.ForceField, structure: Structure, residue: Any) -> str:
    """Add the template of an unknown molecule to a force field and return its name."""
    types, kinds = dict[int, tuple[str, float]](), dict[str, _Kind]()
    charges = _nucleic_charges(force_field, structure, residue) or _charges(structure, residue)
    for a in residue.atoms():
        types[a.index], kind = _element_type(a, charges[a.index])
        kinds[types[a.index][0]] = kind
    return _add_template(force_field, residue, types, kinds)


def _element_type(a: Any, charge: float) -> tuple[tuple[str, float], "_Kind"]:
    """Type, charge and parameters of an atom by its element and charge."""
    symbol = a.element.symbol
    return (f"by-element-{symbol}{charge:+g}", charge), _Kind(symbol, charge, *lennard_jones(symbol, charge))


def _charges(structure: Structure, residue: Any) -> dict[int, float]:
    """Formal charges of a residue's atoms. In clusters the metals have the sum of all charges."""
    # Whole charges at covalent distances would distort the surroundings. Computed charges of iron and
    # sulphide are some tenths.
    charges = {a.index: float(structure.formal_charge[a.index]) for a in residue.atoms()}
    metals = [a.index for a in residue.atoms() if is_metal(a.element.symbol) and charges[a.index] > 0.0]
    anions = [k for k, charge in charges.items() if charge < 0.0]
    if metals and anions:
        total = sum(charges.values())
        bearers = metals if total >= 0.0 else anions
        charges |= dict.fromkeys((*metals, *anions), 0.0) | dict.fromkeys(bearers, total / len(bearers))
    return charges


def _nucleic_charges(force_field: app.ForceField, structure: Structure, residue: Any) -> dict[int, float]:
    """Charges of a nucleotide in a strand, empty without a template. Ends do not have whole charges."""
    # The charge of missing atoms is spread over the other atoms, so the sum equals the template's.
    index = {a.name: a.index for a in residue.atoms()}
    pairs = ((index[a], b, k) for a, b in _ALONG if a in index for k in structure.neighbours[index[a]])
    junctions = {b for i, b, k in pairs if structure.atom_name[k] == b and k not in index.values()}
    if not junctions:
        return {}
    end = "" if len(junctions) == 2 else "5" if "P" in junctions else "3"
    standard = "A" if "O2'" in index else "DA"
    names = (residue.name + end, standard + end)
    template = next((force_field._templates[n] for n in names if n in force_field._templates), None)
    if template is None or any("charge" not in a.parameters for a in template.atoms):
        return {}
    template_charges = {a.name: a.parameters["charge"] for a in template.atoms}
    charges = {k: template_charges.get(name, 0.0) for name, k in index.items()}
    missing_charge = (sum(template_charges.values()) - sum(charges.values())) / len(charges)
    return {k: charge + missing_charge for k, charge in charges.items()}


def _add_template(
    force_field: app.ForceField,
    residue: Any,
    types: Mapping[int, tuple[str, float]],
    kinds: Mapping[str, "_Kind"],
) -> str:
    """Add a residue's template, with type and charge of each atom, and the types. Return its name."""
    for kind, data in kinds.items():
        if kind not in force_field._atomTypes:
            mass = app.Element.getBySymbol(data.symbol).mass._value
            force_field.registerAtomType({"name": kind, "class": kind, "element": data.symbol, "mass": mass})
    _add_pairs(force_field, kinds)
    template = app.ForceField._TemplateData(f"molecule-{residue.index}")
    for a in residue.atoms():
        kind, charge = types[a.index]
        template.addAtom(app.ForceField._TemplateAtomData(f"{a.index}", kind, a.element, {"charge": charge}))
    for bond in residue.internal_bonds():
        template.addBondByName(*(f"{a.index}" for a in bond))
    for bond in residue.external_bonds():
        template.addExternalBondByName(f"{next(a.index for a in bond if a.residue is residue)}")
    # Not registered: it applies to this residue only, and another template may have the same bonds.
    force_field._templates[template.name] = template
    return str(template.name)


class _Kind(NamedTuple):
    """An atom type: element, charge (e), sigma (nm) and epsilon (kJ/mol)."""

    symbol: str
    charge: float
    sigma: float
    epsilon: float


def _add_pairs(force_field: app.ForceField, kinds: Mapping[str, _Kind]) -> None:
    """Add nonbonded parameters in the form of the force field, with or without a table of pairs."""
    generators = {type(generator).__name__: generator for generator in force_field.getGenerators()}
    nonbonded, table = (generators.get(name) for name in ("NonbondedGenerator", "LennardJonesGenerator"))
    for kind, data in kinds.items():
        well = {"type": kind, "sigma": data.sigma, "epsilon": data.epsilon}
        if table is not None:
            table.registerLennardJones(well)
            well |= {"sigma": 1.0, "epsilon": 0.0}
        if nonbonded is not None:
            nonbonded.registerAtom(well | {"charge": data.charge})


def _scale_pairs(system: openmm.System, ligands: Iterable[BoundLigand]) -> None:
    """Scale pairs three bonds apart in ligands by the factors of the ligands' force field."""
    owner = {int(k): (bound.ligand.parameters, i) for bound in ligands for i, k in enumerate(bound.atoms)}
    nonbonded = _force(system, openmm.NonbondedForce)
    for k in range(nonbonded.getNumExceptions()):
        i, j, product, _, epsilon = nonbonded.getExceptionParameters(k)
        if i in owner and j in owner and (product._value or epsilon._value):
            (parameters, a), (_, b) = owner[i], owner[j]
            charges = parameters.scale_coulomb * parameters.charge[a] * parameters.charge[b]
            sigma = 0.5 * (parameters.sigma[a] + parameters.sigma[b])
            depth = parameters.scale_lj * np.sqrt(parameters.epsilon[a] * parameters.epsilon[b])
            nonbonded.setExceptionParameters(k, i, j, charges, sigma, depth if epsilon._value else 0.0)
    # With a table of pairs, Lennard-Jones of pairs three bonds apart is a separate force.
    for force in system.getForces():
        if isinstance(force, openmm.CustomBondForce) and force.getNumPerBondParameters() == 2:
            for k in range(force.getNumBonds()):
                i, j, (sigma, epsilon) = force.getBondParameters(k)
                if i in owner and j in owner:
                    (parameters, a), (_, b) = owner[i], owner[j]
                    depth = np.sqrt(parameters.epsilon[a] * parameters.epsilon[b])
                    force.setBondParameters(k, i, j, [sigma, parameters.scale_lj * depth])


def _is_cap(bound: BoundLigand, i: int) -> bool:
    """Whether an atom of a fragment represents an atom of a neighbour in the chain."""
    return bool(bound.core) and bound.ligand.molecule.names[i][-1] in "+-"


def _ligand_atoms(structure: Structure, bound: BoundLigand) -> dict[int, dict[int, int]]:
    """For each residue of a ligand or fragment, its atoms' indices by atom of the structure."""
    atoms_by_residue: dict[int, dict[int, int]] = {}
    for i, k in enumerate(bound.atoms.tolist()):
        if k >= 0 and not _is_cap(bound, i):
            atoms_by_residue.setdefault(int(structure.atom_residue[k]), {})[k] = i
    return atoms_by_residue


def _register_templates(
    force_field: app.ForceField,
    structure: Structure,
    residues: Sequence[Any],
    bound: BoundLigand,
    places: Mapping[int, Mapping[int, int]],
) -> dict[Any, str]:
    """Add templates of a ligand's or fragment's residues to a force field, and return their names."""
    # Backbones have alanine's types and charges, a nitrogen without hydrogen proline's charge. C-beta has
    # alanine's type. Other charges are from the capped molecule, plus an equal share of the missing charge.
    # Residues whose atoms all belong to the core use the force field's template.
    parameters, formal = bound.ligand.parameters, bound.ligand.molecule.formal_charges
    core = bound.core or ("",) * len(bound.atoms)
    excess = sum(_excess(force_field, residues[r], [core[i] for i in p.values()]) for r, p in places.items())
    places = {r: place for r, place in places.items() if not all(core[i] for i in place.values())}
    index = {k: i for place in places.values() for k, i in place.items()}
    core_types = {r: _core_types(force_field, residues[r], core, place) for r, place in places.items()}
    fixed = {k: charge for row in core_types.values() for k, (_, charge) in row.items() if charge is not None}
    charge = {k: fixed.get(k, float(parameters.charge[i])) for k, i in index.items()}
    if bound.core:  # The charges of a ligand are complete.
        free = [k for k in index if k not in fixed]
        missing = (int(formal[[*index.values()]].sum()) + excess - sum(charge.values())) / len(free)
        charge |= {k: charge[k] + missing for k in free}
    names = {}
    for r, place in places.items():
        types, kinds = dict[int, tuple[str, float]](), dict[str, _Kind]()
        for a in residues[r].atoms():
            if (k := a.index) not in place:  # A metal outside the molecule.
                types[k], kind = _element_type(a, float(structure.formal_charge[k]))
                kinds[types[k][0]] = kind
                continue
            i = place[k]
            types[k] = core_types[r][k][0] if k in core_types[r] else f"molecule-{r}-{a.name}", charge[k]
            if k not in core_types[r]:
                kinds[types[k][0]] = _Kind(
                    a.element.symbol, charge[k], float(parameters.sigma[i]), float(parameters.epsilon[i])
                )
        names[residues[r]] = _add_template(force_field, residues[r], types, kinds)
    return names


def _excess(force_field: app.ForceField, residue: Any, core: Iterable[str]) -> float:
    """Excess over a whole charge of a nucleotide at the end of a strand. The other end compensates it."""
    kind = next(
        (name.partition("/")[0].removeprefix(PHOSPHATE_END).rstrip("35N") for name in core if "/" in name), ""
    )
    bonds = [sorted(bond, key=lambda a: a.residue is not residue) for bond in residue.external_bonds()]
    junctions = {(inner.name, outer.name) for inner, outer in bonds} & {*_ALONG}
    end = {("O3'", "P"): "5", ("P", "O3'"): "3"}[junctions.pop()] if len(junctions) == 1 else ""
    template = force_field._templates.get(kind + end) if kind and end else None
    charge = sum(a.parameters["charge"] for a in template.atoms) if template else 0.0
    return float(charge - round(charge))


def _core_types(
    force_field: app.ForceField, residue: Any, core_names: Sequence[str], place: Mapping[int, int]
) -> dict[int, tuple[str, float | None]]:
    """Types and charges of a residue's core atoms, from alanine, glycine or a nucleotide."""
    # The charges of C-beta and of the sugar atoms at a modified base are None.
    core = {core_names[i].rpartition("/")[2]: k for k, i in place.items() if core_names[i]}
    if not core:
        return {}
    (base,) = {core_names[i].rpartition("/")[0] for i in place.values() if core_names[i]}
    end = "N" if "H1" in core else "C" if "OXT" in core else ""
    template = force_field._templates.get(base or end + ("GLY" if "HA2" in core else "ALA"))
    atoms = {a.name: a for a in template.atoms if "charge" in a.parameters} if template else {}
    if not core.keys() <= atoms.keys():
        raise ForceFieldError(f"residue {residue.name} has parameters beside amber14 and amber19 only")
    changed = {"CB"} if not base else {"C1'", "H1'"} if residue.name not in base else set()
    types = {
        k: (atoms[name].type, None if name in changed else atoms[name].parameters["charge"])
        for name, k in core.items()
    }
    if not base and "N" in core and not end and "H" not in core:
        proline = next(a for a in force_field._templates["PRO"].atoms if a.name == "N")
        types[core["N"]] = atoms["N"].type, proline.parameters["charge"]
    return types


def _add_terms(system: openmm.System, bound: BoundLigand) -> None:
    """Add the molecule's bonded terms that include its own atoms, in place of the force field's."""
    terms, ids = bound.ligand.parameters, bound.atoms
    core = bound.core or ("",) * len(ids)
    inner = {k for i, k in enumerate(ids.tolist()) if k >= 0 and not core[i] and not _is_cap(bound, i)}
    bonds, angles = _force(system, openmm.HarmonicBondForce), _force(system, openmm.HarmonicAngleForce)
    torsions = _force(system, openmm.PeriodicTorsionForce)
    for k in range(torsions.getNumTorsions() if bound.core else 0):
        *atoms, n, phase, _ = torsions.getTorsionParameters(k)
        if inner & {*atoms}:  # From a wildcard rule of the force field.
            torsions.setTorsionParameters(k, *atoms, n, phase, 0.0)
    for term, add in (
        (terms.bonds, bonds.addBond),
        (terms.angles, angles.addAngle),
        (terms.torsions, lambda i, j, k, m, n, *values: torsions.addTorsion(i, j, k, m, round(n), *values)),
    ):
        for places, values in zip(term.atoms.tolist(), term.parameters.tolist(), strict=True):
            atoms = ids[places].tolist()
            if min(atoms) >= 0 and inner & {*atoms}:
                add(*atoms, *values)
            elif inner & {*atoms} and (gaps := [i for i in places if ids[i] < 0 and not _is_cap(bound, i)]):
                raise ForceFieldError(
                    f"{bound.ligand.molecule.names[gaps[0]]} has terms of a bond between residues, but the "
                    "structure lacks it: leave that bond out of the file"
                )


def _force(system: openmm.System, kind: type[openmm.Force]) -> Any:
    """Return the first force of a kind, added if necessary."""
    for force in system.getForces():
        if isinstance(force, kind):
            return force
    system.addForce(kind())
    return system.getForce(system.getNumForces() - 1)


def _linked_atoms(structure: Structure) -> dict[int, set[int]]:
    """Atoms by residue of the protein that have a bond in place of a hydrogen."""
    # The bond is to a hetero atom. In histidines without protons the atom is NE2, whose bond is to a metal.
    atoms: dict[int, set[int]] = {}
    metal = np.array([is_metal(str(symbol)) for symbol in structure.atom_element])
    for first, second in structure.bonds.tolist():
        for inner, outer in ((first, second), (second, first)):
            if structure.kept[outer] and not structure.kept[inner] and not metal[outer]:
                atoms.setdefault(int(structure.atom_residue[inner]), set()).add(inner)
    residue, name = structure.atom_residue, structure.atom_name
    rings = np.unique(residue[(structure.residue_name[residue] == "HIS") & ~structure.kept])
    protonated = {*residue[np.isin(name, ["HD1", "HE2"])].tolist()}
    for r in (r for r in rings.tolist() if r not in protonated):
        atoms.setdefault(r, set()).update(np.flatnonzero((residue == r) & (name == "NE2")).tolist())
    return atoms


def _glycam_name(residue: Any) -> str:
    """GLYCAM's name of a glycosylated residue: ``NLN``, at the ends of a chain ``NNLN``, ``CNLN``."""
    names = {a.name for a in residue.atoms()}
    return ("C" if "OXT" in names else "N" if "H2" in names else "") + GLYCOSYLATED[residue.name]


def _linked_template(force_field: app.ForceField, residue: Any, linked: Iterable[int]) -> str:
    """Add the template of a residue with bonds in place of some hydrogens, and return its name."""
    # The charge of a removed hydrogen moves to its parent atom.
    atoms = {a.name: a for a in residue.atoms() if a.element.symbol != "H"}
    links = {a.name for a in atoms.values() if a.index in set(linked)}
    count = dict.fromkeys(atoms, 0)
    for bond in residue.internal_bonds():
        names = [a.name for a in bond if a.name in atoms]
        if len(names) == 1:
            count[names[0]] += 1
    candidates = [
        (sum(expected.values()), template)
        for template in force_field._templates.values()
        if (expected := _hydrogens(template)).keys() == count.keys()
        and all(n == count[name] or (n > count[name] and name in links) for name, n in expected.items())
    ]
    if not candidates:
        raise ForceFieldError(
            f"residue {residue.name} is bonded to a molecule kept with the protein, and the force field "
            "has no template for it; leave the molecule out: keep none, or the names of others"
        )
    # CYS before CYM: the bond replaces the hydrogen.
    base = max(candidates, key=lambda pair: pair[0])[1]
    variant = _remove_hydrogens(base, count)
    if residue.name == "HIS" and links == {"NE2"}:
        for a in variant.atoms:
            a.parameters["charge"] -= (a.name in _IMIDAZOLE) / len(_IMIDAZOLE)
    for bond in residue.external_bonds():
        variant.addExternalBondByName(next(a.name for a in bond if a.residue is residue))
    variant.name = f"{base.name}-linked-{residue.index}"
    force_field.registerResidueTemplate(variant)
    return str(variant.name)


def _hydrogens(template: Any) -> dict[str, int]:
    """Numbers of hydrogens on the heavy atoms of a template."""
    return {
        a.name: sum(template.atoms[k].element.symbol == "H" for k in a.bondedTo)
        for a in template.atoms
        if a.element is not None and a.element.symbol != "H"
    }


def _remove_hydrogens(base: Any, count: Mapping[str, int]) -> Any:
    """Copy a template with a given number of hydrogens on each heavy atom, and no external bonds."""
    owner: dict[int, int] = {}
    for i, a in enumerate(base.atoms):
        if a.name in count:
            hydrogens = [k for k in a.bondedTo if base.atoms[k].element.symbol == "H"]
            owner |= dict.fromkeys(hydrogens[count[a.name] :], i)
    template = type(base)(base.name)
    template.attributes = dict(base.attributes)
    for i, a in enumerate(base.atoms):
        if i not in owner:
            new_atom = copy.copy(a)
            new_atom.bondedTo, new_atom.externalBonds, new_atom.parameters = [], 0, dict(a.parameters)
            if "charge" in a.parameters:
                charge = sum(base.atoms[k].parameters["charge"] for k, parent in owner.items() if parent == i)
                new_atom.parameters["charge"] += charge
            template.addAtom(new_atom)
    for i, j in base.bonds:
        if i not in owner and j not in owner:
            template.addBondByName(base.atoms[i].name, base.atoms[j].name)
    return template


def _excluded_pairs(structure: Structure, by_element: np.ndarray) -> set[tuple[int, int]]:
    """Pairs near bonds to obstacles, and close pairs of obstacles without parameters."""
    n, bonds, is_hetero, mobile = structure.n_atoms, structure.bonds, structure.kept, structure.mobile
    across = (is_hetero[bonds[:, 0]] != is_hetero[bonds[:, 1]]) & ~mobile[bonds].any(axis=1)
    across |= np.diff(structure.obstacle[bonds]).ravel() | structure.coordination
    pairs: set[tuple[int, int]] = set()
    if across.any():
        near, inner = (map(tuple, pairs_within(graph, n, 3).tolist()) for graph in (bonds, bonds[~across]))
        pairs = {*near} - {*inner}
    atoms = np.flatnonzero(structure.obstacle)
    if len(atoms):
        touching = atoms[KDTree(structure.positions[atoms]).query_pairs(_TOUCHING, output_type="ndarray")]
        pairs |= set(map(tuple, np.sort(touching[by_element[touching].any(axis=1)], axis=1).tolist()))
    residue = structure.atom_residue
    for r in np.unique(residue[by_element]).tolist():
        pairs |= set(combinations(np.flatnonzero(residue == r).tolist(), 2))
    return pairs


def exclude_pairs(system: openmm.System, pairs: Iterable[tuple[int, int]]) -> None:
    """Exclude pairs from all Lennard-Jones and Coulomb forces."""
    pairs = sorted(pairs)
    for force in system.getForces():
        if isinstance(force, openmm.NonbondedForce):
            for i, j in pairs:
                force.addException(i, j, 0.0, 1.0, 0.0, True)
        elif isinstance(force, openmm.CustomNonbondedForce):
            old = {tuple(sorted(force.getExclusionParticles(k))) for k in range(force.getNumExclusions())}
            for i, j in pairs:
                if (i, j) not in old:
                    force.addExclusion(i, j)
        elif isinstance(force, openmm.CustomBondForce):
            # CHARMM's scaled pairs that are now excluded.
            for k in range(force.getNumBonds()):
                i, j, values = force.getBondParameters(k)
                if (min(i, j), max(i, j)) in set(pairs):
                    force.setBondParameters(k, i, j, [0.0 * value for value in values])


def _share_charges(system: openmm.System, structure: Structure) -> None:
    """Move charge from metals to their donors, as bonded models do, with the same sum."""
    # With the charges of a free ion, the solvent model would separate the atoms of a site. Bonded atoms do
    # not attract one another directly.
    donors: dict[int, list[int]] = {}
    for tie in structure.ties:
        if len(tie.atoms) == 2 and is_metal(str(structure.atom_element[tie.atoms[1]])):
            donors.setdefault(tie.atoms[1], []).append(tie.atoms[0])
    if not donors:
        return
    (nonbonded,) = (force for force in system.getForces() if isinstance(force, openmm.NonbondedForce))
    old = np.array([nonbonded.getParticleParameters(i)[0]._value for i in range(structure.n_atoms)])
    new = old.copy()
    for metal, donor_atoms in donors.items():
        if old[metal] > 0.0:
            most = (1.0 - _RETAINED) * old[metal] / len(donor_atoms)
            share = min(_DONATED * max(old[metal] / 2.0, 1.0), most)
            new[metal] -= share * len(donor_atoms)
            new[donor_atoms] += share
    changed_atoms = dict.fromkeys(np.flatnonzero(new != old).tolist())
    for i in changed_atoms:
        _, sigma, epsilon = nonbonded.getParticleParameters(i)
        nonbonded.setParticleParameters(i, new[i], sigma, epsilon)
    for k in range(nonbonded.getNumExceptions()):
        i, j, product, sigma, epsilon = nonbonded.getExceptionParameters(k)
        if product._value and (i in changed_atoms or j in changed_atoms):
            scaled = product._value * new[i] * new[j] / (old[i] * old[j])
            nonbonded.setExceptionParameters(k, i, j, scaled, sigma, epsilon)
    for force in system.getForces():
        if isinstance(force, openmm.CustomGBForce):
            for i in changed_atoms:
                force.setParticleParameters(i, [new[i], *force.getParticleParameters(i)[1:]])


def _springs(ties: Iterable[Tie]) -> list[openmm.Force]:
    """Forces of the ties, by name."""
    bonds, angles = openmm.HarmonicBondForce(), openmm.HarmonicAngleForce()
    for tie in ties:
        (bonds.addBond if len(tie.atoms) == 2 else angles.addAngle)(*tie.atoms, tie.rest, tie.stiffness)
    bonds.setName(TIES)
    angles.setName(TIES)
    return [force for force, n in ((bonds, bonds.getNumBonds()), (angles, angles.getNumAngles())) if n]
