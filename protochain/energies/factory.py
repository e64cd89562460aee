"""Names a user types -> an OpenMM System -> an Energy."""

import xml.etree.ElementTree as ElementTree
from functools import cache
from pathlib import Path

import numpy as np
import openmm
from openmm import app, unit

from protochain import defaults
from protochain.energies.native import NativeEnergy, UnsupportedForceError
from protochain.energies.openmm_engine import OpenMMEnergy
from protochain.energies.protocol import Energy
from protochain.errors import ForceFieldError
from protochain.structure.model import Structure

DATA = Path(app.__file__).parent / "data"
"""OpenMM's own files. Named by whole path: OpenMM looks for a bare name in the working directory first,
where anyone may have put a file that runs code."""

FORCE_FIELDS = {
    "amber14": "amber14/protein.ff14SB.xml",
    "amber19": "amber19/protein.ff19SB.xml",
    "amber99sb": "amber99sb.xml",
    "amber99sbildn": "amber99sbildn.xml",
    "charmm36": "charmm36.xml",
}
"""Short names of force fields that come with OpenMM; any other name is a file."""

SOLVENTS = {"vacuum": None, "obc2": "implicit/obc2.xml", "gbn2": "implicit/gbn2.xml"}
"""Solvent models, and the OpenMM file that adds each."""

_BESIDE = {
    "amber14": ("amber14/tip3p.xml", "amber14/DNA.OL15.xml", "amber14/RNA.OL3.xml"),
    "amber19": ("amber19/tip3p.xml", "amber14/DNA.OL15.xml", "amber14/RNA.OL3.xml"),
    "amber99sb": ("tip3p.xml",),
    "amber99sbildn": ("tip3p.xml",),
    "charmm36": ("charmm36/water.xml",),
}
"""Waters, ions and nucleic acids, for what is kept beside the protein."""

ENGINES = ("auto", "native", "openmm")

_OBC_OFFSET = 0.009
"""nm. The OBC radius offset that the implicit files subtract from each radius and GBSAOBCForce adds."""

_COULOMB_GBSAOBC = 138.93545764438198
_COULOMB_CUSTOM = 138.935485
"""kJ nm/mol/e^2. GBSAOBCForce and the CustomGBForce of the implicit files round 1/(4 pi epsilon0)
differently: scaling the charges by the root of the ratio makes the two energies equal."""


def energy(
    structure: Structure,
    forcefield: str = defaults.FORCEFIELD,
    solvent: str = defaults.SOLVENT,
    engine: str = defaults.ENGINE,
    *,
    system: openmm.System | None = None,
    threads: int | None = None,
    trust_forcefield: bool = False,
) -> Energy:
    """Build the potential energy of a structure.

    Parameters
    ----------
    structure : Structure
    forcefield : str
        ``amber14`` (ff14SB), ``amber19`` (ff19SB), ``amber99sb``, ``amber99sbildn``, ``charmm36``, the
        name of an XML file that comes with OpenMM, or the path of one.
    solvent : str
        ``vacuum``, ``obc2`` (Onufriev, Bashford, Case, Proteins 55:383, 2004) or ``gbn2`` (Nguyen, Roe,
        Simmerling, J. Chem. Theory Comput. 9:2020, 2013), no cutoff.
    engine : str
        ``native`` (kernels of our own, double precision), ``openmm`` (its CPU platform), or ``auto``: native
        where it can represent every force, and else openmm, with the reason.
    system : openmm.System, optional
        Use this System as it is instead of building one.
    threads : int, optional
        Threads to compute on; all of them by default.
    trust_forcefield : bool
        Allow a force-field file to run the Python scripts and open the files it names.

    Returns
    -------
    Energy

    Raises
    ------
    ForceFieldError
        If a name is unknown, the file would run code, or a residue has no parameters.
    UnsupportedForceError
        If ``native`` is asked for and cannot represent a force exactly; its text names the force.
    """
    if engine not in ENGINES:
        raise ForceFieldError(f"engine {engine!r} is not known; choose from {', '.join(ENGINES)}")
    if threads is not None and threads < 1:
        raise ForceFieldError(f"threads {threads}: give at least 1")
    if system is not None:
        if system.getNumParticles() != structure.n_atoms:
            raise ForceFieldError(
                f"the System has {system.getNumParticles()} particles but {structure.name} has "
                f"{structure.n_atoms} atoms; build it from structure.topology"
            )
        return _by_engine(
            engine, OpenMMEnergy(system, threads=threads, note="the System given by the caller")
        )
    if solvent not in SOLVENTS:
        raise ForceFieldError(f"solvent {solvent!r} is not known; choose from {', '.join(SOLVENTS)}")
    own = _own_file(forcefield)
    if own is None:
        _check_file(Path(forcefield), trust_forcefield)
    files = [own or str(Path(forcefield).resolve())]
    if structure.obstacle.any():
        files += [str(DATA / name) for name in _BESIDE.get(forcefield, ()) if (DATA / name).exists()]
    if SOLVENTS[solvent] is not None:
        files.append(str(DATA / str(SOLVENTS[solvent])))
    try:
        # A user's file may change between calls, and one that is trusted may raise anything.
        force_field = _own_force_field(*files) if own else app.ForceField(*files)
        built = force_field.createSystem(structure.topology, nonbondedMethod=app.NoCutoff, rigidWater=False)
    except Exception as error:
        reason = " ".join(f"{error}".split()) or type(error).__name__
        raise ForceFieldError(
            f"{structure.name}: force field {forcefield!r} with solvent {solvent!r} does not fit: {reason}"
        ) from None
    for atom in np.flatnonzero(structure.obstacle).tolist():
        # OpenMM moves nothing that has no mass.
        built.setParticleMass(atom, 0.0)
    note = "no cutoff"
    if solvent == "obc2":
        note = _use_gbsa_obc(built)
    twin = OpenMMEnergy(built, "CPU", threads, forcefield, solvent, note, structure.fingerprint)
    return _by_engine(engine, twin)


def _by_engine(engine: str, twin: OpenMMEnergy) -> Energy:
    """Return the energy by the engine asked for."""
    if engine == "openmm":
        return twin
    try:
        return NativeEnergy(twin, twin.threads)
    except UnsupportedForceError as error:
        if engine == "native":
            raise
        note = f"{twin.note}; not by the native engine: {error}"
        return OpenMMEnergy(
            twin.system, twin.platform, twin.threads, twin.forcefield, twin.solvent, note.removeprefix("; "),
            twin.atoms,
        )  # fmt: skip


@cache
def _own_force_field(*files: str) -> app.ForceField:
    return app.ForceField(*files)


def _own_file(name: str) -> str | None:
    """Whole path of a file that comes with OpenMM, unless the user has one of that name."""
    inside = (DATA / FORCE_FIELDS.get(name, name)).resolve()
    ours = name in FORCE_FIELDS or (inside.is_relative_to(DATA.resolve()) and not Path(name).exists())
    return str(inside) if ours and inside.is_file() else None


def _check_file(path: Path, trusted: bool) -> None:
    """OpenMM runs the scripts in a force-field file and opens its includes: refuse both unless trusted."""
    try:
        root = ElementTree.parse(path).getroot()
    except OSError:
        known = ", ".join(FORCE_FIELDS)
        raise ForceFieldError(f"force field {str(path)!r} not found; give a file or one of {known}") from None
    except ElementTree.ParseError as error:
        raise ForceFieldError(f"{path}: not a force-field XML file ({error})") from None
    active = sorted(
        {node.tag for node in root.iter() if node.tag in ("Script", "InitializationScript", "Include")}
    )
    if active and not trusted:
        raise ForceFieldError(
            f"{path}: has <{active[0]}>, which runs code or opens files; read it, then allow it with "
            "--trust-forcefield (trust_forcefield=True)"
        )


def _use_gbsa_obc(system: openmm.System) -> str:
    """Put OpenMM's own OBC2 kernel in place of an equal CustomGBForce, where the two are the same.

    The energies are equal (to 1e-8; asserted in the tests); on the CPU platform the kernel is several
    times faster. A CustomGBForce with other parameters, exclusions or tables than ``implicit/obc2.xml``
    gives it is left alone.

    Returns
    -------
    str
        What was done.
    """
    places = [i for i, force in enumerate(system.getForces()) if isinstance(force, openmm.CustomGBForce)]
    if len(places) != 1:
        return "OBC2 as the force field builds it"
    custom = system.getForce(places[0])
    names = [custom.getPerParticleParameterName(i) for i in range(custom.getNumPerParticleParameters())]
    if names != ["charge", "or", "sr"] or custom.getNumExclusions() or custom.getNumFunctions():
        return "OBC2 as a CustomGBForce, which this force field changes from the standard one"
    charge_scale = np.sqrt(_COULOMB_CUSTOM / _COULOMB_GBSAOBC)
    force = openmm.GBSAOBCForce()
    force.setNonbondedMethod(openmm.GBSAOBCForce.NoCutoff)
    force.setSolventDielectric(78.5)
    force.setSoluteDielectric(1.0)
    for i in range(custom.getNumParticles()):
        charge, reduced_radius, scaled_radius = custom.getParticleParameters(i)
        scale = scaled_radius / reduced_radius
        force.addParticle(charge * charge_scale, (reduced_radius + _OBC_OFFSET) * unit.nanometer, scale)
    system.removeForce(places[0])
    system.addForce(force)
    return "no cutoff; OBC2 as GBSAOBCForce, equal to the CustomGBForce of obc2.xml"
