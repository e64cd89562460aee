"""Generalised-Born parameters read from GBSAOBCForce or the CustomGBForce of OpenMM's implicit files."""

import re
from dataclasses import dataclass

import numpy as np
import openmm

from protochain.core.arrays import Floats, Integers
from protochain.core.units import COULOMB
from protochain.energies.native.neck import REACH
from protochain.energies.native.reading import UnsupportedForceError, plain, rows, strip, tables

COULOMB_CUSTOM = 138.935485  # COULOMB as the implicit-solvent files round it.
OBC2_CHARGE_SCALE = np.sqrt(COULOMB_CUSTOM / COULOMB)
"""Factor of the charges of GBSAOBCForce. It rounds COULOMB differently, and energies become equal."""
_PROBE = 0.14  # nm. Radius of water.
_AREA_CUSTOM = 28.3919551  # kJ/mol/nm^2, 4 pi times the surface tension, as the implicit files round it.
OBC_OFFSET = 0.009
"""nm. Offset of the dielectric radii. GBSAOBCForce subtracts it, in the files it is already subtracted."""
_OBC2 = (1.0, 0.8, 4.85)  # alpha, beta, gamma: Onufriev, Bashford, Case, Proteins 55:383 (2004), table 1.
_NUMBER = r"([-+.\deE]+)"
_HCT = (
    "select(step(r+sr2-or1),0.5*(1/L-1/U+0.25*(r-sr2^2/r)*(1/(U^2)-1/(L^2))+0.5*log(L/U)/r),0);"
    "U=r+sr2;L=max(or1,D);D=abs(r-sr2)"
)
_NECK = (
    "Ivdw+neckScale*Ineck;Ineck=step(radius1+radius2+neckCut-r)*getm0(radindex1,radindex2)/"
    "(1+100*(r-getd0(radindex1,radindex2))^2+0.3*1000000*(r-getd0(radindex1,radindex2))^6);Ivdw="
) + _HCT
_WITH_NECKS = re.compile(
    re.escape(_NECK)
    + rf";radius1=or1\+offset;radius2=or2\+offset;neckScale={_NUMBER};neckCut={_NUMBER};offset={_NUMBER}"
)
_PLAIN_RADIUS = "1/(1/or-I)"
_BENT_RADIUS = re.compile(rf"1/\(1/or-tanh\((.+)\)/radius\);psi=I\*or;radius=or\+offset;offset={_NUMBER}")
_BEND = re.compile(rf"(?:(alpha|{_NUMBER})\*)?psi(?:-(beta|{_NUMBER})\*psi\^2)?\+(gamma|{_NUMBER})\*psi\^3")
_PARAMETERS = re.compile(
    rf";solventDielectric={_NUMBER};soluteDielectric={_NUMBER};kappa={_NUMBER};offset={_NUMBER}(?:;cutoff={_NUMBER})?$"
)
_POLAR = "138.935485*(1/soluteDielectric-{}/solventDielectric)*"
_SELF = "-0.5*" + _POLAR + "charge^2/B"
_SURFACE = "28.3919551*(radius+0.14)^2*(radius/B)^6;radius=or+offset"
_PAIR = "-" + _POLAR + "charge1*charge2"
_F = ";f=sqrt(r^2+B1*B2*exp(-r^2/(4*B1*B2)))"


@dataclass(frozen=True, eq=False)
class Necks:
    """Neck tables of GBn and GBn2."""

    kind: Integers  # (na,) int: Row of each atom in the tables.
    # height, place: (kinds, kinds): Height (1/nm) and position (nm) of the peak for atom i next to atom j.
    height: Floats
    place: Floats
    reach: Floats  # (kinds, kinds) nm: Distance at which a neck ends.


@dataclass(frozen=True, eq=False)
class Solvent:
    """Generalised-Born parameters of each atom."""

    # (na,): Charge times the root of Coulomb's constant and of the difference of inverse dielectrics.
    charge: Floats
    offset_radius: Floats  # offset_radius, scaled_radius, radius: (na,) nm.
    scaled_radius: Floats
    radius: Floats
    bend: Floats  # (na, 3): alpha, beta, gamma; zero for HCT.
    surface: Floats  # (na,) kJ/mol nm^6: c of the surface energy c / B^6.
    engulfs: bool  # Whether a sphere that contains a whole atom counts in full, as in GBSAOBCForce.
    necks: Necks | None
    cutoff: float  # nm.
    # Share w of the solvent and kappa (1/nm) of the factor 1 + w (1 - exp(-kappa f)), None without salt.
    salt: tuple[float, float] | None = None


def from_gbsa_obc(force: openmm.GBSAOBCForce, particles: Floats | None = None) -> Solvent:
    """Read OBC2 from GBSAOBCForce, with its particles (na, 3), charge, radius, scale, or others."""
    cut = force.getNonbondedMethod() != force.NoCutoff
    if particles is None:
        particles = np.array(rows(force, "getNumParticles", "getParticleParameters"))
    charge, radius, scale = particles.T
    polar = _polar(force.getSoluteDielectric(), force.getSolventDielectric())
    area = 4.0 * np.pi * plain(force.getSurfaceAreaEnergy())
    offset_radius = radius - OBC_OFFSET
    return Solvent(
        charge * np.sqrt(COULOMB * polar), offset_radius, offset_radius * scale, radius,
        np.tile(_OBC2, (len(radius), 1)), area * (radius + _PROBE) ** 2 * radius**6, True, None,
        plain(force.getCutoffDistance()) if cut else np.inf,
    )  # fmt: skip


def _polar(inside: float, outside: float) -> float:
    """Difference of the inverse dielectrics inside and outside."""
    if inside > outside:
        raise UnsupportedForceError(f"generalised Born of dielectric {inside:g} inside, {outside:g} outside")
    return 1.0 / inside - 1.0 / outside


def from_custom_gb(force: openmm.CustomGBForce) -> Solvent:
    """Read HCT, OBC1, OBC2, GBn or GBn2 from the exact expressions of OpenMM's implicit files."""
    cutoff = np.inf if force.getNonbondedMethod() == force.NoCutoff else plain(force.getCutoffDistance())
    if force.getNumExclusions() or force.getNumGlobalParameters():
        raise UnsupportedForceError("CustomGBForce with exclusions or global parameters")
    names = [force.getPerParticleParameterName(i) for i in range(force.getNumPerParticleParameters())]
    table = np.array(rows(force, "getNumParticles", "getParticleParameters"))
    columns = dict(zip(names, table.T, strict=True))
    values = [force.getComputedValueParameters(i) for i in range(force.getNumComputedValues())]
    terms = [force.getEnergyTermParameters(i) for i in range(force.getNumEnergyTerms())]
    pairs, single = force.ParticlePairNoExclusions, force.SingleParticle
    if [(name, kind) for name, _, kind in values] != [("I", pairs), ("B", single)]:
        raise UnsupportedForceError("CustomGBForce that is none of HCT, OBC1, OBC2, GBn and GBn2")
    bend, radius = _bend(strip(values[1][1]), columns)
    polar, area, salt = _energy_terms(
        [(strip(expression), kind) for expression, kind in terms], cutoff, force
    )
    surface = np.zeros(len(table))
    if area is not None:
        surface = _AREA_CUSTOM * (columns["or"] + area + _PROBE) ** 2 * (columns["or"] + area) ** 6
    return Solvent(
        columns["charge"] * np.sqrt(COULOMB_CUSTOM * polar), columns["or"], columns["sr"], radius, bend,
        surface, False, _necks(strip(values[0][1]), columns, force), cutoff, salt,
    )  # fmt: skip


def _bend(expression: str, columns: dict[str, Floats]) -> tuple[Floats, Floats]:
    n = len(columns["or"])
    if expression == _PLAIN_RADIUS:
        return np.zeros((n, 3)), columns["or"]
    outer = _BENT_RADIUS.fullmatch(expression)
    inner = _BEND.fullmatch(outer[1]) if outer else None
    if outer is None or inner is None:
        raise UnsupportedForceError(f"CustomGBForce with Born radius {expression!r}")
    bend = np.empty((n, 3))
    for column, (group, default) in enumerate(((1, "1"), (3, "0"), (5, "0"))):
        written = inner[group] or default
        bend[:, column] = columns[written] if written in columns else float(written)
    if np.any(bend[:, 0] == 0.0):
        raise UnsupportedForceError("CustomGBForce with alpha = 0")
    return bend, columns["or"] + float(outer[2])


def _energy_terms(
    terms: list[tuple[str, int]], cutoff: float, force: openmm.CustomGBForce
) -> tuple[float, float | None, tuple[float, float] | None]:
    """Difference of inverse dielectrics, the radius offset of a surface term, and the salt."""
    shift = "/f" if cutoff == np.inf else f"*(1/f-{1 / cutoff})"
    matches: dict[str, re.Match[str]] = {}
    for expression, kind in terms:
        tail = _PARAMETERS.search(expression)
        is_salted = tail is not None and float(tail[3]) > 0.0
        decays = [f"exp(-kappa*{distance})" if is_salted else "1" for distance in "Bf"]
        expressions = {
            (_SELF.format(decays[0]), force.SingleParticle): "self",
            (_SURFACE, force.SingleParticle): "surface",
            (_PAIR.format(decays[1]) + shift + _F, force.ParticlePairNoExclusions): "pair",
        }
        name = tail and expressions.get((expression[: tail.start()], kind))
        if tail is None or name is None or name in matches:
            raise UnsupportedForceError(f"CustomGBForce with energy {expression!r}")
        matches[name] = tail
    constants = {tail.groups()[:3] for tail in matches.values()}
    if not {"self", "pair"} <= set(matches) or len(constants) != 1:
        raise UnsupportedForceError("CustomGBForce without the usual polar terms")
    outside, inside, kappa = (float(text) for text in constants.pop())
    area = float(matches["surface"][4]) if "surface" in matches else None
    polar = _polar(inside, outside)
    if kappa > 0.0 and polar == 0.0:
        raise UnsupportedForceError("generalised Born with salt and one dielectric")
    return polar, area, (1.0 / outside / polar, kappa) if kappa > 0.0 else None


def _necks(expression: str, columns: dict[str, Floats], force: openmm.CustomGBForce) -> Necks | None:
    if expression == _HCT:
        return None
    numbers = _WITH_NECKS.fullmatch(expression)
    if numbers is None or float(numbers[2]) != REACH:
        raise UnsupportedForceError(f"CustomGBForce with Born integral {expression!r}")
    scale, offset = float(numbers[1]), float(numbers[3])
    peaks, kind = tables(force), columns["radindex"].astype(np.int64)
    radius = np.zeros(len(peaks["getm0"]))
    radius[kind] = columns["or"] + offset
    if not np.array_equal(radius[kind], columns["or"] + offset):
        raise UnsupportedForceError("CustomGBForce whose necks' types have more than one radius")
    reach = radius[:, None] + radius[None, :] + REACH
    return Necks(kind, scale * peaks["getm0"], peaks["getd0"], reach)
