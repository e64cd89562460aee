"""Disulfide bonds, and cross-links that the force fields do not cover."""

from collections.abc import Sequence

from scipy.spatial import KDTree

from protochain.errors import StructureError
from protochain.structure.draft import Draft, Member

DISULFIDE = 3.0
"""Angstrom: sulphurs nearer than this are bonded, as in OpenMM (a disulfide bond is 2.05)."""
_CROSSLINK = 1.7
"""Angstrom: a side-chain amine nearer than this to a side-chain carboxyl is bonded to it (1.33)."""
_AMINES = (("LYS", "NZ"), ("ORN", "NE"), ("DAB", "ND"))
_CARBOXYLS = (("ASP", "CG", ("OD1", "OD2")), ("GLU", "CD", ("OE1", "OE2")))
"""With the oxygens, of which an amide bond takes the place of one: where both are there, two side chains of a
poor model overlap."""

Bridge = tuple[Member, Member]


def disulfides(draft: Draft, asked: Sequence[tuple[str, str]] | None = None) -> list[Bridge]:
    """Find the disulfide bonds.

    Parameters
    ----------
    draft : Draft
        Its repairs receive every bond that the file does not state.
    asked : sequence of pairs of str, optional
        Exactly these bonds, as ``("A:3", "A:40")``; by default, between sulphurs that are close.

    Raises
    ------
    StructureError
        If a requested cysteine does not exist or occurs twice.
    """
    cysteines = [member for part in draft.parts for member in part.members if member.name == "CYS"]
    if asked is not None:
        return _asked(draft, cysteines, asked)
    # Two that hold one metal may be near each other; one bonded to a molecule beside it has no valence left.
    sulphurs = [
        member
        for member in cysteines
        if member.atom("SG") and not member.metals and all(a.name != "SG" for a in member.links)
    ]
    x = [_sulphur(member) for member in sulphurs]
    near = KDTree(x).query_pairs(DISULFIDE) if x else set()
    distances = sorted((_apart(sulphurs[i], sulphurs[j]), i, j) for i, j in near)
    bonded: set[int] = set()
    found: list[Bridge] = []
    for _, i, j in distances:
        if not bonded & {i, j}:
            bonded |= {i, j}
            found.append((sulphurs[i], sulphurs[j]))
            if not _is_stated(draft, *found[-1]):
                draft.repairs.append(f"disulfide bond between {sulphurs[i]} and {sulphurs[j]}")
    at = {(member.chain_id, member.seqid, "SG"): member for member in sulphurs}
    taken = [set(map(id, pair)) for pair in found]
    for first, second in [(at[a], at[b]) for a, b in draft.stated if a in at and b in at]:
        if {id(first), id(second)} not in taken:
            draft.repairs.append(
                f"disulfide bond of the file between {first} and {second} ignored: it is "
                f"{_apart(first, second):.1f} angstrom long; request it as disulfide if it is real"
            )
    return sorted(found, key=lambda pair: cysteines.index(pair[0]))


def _asked(draft: Draft, cysteines: list[Member], asked: Sequence[tuple[str, str]]) -> list[Bridge]:
    at = {f"{member.chain_id}:{member.seqid}": member for member in cysteines}
    taken: set[str] = set()
    found = []
    for pair in asked:
        for name in pair:
            if name not in at:
                raise StructureError(
                    f"{draft.source}: disulfide {pair[0]}-{pair[1]}: no cysteine {name}; "
                    f"its cysteines are {', '.join(at) or 'none'}"
                )
            if name in taken:
                raise StructureError(f"{draft.source}: disulfide {pair[0]}-{pair[1]}: {name} is bonded twice")
            taken.add(name)
        found.append((at[pair[0]], at[pair[1]]))
        draft.repairs.append(f"disulfide bond between {found[-1][0]} and {found[-1][1]}, as requested")
    return found


def refuse_crosslinks(draft: Draft) -> None:
    """Refuse side chains joined by amide bonds, for which the force fields have no parameters.

    Raises
    ------
    StructureError
        Naming both residues.
    """
    amines = [
        (m, atom) for m in draft.members for name, n in _AMINES if m.name == name and (atom := m.atom(n))
    ]
    carboxyls = [
        (m, atom)
        for m in draft.members
        for name, c, oxygens in _CARBOXYLS
        if m.name == name and (atom := m.atom(c)) and not all(map(m.atom, oxygens))
    ]
    if not amines or not carboxyls:
        return
    near = KDTree([atom.pos.tolist() for _, atom in carboxyls])
    for member, atom in amines:
        for j in near.query_ball_point(atom.pos.tolist(), _CROSSLINK):
            raise StructureError(
                f"{draft.source}: {member} and {carboxyls[j][0]} are joined by an amide bond "
                f"({atom.name}-{carboxyls[j][1].name}), which the force fields lack; remove that bond"
            )


def _sulphur(member: Member) -> list[float]:
    sulphur = member.atom("SG")
    assert sulphur is not None
    return sulphur.pos.tolist()


def _apart(first: Member, second: Member) -> float:
    a, b = first.atom("SG"), second.atom("SG")
    return float(a.pos.dist(b.pos)) if a and b else float("inf")


def _is_stated(draft: Draft, first: Member, second: Member) -> bool:
    return draft.states(*((member.chain_id, member.seqid, "SG") for member in (first, second)))
