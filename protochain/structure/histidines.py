"""Tautomers of histidine, and which way its ring lies, by the hydrogen bonds of its nitrogens."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import gemmi
import numpy as np
from scipy.spatial import KDTree

from protochain.core.arrays import Floats
from protochain.structure.member import Member
from protochain.structure.templates import Template

_HYDROGEN_BOND = 3.5
"""Angstrom, donor to acceptor, as in OpenMM's Modeller."""
_REACH = 6.0
"""Angstrom: nitrogens are 2.2 from CG."""
_STRAIGHT = np.cos(np.deg2rad(50.0))
_RING = {"ND1": ("CG", "CE1"), "NE2": ("CD2", "CE1"), "CD2": ("CG", "NE2"), "CE1": ("ND1", "NE2")}
"""Atoms that have a hydrogen or a pair of electrons, and their neighbours."""
_CARBON = 3.0
"""Angstrom: a carbon of the ring is not as near to an oxygen or nitrogen."""
_BEYOND_CG = ("ND1", "CD2", "CE1", "NE2", "HD2", "HE1")
TAUTOMERS = {"HID": "ND1", "HIE": "NE2"}
"""The nitrogen that has the hydrogen; of equal ones the first is taken."""
_TURNABLE = 0.75
"""What the bond of a hydroxyl or water to a nitrogen counts, which may turn elsewhere."""
_EVIDENCE = 2.5
"""What a ring must gain to be turned, as by three hydrogen bonds: only if the file is clearly wrong."""


@dataclass(frozen=True, eq=False)
class Polar:
    """An oxygen, nitrogen or metal, and whether it gives a hydrogen, or a metal's charge, and takes one."""

    atom: gemmi.Atom
    owner: Member
    gives: bool
    takes: bool

    @property
    def x(self) -> Floats:
        """(3,) float, angstrom."""
        return np.array(self.atom.pos.tolist())


def settled(of: Iterable[tuple[Member, Template | None]]) -> tuple[dict[int, str], set[int]]:
    """Choose the tautomers with the best hydrogen bonds, one after the other; rings are turned in place."""
    residues = [*of]
    undecided = [member for member, template in residues if template is None]
    if not undecided:
        return {}, set()
    polar = [
        Polar(a, member, *_role(a, template))
        for member, template in residues
        for a in member.atoms
        if a.element.name in ("N", "O") or a.element.is_metal
    ]
    tree = KDTree([each.x for each in polar])
    own: dict[int, list[int]] = {}
    for k, each in enumerate(polar):
        own.setdefault(id(each.owner), []).append(k)
    states, rings = dict[int, str](), set[int]()
    for member in undecided:
        at = {a.name: np.array(a.pos.tolist()) for a in member.atoms}
        near = [k for k in tree.query_ball_point(at["CG"], _REACH) if polar[k].owner is not member]
        energy = {
            (state, turned): _EVIDENCE * turned
            + sum(_energy([polar[k] for k in near], its, name, name == gives) for name in _RING)
            for turned, its in ((False, at), (True, _turned(at)))
            for state, gives in TAUTOMERS.items()
        }
        states[id(member)], turned = min(energy, key=energy.__getitem__)
        if turned:
            rings.add(id(member))
            for a in member.atoms:
                a.pos = gemmi.Position(*_turned(at)[a.name])
        for k in own[id(member)]:
            if (each := polar[k]).atom.name in TAUTOMERS.values():
                has = each.atom.name == TAUTOMERS[states[id(member)]]
                polar[k] = replace(each, gives=has, takes=not has)
    return states, rings


def _turned(at: Mapping[str, Floats]) -> dict[str, Floats]:
    """Places of the atoms with the ring turned by 180 degrees about CB-CG."""
    axis = (at["CG"] - at["CB"]) / np.linalg.norm(at["CG"] - at["CB"])
    arms = {name: at[name] - at["CG"] for name in at.keys() & {*_BEYOND_CG}}
    return {**at, **{name: at["CG"] + 2.0 * (arm @ axis) * axis - arm for name, arm in arms.items()}}


def _energy(near: Iterable[Polar], at: Mapping[str, Floats], name: str, has_hydrogen: bool) -> float:
    """-1 for each hydrogen bond of a nitrogen, 1 for a carbon, or a second hydrogen or pair, in its place."""
    reach = _CARBON if name[0] == "C" else _HYDROGEN_BOND
    first, second = _RING[name]
    out = 2.0 * at[name] - at[first] - at[second]
    out = out / max(float(np.linalg.norm(out)), 1e-9)
    energy = 0.0
    for each in near:
        way = each.x - (at[name] + out)
        if np.linalg.norm(each.x - at[name]) > reach or way @ out <= _STRAIGHT * np.linalg.norm(way):
            continue
        if name[0] == "N" and (each.takes if has_hydrogen else each.gives):
            energy -= 1.0 if has_hydrogen or not each.takes else _TURNABLE
        else:
            energy += 1.0
    return energy


def _role(a: gemmi.Atom, template: Template | None) -> tuple[bool, bool]:
    """Whether an atom gives a hydrogen, and takes one, by its template; both if it may be either."""
    if a.element.is_metal:
        return True, False
    if template is None:
        return a.name != "O", a.name != "N"
    gives = bool(template.hydrogens.get(a.name))
    is_open = not (template.hydrogens or template.is_users)
    return gives or is_open, a.element.name == "O" or not (gives or a.name == "N")
