"""Energies built from names of force field, solvent and engine."""

import copy
import io
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
import openmm
from openmm import app, unit
from openmm.app.internal.customgbforces import GBSAOBC2Force

from protochain.core import checks, defaults
from protochain.core.errors import Argument, ForceFieldError
from protochain.core.settings import inheriting
from protochain.core.storage import regular
from protochain.core.timings import part
from protochain.energies.calculators import CalculatorEnergy
from protochain.energies.elements import create_system
from protochain.energies.native import NativeEnergy, UnsupportedForceError
from protochain.energies.native.implicit import OBC2_CHARGE_SCALE
from protochain.energies.native.templates import template_terms
from protochain.energies.native.terms import Terms
from protochain.energies.on_device import PLATFORMS, DeviceEnergy, choose_device
from protochain.energies.openmm_engine import OpenMMEnergy
from protochain.energies.protocol import Energy
from protochain.energies.untrusted import check_expressions, check_passive
from protochain.structure.convert import as_structure
from protochain.structure.molecule import templates
from protochain.structure.molecule.model import Structure
from protochain.structure.molecule.repairs import Kind
from protochain.structure.molecule.residues import NUCLEOTIDES, PHOSPHORYLATED
from protochain.structure.preparation.glycans import parameters

DATA = Path(app.__file__).parent / "data"
"""Files bundled with OpenMM, by full path. OpenMM first searches the working directory for a bare name, and a
file with that name could run code."""

FORCE_FIELDS = {
    "amber14": "amber14/protein.ff14SB.xml",
    "amber19": "amber19/protein.ff19SB.xml",
    "amber99sb": "amber99sb.xml",
    "amber99sbildn": "amber99sbildn.xml",
    "charmm36": "charmm36.xml",
}
"""Short names of force fields bundled with OpenMM. Any other name is a file."""
SOLVENTS = ("vacuum", "hct", "obc1", "obc2", "gbn", "gbn2")
_DIELECTRIC, _TEMPERATURE = 78.5, 298.15
"""Dielectric constant of water and temperature (K), as OpenMM assumes for the screening by salt."""
_HETERO_FILES = {
    "amber14": ("amber14/tip3p.xml", "amber14/DNA.OL15.xml", "amber14/RNA.OL3.xml"),
    "amber19": ("amber19/tip3p.xml", "amber19/DNA.OL21.xml", "amber14/RNA.OL3.xml"),
    "amber99sb": ("tip3p.xml",),
    "amber99sbildn": ("tip3p.xml",),
    "charmm36": ("charmm36/water.xml",),
}
"""Parameters of waters, ions and nucleic acids, for structures with hetero molecules. Other molecules without
parameters get them by element."""

ENGINES = ("auto", "native", "openmm")
DEVICES = ("auto", "cpu", *PLATFORMS)

NONBONDED = " (nonbonded)"  # Suffix of the name of a force field without its dihedrals.
TERMS = ("all", "nonbonded")
"""Terms of a force field in use. ``nonbonded``: pairs of atoms, and bonds and angles to close rings. It omits
dihedrals, impropers and CMAP, for rigid peptide planes that only attract and repel each other."""

_FUNCTION = {"forcefield", "solvent", "salt", "terms", "cutoff", "system", "calculator"}
"""Arguments that define the energy function. The others define how it is computed."""
_MEASURED_UP_TO = 100_000
"""Largest number of atoms for which one sum over all pairs (half a minute) measures the error of a cutoff."""
_BONDED = (
    openmm.HarmonicBondForce, openmm.HarmonicAngleForce, openmm.PeriodicTorsionForce,
    openmm.CustomTorsionForce, openmm.CMAPTorsionForce,
)  # fmt: skip
_TABULATED = "LennardJones"  # Name of OpenMM's force with a table of pairs.


def has_energy(source: Any) -> bool:
    """Whether an object has an energy, as results do."""
    return getattr(source, "energy_function", None) is not None


def _inherit_energy(build: Callable[..., Energy], source: Any, arguments: dict[str, Any]) -> Energy:
    """Return the energy of a source, if it has one, with the named arguments replaced."""
    if not has_energy(source):
        return build(source, **arguments)
    source_energy: Energy = source.energy_function
    settings = dict(getattr(source_energy, "settings", {}))
    is_another = bool(arguments.keys() & _FUNCTION)
    if not arguments or not (settings or is_another):  # A callable has no options.
        return source_energy
    if not source_energy.atoms and not is_another:
        settings["system"] = source_energy.system
    if "forcefield" in arguments:
        settings.pop("trust_forcefield", None)  # Trust in one file does not extend to another.
    if "system" in arguments or arguments.get("solvent") == "vacuum":
        settings.pop("salt", None)
    return build(source, **(settings | arguments))


@checks.check_arguments(
    forcefield=checks.file_name, solvent=checks.text, salt=checks.concentration,
    engine=checks.one_of(ENGINES), device=checks.one_of(DEVICES), cutoff=checks.cutoff_of,
    accuracy=checks.accuracy_of, threads=checks.optional(checks.at_least(1)), trust_forcefield=checks.flag,
    terms=checks.one_of(TERMS), calculator=checks.optional(checks.text),
    system=checks.instance(openmm.System, "ForceField.createSystem"),
)  # fmt: skip
@inheriting(_inherit_energy)
@part("energy")
def energy(
    structure: Any,
    forcefield: str = defaults.FORCEFIELD,
    solvent: str = defaults.SOLVENT,
    engine: str = defaults.ENGINE,
    *,
    salt: float = defaults.SALT,
    device: str = defaults.DEVICE,
    cutoff: float | Literal["auto"] | None = defaults.CUTOFF,
    accuracy: float | Literal["auto", "exact"] = defaults.ACCURACY,
    system: openmm.System | None = None,
    threads: int | None = None,
    trust_forcefield: bool = False,
    terms: str = "all",
    calculator: str | None = None,
) -> Energy:
    """Build the potential energy of a structure.

    Parameters
    ----------
    structure : Structure, path, or any input of :func:`protochain.as_structure`
        Structure whose energy to build. A result has its own energy, as in all calls: arguments that are not
        named here remain unchanged.
    forcefield : str
        ``amber14`` (ff14SB), ``amber19`` (ff19SB), ``amber99sb``, ``amber99sbildn``, ``charmm36``, the
        name of an XML file bundled with OpenMM, or the path of an XML file. Several are separated by commas,
        as ``amber14,ligand.xml``.
    solvent : str
        ``vacuum``, or a generalised-Born model: ``obc2``, ``obc1`` (Onufriev, Bashford, Case, Proteins
        55:383, 2004), ``gbn2`` (Nguyen, Roe, Simmerling, J. Chem. Theory Comput. 9:2020, 2013), ``gbn``
        (Mongan et al., J. Chem. Theory Comput. 3:156, 2007) or ``hct`` (Hawkins, Cramer, Truhlar,
        J. Phys. Chem. 100:19824, 1996).
    engine : str
        ``native`` (compiled kernels, double precision), ``openmm`` (CPU platform, single precision), or
        ``auto``: native if it supports every force, otherwise openmm. ``reason`` of the energy explains it.
    salt : float
        Concentration of a monovalent salt in the solvent, mol/l, also as a Quantity of OpenMM. It screens
        generalised Born at 298.15 K, also in simulations at other temperatures (Srinivasan et al., Theor.
        Chem. Acc. 101:426, 1999). Far pairs are then not summed by a tree.
    device : str
        ``cpu``, or ``cuda``, ``hip`` or ``opencl``: an OpenMM platform in mixed precision. The engine then
        judges the end and completes the run. ``auto``: CUDA or HIP, if present, from 5,000 atoms, unless the
        engine is ``native``. The processor computes if a device fails. A ``DeviceWarning`` and ``reason``
        report it.
    cutoff : float, "auto" or None, optional
        Distance in nm up to which pairs of atoms interact. None: all pairs, one by one unless ``accuracy``
        is a number. ``auto``: all pairs, but 2 nm in a solvent for more than 20,000 atoms if no tree sums
        them. ``reason`` of the energy then reports the error of the forces. In vacuum charges are not
        screened, so no distance is accurate. Values below 0.5 nm are refused, because atoms in contact would
        not interact.
    accuracy : float, "auto" or "exact", optional
        Largest RMS error of the forces in kJ/mol/nm for which the native engine may sum far pairs by a tree.
        Its time grows as the number of atoms. The error is measured against the sum over all pairs and is in
        ``reason``. ``exact``: all pairs one by one. ``auto``: 1e-3 for sizes at which a tree is quicker.
    system : openmm.System, optional
        System to use instead of building one. It is copied, so that later changes do not affect a run.
    threads : int, optional
        Number of threads, all by default.
    trust_forcefield : bool
        Allow a force-field file to run its Python scripts and to include other files.
    terms : str
        ``all``, or ``nonbonded``: only electrostatics, van der Waals and the solvent, for methods that only
        turn hinges, as in Kazerounian, Latif, Alvarado, J. Mech. Des. 127:699 (2005).
    calculator : str, optional
        ``xtb``, ``aimnet2`` or ``mace-off``, for the terms within the ligands, or within a structure of few
        atoms without ligands. All other terms, and the solvent, remain those of the force field.

    Returns
    -------
    Energy
        Callable from positions (na, 3) in nm to energy in kJ/mol and forces (na, 3) in kJ/mol/nm.

    Raises
    ------
    ForceFieldError
        If a name is unknown, the file would run code, a residue has no parameters, or there is salt without
        a solvent model.
    UnsupportedForceError
        If the engine is ``native`` and has no exact kernel for a force.

    Examples
    --------
    >>> s = pc.from_sequence("GAG")
    >>> value, forces = pc.energy(s)(s.positions)
    >>> forces.shape
    (27, 3)
    """
    settings = {name: value for name, value in locals().items() if name not in ("structure", "system")}
    if calculator is not None:
        return CalculatorEnergy(energy, as_structure(structure), system=system, **settings)
    if engine == "native" and device not in ("auto", "cpu"):
        raise ForceFieldError(
            Argument("engine", engine), " computes on the processor; leave out ", Argument("device", device)
        )
    structure = as_structure(structure)
    if accuracy not in ("auto", "exact") and (cutoff not in ("auto", None) or engine == "openmm"):
        cause = ("the engine of OpenMM",) if engine == "openmm" else ("a ", Argument("cutoff"))
        raise ForceFieldError(Argument("accuracy"), " is of a tree by the native engine, and not of ", *cause)
    if system is not None and system.getNumParticles() != structure.n_atoms:
        raise ForceFieldError(
            f"the System has {system.getNumParticles()} particles but {structure.name} has "
            f"{structure.n_atoms} atoms; build it from structure.topology"
        )
    if system is not None and salt:
        raise ForceFieldError(
            Argument("salt"), " is of a named solvent; build the System with implicitSolventKappa"
        )
    is_free = accuracy == "auto" and cutoff == "auto"
    # No tree sums pairs that salt screens.
    sums = _sums_of("openmm" if salt else engine, solvent, structure.n_atoms) if is_free else ("exact", None)
    accuracy = sums[0] if accuracy == "auto" else accuracy
    cutoff = sums[1] if cutoff == "auto" else cutoff
    device = "cpu" if engine == "native" else choose_device(device, structure.n_atoms)

    is_plain = system is None and cutoff is None and not salt and terms == "all"
    native_terms = None
    if is_plain and device == "cpu" and engine != "openmm":
        native_terms = _terms_of(structure, forcefield, solvent)

    def by_openmm(cutoff: float | None) -> OpenMMEnergy:
        if system is not None:
            note = "System given by the caller"
            return OpenMMEnergy(copy.deepcopy(system), threads=threads, note=note, settings=settings)
        arguments = (structure, forcefield, solvent, trust_forcefield, cutoff, salt)
        built: Any = build_system(*arguments) if native_terms is None else partial(build_system, *arguments)
        note = f"cutoff {cutoff:g} nm" if cutoff else "no cutoff"
        if solvent == "obc2" and not salt:
            note += "; OBC2 as GBSAOBCForce, equal to the CustomGBForce of obc2.xml"
        if terms == "nonbonded":
            for index in reversed(_torsion_forces(built)):
                built.removeForce(index)
        label = forcefield + NONBONDED if terms == "nonbonded" else forcefield
        name = solvent_label(solvent, salt)
        return OpenMMEnergy(built, "CPU", threads, label, name, note, structure.fingerprint, settings)

    reference = by_openmm(cutoff)
    potential = choose_engine(engine, reference, native_terms)
    if device != "cpu":
        return DeviceEnergy(potential, reference, device, None if accuracy == "exact" else float(accuracy))
    # If the native engine does not support a force, OpenMM computes the energy by its own rule.
    _, fallback = _sums_of("openmm", solvent, structure.n_atoms)
    if is_free and system is None and not isinstance(potential, NativeEnergy) and fallback != cutoff:
        settings |= {"device": "cpu", "cutoff": fallback}
        return choose_engine(engine, by_openmm(fallback))
    if isinstance(potential, NativeEnergy) and accuracy != "exact":
        return potential.to_accuracy(float(accuracy), structure.positions)
    is_measured = system is None and cutoff is not None and structure.n_atoms <= _MEASURED_UP_TO
    if isinstance(potential, NativeEnergy) and is_measured:
        reference.note += f"; {potential.cutoff_error(structure.positions)}"
    return potential


def _sums_of(engine: str, solvent: str, n_atoms: int) -> tuple[float | Literal["exact"], float | None]:
    """Accuracy, and cutoff in nm, if the caller gives neither: of a tree, or else all pairs one by one."""
    # ``auto`` uses the native engine if it supports every force, or an OpenMM device from
    # ``defaults.DEVICE_FROM`` atoms (:func:`protochain.energies.on_device.choose_device`).
    in_solvent = solvent != "vacuum"
    if engine != "openmm" and n_atoms >= (defaults.TREE_FROM if in_solvent else defaults.TREE_FROM_IN_VACUUM):
        return defaults.TREE_ACCURACY, None
    return "exact", defaults.LONG_CUTOFF if in_solvent and n_atoms > defaults.FULL_UP_TO else None


def build_system(
    structure: Structure,
    forcefield: str = defaults.FORCEFIELD,
    solvent: str = defaults.SOLVENT,
    trust_forcefield: bool = False,
    cutoff: float | None = None,
    salt: float = defaults.SALT,
) -> openmm.System:
    """Build the OpenMM System of a structure from the files of the force field.

    Parameters
    ----------
    structure : Structure
        Structure whose System to build.
    forcefield, solvent : str
        As for :func:`energy`.
    trust_forcefield : bool
        As for :func:`energy`.
    cutoff : float, optional
        As for :func:`energy`, none by default.
    salt : float
        As for :func:`energy`.

    Returns
    -------
    openmm.System
        Obstacles have no mass, so that OpenMM does not move them. OBC2 without salt is a GBSAOBCForce.

    Raises
    ------
    ForceFieldError
        As for :func:`energy`.
    """
    if solvent not in SOLVENTS:
        raise ForceFieldError(f"solvent {solvent!r} is not known; choose from {', '.join(SOLVENTS)}")
    if salt and solvent == "vacuum":
        models = ", ".join(SOLVENTS[1:])
        raise ForceFieldError(Argument("salt"), f" {salt:g} needs a solvent model; choose from {models}")
    pairs: dict[str, Any] = {"nonbondedMethod": app.NoCutoff}
    if cutoff is not None:
        pairs = {"nonbondedMethod": app.CutoffNonPeriodic, "nonbondedCutoff": cutoff * unit.nanometer}
    files, is_bundled = _files(structure, forcefield, trust_forcefield)
    if salt:
        pairs["implicitSolventKappa"] = debye_kappa(salt)
    is_by_file = solvent != "vacuum" and (solvent != "obc2" or bool(salt))
    files += [str(DATA / f"implicit/{solvent}.xml")] if is_by_file else []
    try:
        # A user's file may change between calls, and a trusted file may raise any exception.
        force_field = _bundled_force_field(*files) if is_bundled else _force_field(*files)
        if structure.kept.any() or structure.fragments:
            system = create_system(structure, force_field, lambda: _force_field(*files), pairs)
        else:
            system = force_field.createSystem(structure.topology, rigidWater=False, **pairs)
        if solvent == "obc2" and not is_by_file:
            _add_obc2(system, structure, cutoff)
    except Exception as error:
        reason = " ".join(f"{error}".split()) or type(error).__name__
        remedy: tuple[str | Argument, ...] = ()
        if structure.fragments or _phosphorylated_names(structure):
            remedy = "; without modified residues: ", Argument("standard_residues", True)
        elif any(repair.kind in (Kind.CAP_AT_BREAK, Kind.CAP_AT_END) for repair in structure.repairs):
            remedy = "; without caps: ", Argument("cap", "none")
        raise ForceFieldError(
            f"{structure.name}: force field {forcefield!r} with solvent {solvent!r} does not fit: {reason}",
            *remedy,
        ) from None
    _number_types(system)
    for atom in np.flatnonzero(structure.obstacle).tolist():
        system.setParticleMass(atom, 0.0)
    return system


def _files(structure: Structure, forcefield: str, trust_forcefield: bool) -> tuple[list[str | bytes], bool]:
    """Files of the parameters of a structure, without its solvent, and whether all are OpenMM's."""
    parts = checks.force_field_parts(forcefield)
    bundled = [_bundled_file(part) for part in parts]
    files = checked_files(parts, trust_forcefield)
    files += _phosphate_files(structure, parts)
    if structure.kept.any():
        hetero_files = [str(DATA / name) for part in parts for name in _HETERO_FILES.get(part, ())]
        files += [name for name in dict.fromkeys(hetero_files) if Path(name).exists()]
        has_nucleotides = any("/DNA." in name for name in hetero_files)
        if has_nucleotides and (structure.atom_name == "OP3").any():
            files.append(templates.phosphate_ends())
        strands = [
            name for name in files if isinstance(name, str) and Path(name).name[:4] in ("DNA.", "RNA.")
        ]
        if len(strands) == 2 and _has_junctions(structure):
            files.append(templates.strand_junctions(*strands))
    if structure.glycans and templates.HAS_GLYCAM in parts:
        files.append(parameters(frozenset(structure.glycans.values())))
    return files, None not in bundled


def _terms_of(structure: Structure, forcefield: str, solvent: str) -> Terms | None:
    """Terms for the native engine, or None if they require a System, or it has to report an error."""
    if solvent not in ("obc2", "vacuum") or structure.kept.any() or structure.fragments:
        return None
    if None in map(_bundled_file, checks.force_field_parts(forcefield)):
        return None
    files, _ = _files(structure, forcefield, False)
    try:
        obc2 = _obc2(None) if solvent == "obc2" else None
        return template_terms(structure, _bundled_force_field(*files), obc2)
    except Exception:  # As for a System, which raises it again, with a remedy.
        return None


def debye_kappa(salt: float) -> float:
    """Screening parameter in 1/nm of a monovalent salt in mol/l, as OpenMM's for generalised Born."""
    # The factor 0.73 is for the size of the ions: Srinivasan, Trevathan, Beroza, Case, Theor. Chem. Acc.
    # 101:426 (1999).
    return float(50.33355 * np.sqrt(salt / _DIELECTRIC / _TEMPERATURE) * 7.3)


def solvent_label(solvent: str, salt: float) -> str:
    """Name of a solvent model, with its salt if there is one."""
    return f"{solvent} with {salt:g} mol/l salt" if salt else solvent


def _has_junctions(structure: Structure) -> bool:
    """Whether nucleotides of DNA and RNA are bonded to one another."""
    names = structure.residue_name[structure.atom_residue[structure.bonds]]
    nucleic = np.isin(names, [*NUCLEOTIDES]).all(axis=1)
    return bool((np.diff(np.char.startswith(names[nucleic].astype(str), "D").astype(int), axis=1) != 0).any())


def _phosphorylated_names(structure: Structure) -> set[str]:
    """Names of the phosphorylated residues of the protein."""
    return {*structure.residue_name[structure.atom_residue[~structure.kept]].tolist()} & PHOSPHORYLATED


def _phosphate_files(structure: Structure, parts: Sequence[str]) -> list[str]:
    """Files with the parameters of phosphorylated residues that the user's files do not define."""
    if not (names := _phosphorylated_names(structure)):
        return []
    if names <= templates.residue_names([Path(part) for part in parts if _bundled_file(part) is None]):
        return []
    return [str(templates.PHOSPHATES[part]) for part in parts if part in templates.PHOSPHATES]


def _number_types(system: openmm.System) -> None:
    """Number the types of a table of pairs in the order of the atoms, because OpenMM's set is unordered."""
    for force in system.getForces():
        if not isinstance(force, openmm.CustomNonbondedForce) or force.getName() != _TABULATED:
            continue
        types = [int(force.getParticleParameters(i)[0]) for i in range(force.getNumParticles())]
        order = list(dict.fromkeys(types))
        for i, old in enumerate(types):
            force.setParticleParameters(i, [order.index(old)])
        for k in range(force.getNumTabulatedFunctions()):
            table = force.getTabulatedFunction(k)
            n, _, values = table.getFunctionParameters()
            table.setFunctionParameters(n, n, np.reshape(values, (n, n))[np.ix_(order, order)].ravel())


def choose_engine(engine: str, by_openmm: OpenMMEnergy, terms: Terms | None = None) -> Energy:
    """Choose the engine. ``auto`` falls back on OpenMM and records the reason. ``terms`` equal the System."""
    if engine == "openmm":
        return by_openmm
    try:
        return NativeEnergy(by_openmm, by_openmm.threads, terms=terms)
    except UnsupportedForceError as error:
        if engine == "native":
            raise
        by_openmm.note = f"{by_openmm.note}; not by the native engine: {error}".removeprefix("; ")
        return by_openmm


def _force_field(*files: str | bytes) -> app.ForceField:
    return app.ForceField(*(io.BytesIO(file) if isinstance(file, bytes) else file for file in files))


_bundled_force_field = cache(_force_field)


def _bundled_file(name: str) -> str | None:
    """Full path of a file bundled with OpenMM, or None for a user's file."""
    path = (DATA / FORCE_FIELDS.get(name, name)).resolve()
    bundled = name in FORCE_FIELDS or (path.is_relative_to(DATA.resolve()) and not Path(name).exists())
    return str(path) if bundled and path.is_file() else None


def checked_files(parts: Sequence[str], trusted: bool) -> list[str | bytes]:
    """Files or contents that OpenMM reads for the parts of a force field."""
    return [_bundled_file(part) or _checked_file(Path(part), trusted) for part in parts]


def _checked_file(path: Path, trusted: bool) -> str | bytes:
    """Checked bytes for OpenMM to read, or the path of a trusted file, which may include others."""
    try:
        content = regular(path).read_bytes()
        root = ElementTree.fromstring(content)
    except OSError:
        names = ", ".join(FORCE_FIELDS)
        raise ForceFieldError(f"force field {str(path)!r} not found; give a file or one of {names}") from None
    except ElementTree.ParseError as error:
        raise ForceFieldError(f"{path}: {templates.NO_XML} ({error}); {templates.CONVERT}") from None
    if root.tag == templates.SMIRNOFF:
        raise ForceFieldError(f"{path}: {templates.NO_OPENMM}; {templates.CONVERT}")
    check_expressions(path, root)
    if trusted:
        return str(path.resolve())
    check_passive(path, root)
    return content


def bonded_part(energy: Energy) -> Energy | None:
    """Bonds, angles and dihedrals of an energy without other terms: its molecules stay intact."""
    # None if the terms are unknown, as for a callable.
    bonded: Energy | None = getattr(energy, "bonded_terms", None)
    if bonded is not None or energy.system is None:
        return bonded
    system = copy.deepcopy(energy.system)
    for index in reversed(range(system.getNumForces())):
        if not isinstance(system.getForce(index), _BONDED):
            system.removeForce(index)
    by_openmm = OpenMMEnergy(system, "CPU", energy.threads, energy.forcefield, "vacuum", "bonded terms alone")
    return choose_engine("auto", by_openmm)


def lacks_dihedrals(energy: Energy) -> bool:
    """Whether an energy has a System without dihedral forces."""
    # The System is built only if the terms do not answer.
    terms: Terms | None = getattr(energy, "terms", None)
    if terms is not None and any(len(terms.bonded[kind].atoms) for kind in ("torsions", "impropers", "maps")):
        return False
    system = energy.system
    return isinstance(system, openmm.System) and not _torsion_forces(system)


def _torsion_forces(system: openmm.System) -> list[int]:
    return [i for i, force in enumerate(system.getForces()) if "Torsion" in type(force).__name__]


def _add_obc2(system: openmm.System, structure: Structure, cutoff: float | None) -> None:
    """Add OBC2 as GBSAOBCForce, with the charges of the System and the radii of ``implicit/obc2.xml``."""
    # That file builds a CustomGBForce by a script, in a third of the time of a System. Energies are equal to
    # 1e-8, as a test asserts. OpenMM's CPU platform is several times faster with GBSAOBCForce.
    nonbonded = [force for force in system.getForces() if isinstance(force, openmm.NonbondedForce)]
    if len(nonbonded) != 1:
        raise ValueError("OBC2 needs a NonbondedForce with the charges")
    nonbonded[0].setReactionFieldDielectric(1.0)
    force = _obc2(cutoff)
    for i, (radius, scale) in enumerate(GBSAOBC2Force.getStandardParameters(structure.topology)):
        charge = nonbonded[0].getParticleParameters(i)[0]._value
        force.addParticle(charge * OBC2_CHARGE_SCALE, radius, scale)
    system.addForce(force)


def _obc2(cutoff: float | None) -> openmm.GBSAOBCForce:
    force = openmm.GBSAOBCForce()
    force.setSolventDielectric(_DIELECTRIC)
    force.setSoluteDielectric(1.0)
    force.setNonbondedMethod(force.NoCutoff if cutoff is None else force.CutoffNonPeriodic)
    if cutoff is not None:
        force.setCutoffDistance(cutoff)
    return force
