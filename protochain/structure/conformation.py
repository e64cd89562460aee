"""Choice among alternate locations: one conformation of each residue."""

from dataclasses import dataclass
from math import isfinite

import gemmi
import numpy as np

from protochain.core.errors import StructureError


@dataclass(frozen=True, eq=False)
class Conformation:
    """Chosen conformation of a residue.

    Parameters
    ----------
    residue : gemmi.Residue
        Without alternate locations.
    altloc : str
    occupancy : float
        Mean over the atoms of the chosen location.
    others : list of str
        Alternates left out: ``SER B``.
    repeated : list of str
        Names of atoms that occurred more than once.
    """

    residue: gemmi.Residue
    altloc: str
    occupancy: float
    others: list[str]
    repeated: list[str]


def same_place(chain: gemmi.Chain) -> list[list[gemmi.Residue]]:
    """Group copies of residues that share a number, the alternatives of microheterogeneity."""
    groups: list[list[gemmi.Residue]] = []
    for residue in map(gemmi.Residue.clone, chain):
        if groups and groups[-1][0].seqid == residue.seqid and residue[0].has_altloc():
            groups[-1].append(residue)
        else:
            groups.append([residue])
    return groups


def check_altloc(model: gemmi.Model, asked: str, source: str) -> None:
    """Refuse an alternate location that no atom has.

    Raises
    ------
    StructureError
        Naming those that there are.
    """
    found = {cra.atom.altloc for cra in model.all() if cra.atom.has_altloc()}
    if asked and asked not in found:
        there = f"its atoms have {', '.join(sorted(found))}" if found else "no atom of it has one"
        raise StructureError(f"{source}: has no alternate location {asked!r}: {there}; change or omit altloc")


def without_nan(model: gemmi.Model) -> int:
    """Put 0 for occupancies and B factors that are no numbers, and return of how many atoms.

    Parameters
    ----------
    model : gemmi.Model
        Changed in place.
    """
    n = 0
    for place in model.all():
        atom = place.atom
        if not (isfinite(atom.occ) and isfinite(atom.b_iso)):
            n += 1
            atom.occ, atom.b_iso = (value if isfinite(value) else 0.0 for value in (atom.occ, atom.b_iso))
    return n


def without_deuterium(model: gemmi.Model) -> int:
    """Make hydrogens of the deuterium atoms of a model, by element and name, and return how many there are.

    Parameters
    ----------
    model : gemmi.Model
        Changed in place.
    """
    heavy = [place for place in model.all() if place.atom.element.name == "D"]
    for place in heavy:
        place.atom.element = gemmi.Element("H")
        name = place.atom.name.replace("D", "H", 1)
        namesakes = [atom for atom in place.residue if atom.name == name]
        # Of a hydrogen and a deuterium on one place each is an alternate location.
        if all(each.has_altloc() and each.altloc != place.atom.altloc for each in namesakes):
            place.atom.name = name
    return len(heavy)


def likeliest(group: list[gemmi.Residue], asked: str) -> Conformation:
    """Choose the alternate that is asked for, or that of highest occupancy (the first of equals)."""
    weights: dict[tuple[int, str], list[float]] = {}
    for i, residue in enumerate(group):
        for atom in residue:
            if atom.has_altloc():
                weights.setdefault((i, atom.altloc), []).append(atom.occ)
    wanted = [place for place in weights if place[1] == asked]
    best, altloc = max(wanted or weights, key=lambda place: float(np.mean(weights[place])), default=(0, ""))
    chosen = group[best]
    _complete_backbone(chosen, group)
    # Atoms that only another location has are kept; of two with one name, the first.
    ranked = sorted(range(len(chosen)), key=lambda i: chosen[i].altloc not in (altloc, "\0"))
    kept: dict[str, int] = {}
    for i in ranked:
        kept.setdefault(chosen[i].name, i)
    repeated = sorted({chosen[i].name for i in set(ranked) - set(kept.values())})
    # Hydrogens of another location are dropped: their parent atom lies elsewhere there.
    of_others = [i for i in ranked if chosen[i].is_hydrogen() and chosen[i].altloc not in (altloc, "\0")]
    for i in sorted({*(set(ranked) - set(kept.values())), *of_others}, reverse=True):
        del chosen[i]
    for atom in chosen:
        atom.altloc = "\0"
    others = sorted({f"{group[i].name} {a}" for i, a in weights} - {f"{chosen.name} {altloc}"})
    occupancy = float(np.mean(weights.get((best, altloc), [1.0])))
    return Conformation(chosen, altloc, occupancy, others, repeated)


def _complete_backbone(chosen: gemmi.Residue, group: list[gemmi.Residue]) -> None:
    """Add shared backbone atoms that the file gives with one of the alternatives only."""
    for residue in group:
        present = {atom.name for atom in chosen}
        for atom in residue:
            if atom.name in ("N", "CA", "C", "O") and atom.name not in present and residue is not chosen:
                chosen.add_atom(atom)
