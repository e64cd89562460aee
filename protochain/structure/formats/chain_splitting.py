"""Chains, residues and atoms with duplicate ids: separation of different ones, and joining of parts."""

from collections import Counter
from collections.abc import Container, Iterator, Sequence
from itertools import chain as chained
from itertools import count, product
from string import ascii_lowercase, ascii_uppercase, digits

import gemmi
import numpy as np
from scipy.spatial import KDTree

from protochain.core.errors import Argument, StructureError
from protochain.structure.molecule.member import residue_in_file
from protochain.structure.molecule.repairs import Kind, Repair
from protochain.structure.molecule.residues import BLANK

_NOT_BONDED = 2.0
"""Angstrom. Copies of a residue are different residues if all atoms are further from their namesakes."""
_SAME_PLACE = 0.5  # Angstrom. Namesakes closer than this are duplicates of one atom.

_OVERLAP, _SHARE = 1.0, 0.5
"""Angstrom, fraction. Chains overlap if this fraction of C-alphas of one is this close to the other."""
_CROWD, _CROWDED = 4.0, (200_000, 20)
"""Angstrom, and the permitted number of heavy-atom pairs this close: a constant, and a number per atom. A
well packed atom has six. The cost of later steps grows quadratically with local density."""
_IDS = ascii_uppercase + ascii_lowercase + digits
_PATCHES = {
    "NME": (1, {"NT": "N", "CAT": "CH3"}),
    "NH2": (1, {"NT": "N"}),
    "ACE": (-1, {"CAY": "CH3", "CY": "C", "OY": "O"}),
}
_HYDROGENS = {"ACE": ("HY",), "NME": ("HT", "HNT"), "NH2": ("HT",)}
"""Caps of CHARMM (patches ACE, CT3, CT2): offset of the residue number, heavy atoms, hydrogens."""


def chain_names(used: Container[str]) -> Iterator[str]:
    """Yield unused chain ids of one character, then of two."""
    ids = chained(_IDS, map("".join, product(_IDS, repeat=2)))
    return (name for name in ids if name not in used)


def separate_chains(structure: gemmi.Structure) -> list[Repair]:
    """Rename chains that repeat the id and residue numbers of a previous chain."""
    renamed = []
    for model in structure:
        _split_at_renumbering(model)
        used: dict[str, set[str]] = {}
        for part in model:
            numbers = {str(residue.seqid) for residue in part if _is_amino(residue)}
            if numbers & used.get(part.name, set()):
                names = {chain.name for chain in model}
                name = next((letter for letter in _IDS if letter not in names), part.name)
                facts = {"before": part.name.strip() or BLANK, "after": name}
                renamed.append(Repair(Kind.CHAIN_RENAMED, facts))
                part.name = name
            used.setdefault(part.name, set()).update(numbers)
    return list(dict.fromkeys(renamed))  # Each model may have them.


def _split_at_renumbering(model: gemmi.Model) -> None:
    """Split chains in which a residue number of an amino acid is repeated, except for alternate locations."""
    for k in reversed(range(len(model))):
        chain, seen, starts = model[k], set[str](), list[int]()
        for i, residue in enumerate(chain):
            number = str(residue.seqid)
            if not _is_amino(residue) or any(atom.has_altloc() for atom in residue):
                continue
            if number in seen and number != str(chain[i - 1].seqid):
                starts.append(i)
                seen.clear()
            seen.add(number)
        tails = []
        for start in reversed(starts):
            tails.append(gemmi.Chain(chain.name))
            for residue in chain[start:]:
                tails[-1].add_residue(residue)
            del chain[start:]
        for tail in tails:  # At the end, because adding moves the chains of the model in memory.
            model.add_chain(tail, k + 1)


def join_residues(structure: gemmi.Structure) -> None:
    """Join the parts of residues that are separated within a chain. Changes the structure in place."""
    for model in structure:
        first: dict[tuple[object, ...], gemmi.Residue] = {}
        joined = []
        for chain, i in [(c, i) for c in model for i in range(len(c))]:
            residue, number = chain[i], chain[i].seqid
            first_part = first.setdefault((chain.name, number.num, number.icode, residue.name), residue)
            if first_part is not residue and _are_parts(first_part, residue):
                for atom in residue:
                    first_part.add_atom(atom)
                joined.append((chain, i))
        for chain, i in reversed(joined):
            del chain[i]
    structure.remove_empty_chains()


def _are_parts(first: gemmi.Residue, second: gemmi.Residue) -> bool:
    """Return whether two residues share no atom, or only one has a backbone and shared atoms coincide."""
    positions = {atom.name: atom.pos for atom in first}
    shared = [positions[atom.name].dist(atom.pos) for atom in second if atom.name in positions]
    return not shared or (_is_amino(first) != _is_amino(second) and max(shared) < _SAME_PLACE)


def separate_caps(structure: gemmi.Structure) -> None:
    """Separate CHARMM's terminal caps from the first and last residue of a chain, in place."""
    for chain in (chain for model in structure for chain in model):
        for i in reversed(range(len(chain))):
            for cap, (step, names) in _PATCHES.items():
                atoms = {atom.name: atom for atom in chain[i]}
                at, end = ("N", "CY") if step < 0 else ("C", "NT")
                if not {*names, "N", "CA", "C"} <= atoms.keys():
                    continue
                if atoms[at].pos.dist(atoms[end].pos) > _NOT_BONDED:
                    continue
                new = gemmi.Residue()
                new.name, new.subchain = cap, chain[i].subchain
                new.seqid = gemmi.SeqId((chain[i].seqid.num or 0) + step, " ")
                for k in reversed(range(len(chain[i]))):
                    atom = chain[i][k]
                    if atom.name in names or atom.name.startswith(_HYDROGENS[cap]):
                        new.add_atom(atom, 0)
                        new[0].name = names.get(atom.name, atom.name)
                        del chain[i][k]
                chain.add_residue(new, i + max(step, 0))


def refuse_copies(chains: Sequence[gemmi.Chain], source: str) -> None:
    """Refuse chains that overlap others, such as models without MODEL records."""
    alphas = [(k, r.get_ca()) for k, chain in enumerate(chains) for r in chain if r.get_ca() is not None]
    owner, x = [k for k, _ in alphas], [alpha.pos.tolist() for _, alpha in alphas]
    close = KDTree(x).query_pairs(_OVERLAP, output_type="ndarray") if x else np.empty((0, 2), dtype=int)
    overlaps = Counter(tuple(sorted((owner[i], owner[j]))) for i, j in close.tolist() if owner[i] != owner[j])
    size = Counter(owner)
    for (first, second), near in overlaps.items():
        if near >= _SHARE * min(size[first], size[second]):
            name, first_name = (chains[k].name or BLANK for k in (second, first))
            option = (", or take one by ", Argument("chains", first_name)) if first_name != BLANK else ()
            remedy = "; give them as models (MODEL, ENDMDL)"
            raise StructureError(f"{source}: chain {name} lies upon chain {first_name}{remedy}", *option)


def refuse_crowds(atoms: Sequence[gemmi.Atom], source: str) -> None:
    """Refuse overlapping atoms if time and memory would no longer be proportional to their number."""
    heavy = [atom.pos.tolist() for atom in atoms if not atom.is_hydrogen()]
    tree = KDTree(np.reshape(heavy, (-1, 3)))
    pairs = (int(tree.count_neighbors(tree, _CROWD)) - tree.n) // 2
    minimum, per_atom = _CROWDED
    if pairs > minimum + per_atom * tree.n:
        raise StructureError(
            f"{source}: its atoms lie upon one another: {pairs} pairs of heavy atoms are nearer than "
            f"{_CROWD:g} angstrom, where some {6 * tree.n} are usual; give fewer chains or molecules, or "
            "correct the positions"
        )


def _is_amino(residue: gemmi.Residue) -> bool:
    """Return whether a residue has a backbone. CA alone may be calcium."""
    return {"N", "CA", "C"} <= {atom.name for atom in residue}


def separate_molecules(structure: gemmi.Structure, source: str) -> list[Repair]:
    """Split molecules that share number and name, and number duplicate atom names within a molecule."""
    split = numbered = 0
    for model in structure:
        for chain in model:
            for i in reversed(range(len(chain))):
                residue = chain[i]
                if len({atom.name for atom in residue}) == len(residue):
                    continue
                copies = _copies(residue)
                # The smallest distance between an atom and its first namesake.
                distances = (a.pos.dist(copies[0][n].pos) for copy in copies[1:] for n, a in copy.items())
                nearest = min(distances, default=0.0)
                is_amino = _is_amino(residue)
                if nearest > _NOT_BONDED and all(copy.keys() == copies[0].keys() for copy in copies):
                    if is_amino:
                        where = residue_in_file(chain.name, residue)
                        raise StructureError(
                            f"{source}: {where} is there {len(copies)} times, {nearest:.1f} angstrom apart; "
                            "give each residue a number of its own"
                        )
                    split += len(copies) - 1
                    _split(chain, i, copies)
                elif nearest > _SAME_PLACE and not is_amino:
                    numbered += 1
                    _number(residue, copies)
    counts = {Kind.MOLECULES_RENUMBERED: split, Kind.ATOMS_NUMBERED: numbered}
    return [Repair(kind, {"count": count}) for kind, count in counts.items() if count]


def _copies(residue: gemmi.Residue) -> list[dict[str, gemmi.Atom]]:
    """Return copies of a residue as atoms by name: first occurrences, second ... Altlocs count once."""
    copies: list[dict[str, gemmi.Atom]] = [{}]
    n_seen = Counter[str]()
    for atom in residue:
        name = atom.name
        if not (atom.has_altloc() and n_seen[name]):
            copies += [{}] if n_seen[name] == len(copies) else []
            copies[n_seen[name]][name] = atom
            n_seen[name] += 1
    return copies


def _split(chain: gemmi.Chain, i: int, copies: list[dict[str, gemmi.Atom]]) -> None:
    residues, empty = [], chain[i].clone()
    del empty[:]
    for atoms in copies:
        copy = empty.clone()
        for atom in atoms.values():
            copy.add_atom(atom)
        residues.append(copy)
    del chain[i]
    for k, copy in enumerate(residues):
        chain.add_residue(copy, i + k)


def _number(residue: gemmi.Residue, copies: list[dict[str, gemmi.Atom]]) -> None:
    used = {atom.name for atom in residue}
    numbers = {name: count(2) for name in used}
    for copy in copies[1:]:
        for name, atom in copy.items():
            atom.name = next(new for k in numbers[name] if (new := f"{name}{k}") not in used)
            used.add(atom.name)
