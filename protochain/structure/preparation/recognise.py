"""Recognition of ligands by their elements and bonds, because names of templates and atoms vary."""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from scipy.spatial import KDTree

from protochain.structure.molecule.member import Member
from protochain.structure.molecule.templates import Template

_BOND_SLACK, _BOND_SHORTEST = 0.4, 0.5
"""Angstrom: largest excess of a bond over the sum of the covalent radii, and shortest bond."""
_MOST_TRIED = 100_000
"""Pairs of atoms: molecules need some hundreds, but equal pieces can be paired in too many ways."""
_Graph = tuple[dict[str, tuple[str, int]], dict[str, set[str]]]
"""Element and number of hydrogens of each heavy atom, by name, and its heavy neighbours."""


def template_by_element(member: Member) -> Template:
    """Return the template of a molecule in the file: elements and charges, with bonds by distance."""
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
    heavy = member.heavy
    for atom in (a for a in atoms if a.is_hydrogen()):
        bonds.append((min(heavy, key=lambda a: a.pos.dist(atom.pos)).name, atom.name))
    elements = {a.name: a.element.name for a in atoms}
    return Template(member.name, elements, {a.name: float(a.charge) for a in atoms}, tuple(bonds))


def find_template(member: Member, molecule: Template, templates: Iterable[Template]) -> Template | None:
    """Find the template with the same bonds of heavy atoms as a molecule."""
    candidates = list(templates)
    for with_hydrogens in (True, False) if molecule.hydrogens else (False,):
        graph = _graph(molecule, with_hydrogens)
        for template in candidates:
            names = _match_atoms(graph, _graph(template, with_hydrogens))
            if names is not None:
                return _rename_template(template, names, molecule, member.name)
    return None


def _graph(template: Template, with_hydrogens: bool) -> _Graph:
    count = template.hydrogens if with_hydrogens else {}
    kinds = {name: (template.element[name], len(count.get(name, ()))) for name in template.heavy}
    bonds: dict[str, set[str]] = {name: set() for name in kinds}
    for first, second in template.bonds:
        if first in kinds and second in kinds:
            bonds[first].add(second)
            bonds[second].add(first)
    return kinds, bonds


def _match_atoms(molecule: _Graph, template: _Graph) -> dict[str, str] | None:
    """Return the molecule's name of each heavy atom of a template, or None without a match. Backtracking."""
    (kinds, bonds), (template_kinds, template_bonds) = molecule, template
    if sorted(kinds.values()) != sorted(template_kinds.values()):
        return None
    order = _outward(template_bonds)
    pairs: dict[str, str] = {}
    tried: list[list[str]] = []
    left = _MOST_TRIED
    while len(pairs) < len(order):
        name = order[len(pairs)]
        if len(tried) == len(pairs):
            anchor = next((pairs[n] for n in order[: len(pairs)] if n in template_bonds[name]), "")
            free = (bonds[anchor] if anchor else kinds.keys()) - {*pairs.values()}
            tried.append(sorted(free, reverse=True))
        while tried[-1]:
            left -= 1
            if not left:
                return None
            atom = tried[-1].pop()
            bonded = {pairs[n] for n in template_bonds[name] if n in pairs}
            if kinds[atom] == template_kinds[name] and bonded == bonds[atom] & {*pairs.values()}:
                pairs[name] = atom
                break
        else:
            tried.pop()
            if not pairs:
                return None
            pairs.popitem()
    return pairs


def _outward(bonds: Mapping[str, set[str]]) -> Sequence[str]:
    """Return the atoms in an order in which each is bonded to an earlier one, if any path connects them."""
    order: list[str] = []
    for start in bonds:
        stack = [] if start in order else [start]
        while stack:
            name = stack.pop()
            if name not in order:
                order.append(name)
                stack += sorted(bonds[name])
    return order


def _rename_template(template: Template, pairs: Mapping[str, str], molecule: Template, name: str) -> Template:
    """Return the template with the molecule's names. Missing hydrogens have the template's names, if free."""
    names, used = dict(pairs), {*molecule.element}
    for parent, hydrogens in template.hydrogens.items():
        free_names = list(molecule.hydrogens.get(pairs[parent], ()))
        for hydrogen in hydrogens:
            new = free_names.pop(0) if free_names else hydrogen
            number = 1
            while not new or (new in used and new not in molecule.hydrogens.get(pairs[parent], ())):
                new, number = f"H{number}", number + 1
            used.add(new)
            names[hydrogen] = new
    elements = {names[a]: element for a, element in template.element.items()}
    charges = {names[a]: charge for a, charge in template.charge.items()}
    bonds = tuple((names[a], names[b]) for a, b in template.bonds)
    return Template(name, elements, charges, bonds, is_users=True)
