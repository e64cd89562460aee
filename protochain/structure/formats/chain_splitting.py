"""Chains, residues and atoms that share their ids in a file: different ones, or parts of one."""

from collections import Counter
from collections.abc import Container, Iterator, Sequence
from itertools import chain as chained
from itertools import count, product
from string import ascii_lowercase, ascii_uppercase, digits

import gemmi
import numpy as np
from scipy.spatial import KDTree

from protochain.core.errors import Argument, StructureError
from protochain.structure.molecule.repairs import Kind, Repair
from protochain.structure.molecule.residues import BLANK, Residue

_NOT_BONDED = 2.0
"""Angstrom: copies of a residue are different ones if no atom lies this near to its namesake."""
_SAME_PLACE = 0.5
"""Angstrom: namesakes nearer than this are one atom, given more than once."""

_UPON, _SHARE = 1.0, 0.5
"""Angstrom: a chain lies upon another if this share of its C-alphas is this near to C-alphas of that one."""
_CROWD, _CROWDED = 4.0, (200_000, 20)
"""Angstrom; pairs of heavy atoms this near that any file may have, and more per atom. Well packed, an
atom has six. What is looked at later, as overlaps and who hides whom, grows with the square of crowds."""
_IDS = ascii_uppercase + ascii_lowercase + digits


def chain_names(used: Container[str]) -> Iterator[str]:
    """Yield the chain ids that are free: of one character, then of two."""
    ids = chained(_IDS, map("".join, product(_IDS, repeat=2)))
    return (each for each in ids if each not in used)


def separate_chains(structure: gemmi.Structure) -> list[Repair]:
    """Give chains whose ids and numbers are those of a chain before them ids of their own."""
    renamed = []
    for model in structure:
        _split_where_numbers_begin_again(model)
        used: dict[str, set[str]] = {}
        for part in model:
            numbers = {str(residue.seqid) for residue in part if _is_amino(residue)}
            if numbers & used.get(part.name, set()):
                names = {chain.name for chain in model}
                name = next((each for each in _IDS if each not in names), part.name)
                called = {"before": part.name.strip() or BLANK, "after": name}
                renamed.append(Repair(Kind.CHAIN_RENAMED, called))
                part.name = name
            used.setdefault(part.name, set()).update(numbers)
    return list(dict.fromkeys(renamed))  # Each model may have them.


def _split_where_numbers_begin_again(model: gemmi.Model) -> None:
    """Split chains in which an amino acid has the number of one before it, unless as states."""
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
        rests = []
        for start in reversed(starts):
            rests.append(gemmi.Chain(chain.name))
            for residue in chain[start:]:
                rests[-1].add_residue(residue)
            for i in reversed(range(start, len(chain))):
                del chain[i]
        for rest in rests:  # After all: it moves the chains of the model in memory.
            model.add_chain(rest, k + 1)


def join_residues(structure: gemmi.Structure) -> None:
    """Put together what a file has of one residue in several places of a chain; changed in place."""
    for model in structure:
        first: dict[tuple[object, ...], gemmi.Residue] = {}
        joined = []
        for chain, i in [(each, i) for each in model for i in range(len(each))]:
            residue, number = chain[i], chain[i].seqid
            its = first.setdefault((chain.name, number.num, number.icode, residue.name), residue)
            if its is not residue and _are_parts(its, residue):
                for atom in residue:
                    its.add_atom(atom)
                joined.append((chain, i))
        for chain, i in reversed(joined):
            del chain[i]
    structure.remove_empty_chains()


def _are_parts(one: gemmi.Residue, other: gemmi.Residue) -> bool:
    """Whether they share no atom, or one has no backbone and the shared ones are in one place."""
    there = {atom.name: atom.pos for atom in one}
    shared = [there[atom.name].dist(atom.pos) for atom in other if atom.name in there]
    return not shared or (_is_amino(one) != _is_amino(other) and max(shared) < _SAME_PLACE)


def separate_caps(structure: gemmi.Structure) -> None:
    """Make residues of caps that CHARMM has within the first and last of a chain; changed in place."""
    for chain in (chain for model in structure for chain in model):
        for i in reversed(range(len(chain))):
            for cap, (step, names) in _PATCHES.items():
                there = {atom.name: atom for atom in chain[i]}
                at, end = ("N", "CY") if step < 0 else ("C", "NT")
                if not {*names, "N", "CA", "C"} <= there.keys():
                    continue
                if there[at].pos.dist(there[end].pos) > _NOT_BONDED:
                    continue
                made = gemmi.Residue()
                made.name, made.subchain = cap, chain[i].subchain
                made.seqid = gemmi.SeqId((chain[i].seqid.num or 0) + step, " ")
                for k in reversed(range(len(chain[i]))):
                    atom = chain[i][k]
                    if atom.name in names or atom.name.startswith(_HYDROGENS[cap]):
                        made.add_atom(atom, 0)
                        made[0].name = names.get(atom.name, atom.name)
                        del chain[i][k]
                chain.add_residue(made, i + max(step, 0))


_PATCHES = {
    "NME": (1, {"NT": "N", "CAT": "CH3"}),
    "NH2": (1, {"NT": "N"}),
    "ACE": (-1, {"CAY": "CH3", "CY": "C", "OY": "O"}),
}
_HYDROGENS = {"ACE": ("HY",), "NME": ("HT", "HNT"), "NH2": ("HT",)}
"""Caps of CHARMM (patches ACE, CT3 and CT2): number after that of their residue, heavy atoms, hydrogens."""


def refuse_copies(chains: Sequence[gemmi.Chain], source: str) -> None:
    """Refuse chains that lie upon others, as models that no MODEL record separates."""
    alphas = [(k, r.get_ca()) for k, chain in enumerate(chains) for r in chain if r.get_ca() is not None]
    owner, x = [k for k, _ in alphas], [alpha.pos.tolist() for _, alpha in alphas]
    close = KDTree(x).query_pairs(_UPON, output_type="ndarray") if x else np.empty((0, 2), dtype=int)
    both = Counter(tuple(sorted((owner[i], owner[j]))) for i, j in close.tolist() if owner[i] != owner[j])
    size = Counter(owner)
    for (first, second), near in both.items():
        if near >= _SHARE * min(size[first], size[second]):
            name, other = (chains[k].name or BLANK for k in (second, first))
            one = (", or take one by ", Argument("chains", other)) if other != BLANK else ()
            remedy = "; give them as models (MODEL, ENDMDL)"
            raise StructureError(f"{source}: chain {name} lies upon chain {other}{remedy}", *one)


def refuse_crowds(atoms: Sequence[gemmi.Atom], source: str) -> None:
    """Refuse so many atoms upon one another that time and memory would no longer go with their number."""
    heavy = [atom.pos.tolist() for atom in atoms if not atom.is_hydrogen()]
    tree = KDTree(np.reshape(heavy, (-1, 3)))
    pairs = (int(tree.count_neighbors(tree, _CROWD)) - tree.n) // 2
    least, more = _CROWDED
    if pairs > least + more * tree.n:
        raise StructureError(
            f"{source}: its atoms lie upon one another: {pairs} pairs of heavy atoms are nearer than "
            f"{_CROWD:g} angstrom, where some {6 * tree.n} are usual; give fewer chains or molecules, or "
            "correct the positions"
        )


def _is_amino(residue: gemmi.Residue) -> bool:
    """Whether it has a backbone; a lone atom called CA may be of anything."""
    return {"N", "CA", "C"} <= {atom.name for atom in residue}


def separate_molecules(structure: gemmi.Structure, source: str) -> list[Repair]:
    """Split molecules that share number and name, and number namesakes in one; alternates come later."""
    split = numbered = 0
    for model in structure:
        for chain in model:
            for i in reversed(range(len(chain))):
                residue = chain[i]
                if len({atom.name for atom in residue}) == len(residue):
                    continue
                copies = _copies(residue)
                nearest = _nearest(copies)
                is_amino = _is_amino(residue)
                if nearest > _NOT_BONDED and all(each.keys() == copies[0].keys() for each in copies):
                    if is_amino:
                        where = Residue(chain.name.strip(), str(residue.seqid).strip(), residue.name)
                        raise StructureError(
                            f"{source}: {where} is there {len(copies)} times, {nearest:.1f} angstrom apart; "
                            "give each residue a number of its own"
                        )
                    split += len(copies) - 1
                    _split(chain, i, copies)
                elif nearest > _SAME_PLACE and not is_amino:
                    numbered += 1
                    _number(residue, copies)
    done = {Kind.MOLECULES_RENUMBERED: split, Kind.ATOMS_NUMBERED: numbered}
    return [Repair(kind, {"count": count}) for kind, count in done.items() if count]


def _copies(residue: gemmi.Residue) -> list[dict[str, gemmi.Atom]]:
    """Atoms by name: those that come first, those that come again ...; alternate locations come once."""
    copies: list[dict[str, gemmi.Atom]] = [{}]
    there = Counter[str]()
    for atom in residue:
        name = atom.name
        if not (atom.has_altloc() and there[name]):
            copies += [{}] if there[name] == len(copies) else []
            copies[there[name]][name] = atom
            there[name] += 1
    return copies


def _nearest(copies: list[dict[str, gemmi.Atom]]) -> float:
    """Smallest distance of an atom to the first of its name."""
    return min((a.pos.dist(copies[0][n].pos) for each in copies[1:] for n, a in each.items()), default=0.0)


def _split(chain: gemmi.Chain, i: int, copies: list[dict[str, gemmi.Atom]]) -> None:
    made, empty = [], chain[i].clone()
    for k in reversed(range(len(empty))):
        del empty[k]
    for each in copies:
        copy = empty.clone()
        for atom in each.values():
            copy.add_atom(atom)
        made.append(copy)
    del chain[i]
    for k, copy in enumerate(made):
        chain.add_residue(copy, i + k)


def _number(residue: gemmi.Residue, copies: list[dict[str, gemmi.Atom]]) -> None:
    used = {atom.name for atom in residue}
    numbers = {name: count(2) for name in used}
    for each in copies[1:]:
        for name, atom in each.items():
            atom.name = next(new for k in numbers[name] if (new := f"{name}{k}") not in used)
            used.add(atom.name)
