"""Ligands recognised by their elements and bonds: programs name templates and atoms as they like."""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from scipy.spatial import KDTree

from protochain.structure.molecule.member import Member
from protochain.structure.molecule.templates import Template

_BOND_SLACK, _BOND_SHORTEST = 0.4, 0.5
"""Angstrom: atoms at most this much further apart than the sum of their covalent radii are bonded, and not
below the second."""
_Graph = tuple[dict[str, tuple[str, int]], dict[str, set[str]]]
"""What each heavy atom is, by name, and its heavy neighbours."""


def by_element(member: Member) -> Template:
    """Template of a molecule as it is in the file: elements and charges, bonds by distance."""
    atoms = member.atoms
    x = np.array([a.pos.tolist() for a in atoms])
    radius = np.array([a.element.covalent_r for a in atoms])
    bonds = []
    for i, j in sorted(KDTree(x).query_pairs(2 * radius.max() + _BOND_SLACK)):
        if atoms[i].is_hydrogen() or atoms[j].is_hydrogen():
            continue
        distance = float(np.linalg.norm(x[i] - x[j]))
        if _BOND_SHORTEST < distance < radius[i] + radius[j] + _BOND_SLACK:
            bonds.append((atoms[i].name, atoms[j].name))
    heavy = [a for a in atoms if not a.is_hydrogen()]
    for atom in atoms:
        if atom.is_hydrogen():
            bonds.append((min(heavy, key=lambda a: a.pos.dist(atom.pos)).name, atom.name))
    return Template(
        member.name,
        {a.name: a.element.name for a in atoms},
        {a.name: float(a.charge) for a in atoms},
        tuple(bonds),
        {},
    )


def recognised(member: Member, seen: Template, known: Iterable[Template]) -> Template | None:
    """Find the template whose heavy atoms are bonded as those of a molecule."""
    candidates = list(known)
    for with_hydrogens in (True, False) if seen.hydrogens else (False,):
        mine = _graph(seen, with_hydrogens)
        for template in candidates:
            called = _matched(mine, _graph(template, with_hydrogens))
            if called is not None:
                return _renamed(template, called, seen, member.name)
    return None


def _graph(template: Template, with_hydrogens: bool) -> _Graph:
    count = template.hydrogens if with_hydrogens else {}
    kinds = {name: (template.element[name], len(count.get(name, ()))) for name in template.heavy}
    beside: dict[str, set[str]] = {name: set() for name in kinds}
    for first, second in template.bonds:
        if first in kinds and second in kinds:
            beside[first].add(second)
            beside[second].add(first)
    return kinds, beside


def _matched(mine: _Graph, its: _Graph) -> dict[str, str] | None:
    """Name in the molecule of each heavy atom of a template; None if they differ, or may. Backtracking."""
    (kind, beside), (its_kind, its_beside) = mine, its
    if sorted(kind.values()) != sorted(its_kind.values()):
        return None
    order = _outward(its_beside)
    called: dict[str, str] = {}
    tried: list[list[str]] = []
    left = _MOST_TRIED
    while len(called) < len(order):
        name = order[len(called)]
        if len(tried) == len(called):
            anchor = next((called[other] for other in order[: len(called)] if other in its_beside[name]), "")
            free = (beside[anchor] if anchor else kind.keys()) - {*called.values()}
            tried.append(sorted(free, reverse=True))
        while tried[-1]:
            left -= 1
            if not left:
                return None
            mine_name = tried[-1].pop()
            bonded = {called[other] for other in its_beside[name] if other in called}
            if kind[mine_name] == its_kind[name] and bonded == beside[mine_name] & {*called.values()}:
                called[name] = mine_name
                break
        else:
            tried.pop()
            if not called:
                return None
            called.popitem()
    return called


_MOST_TRIED = 100_000
"""Pairs of atoms: molecules need some hundreds, but of like pieces the ways to pair them have no end."""


def _outward(beside: Mapping[str, set[str]]) -> Sequence[str]:
    """Atoms in an order in which each is bonded to one before it, where the molecule is in one piece."""
    order: list[str] = []
    for start in beside:
        ahead = [] if start in order else [start]
        while ahead:
            name = ahead.pop()
            if name not in order:
                order.append(name)
                ahead += sorted(beside[name])
    return order


def _renamed(template: Template, called: Mapping[str, str], seen: Template, name: str) -> Template:
    """Template under the molecule's names; hydrogens that the file lacks keep the template's, if free."""
    names, used = dict(called), {*seen.element}
    for parent, hydrogens in template.hydrogens.items():
        there = list(seen.hydrogens.get(called[parent], ()))
        for hydrogen in hydrogens:
            new = there.pop(0) if there else hydrogen
            number = 1
            while not new or (new in used and new not in seen.hydrogens.get(called[parent], ())):
                new, number = f"H{number}", number + 1
            used.add(new)
            names[hydrogen] = new
    return Template(
        name,
        {names[a]: element for a, element in template.element.items()},
        {names[a]: charge for a, charge in template.charge.items()},
        tuple((names[a], names[b]) for a, b in template.bonds),
        {},
        is_users=True,
    )
