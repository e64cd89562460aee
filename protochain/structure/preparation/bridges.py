"""Disulfide bonds."""

from collections.abc import Sequence

from scipy.spatial import KDTree

from protochain.core.checks import NO_BONDS, Bond
from protochain.core.errors import Argument, StructureError
from protochain.structure.molecule.member import Member
from protochain.structure.molecule.repairs import Kind
from protochain.structure.preparation.draft import Draft

DISULFIDE = 3.0
"""Angstrom: sulphurs nearer than this are bonded, as in OpenMM (a disulfide bond is 2.05)."""
Bridge = tuple[Member, Member]


def disulfides(draft: Draft, asked: Sequence[Bond] = ()) -> list[Bridge]:
    """Find the disulfide bonds: between sulphurs that are close, and those that are asked for."""
    cysteines = [member for member in draft.members if member.name == "CYS"]
    wanted = [bond for bond in asked if bond != NO_BONDS]
    found = _near(draft, cysteines)
    only = len(wanted) < len(asked)
    if only and found:
        in_order = sorted(found, key=lambda pair: cysteines.index(pair[0]))
        pairs = tuple(f"{_place(first)}-{_place(second)}" for first, second in in_order)
        draft.note(Kind.BRIDGES_DROPPED, pairs=pairs)
    found = [] if only else found
    for first, second in found:
        if not draft.states(first.address("SG"), second.address("SG")):
            draft.note(Kind.BRIDGE, first=first.residue, second=second.residue)
    for bond in wanted:
        bridge = _asked(draft, cysteines, found, bond)
        if bridge is not None:
            found.append(bridge)
    if not only:
        _report_ignored(draft, cysteines, found)
    return sorted(found, key=lambda pair: cysteines.index(pair[0]))


def _near(draft: Draft, cysteines: list[Member]) -> list[Bridge]:
    """Pair the sulphurs that are close, the nearest first."""
    # Two that hold one metal may be near each other; one bonded to a molecule outside it has no valence left.
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
    return found


def _report_ignored(draft: Draft, cysteines: list[Member], found: list[Bridge]) -> None:
    """Report bonds of the file that are too long."""
    at = {(m.chain_id, m.seqid, "SG"): m for m in cysteines if m.atom("SG") and not m.metals}
    used = [set(map(id, pair)) for pair in found]
    for first, second in [(at[a], at[b]) for a, b in draft.stated if a in at and b in at]:
        if {id(first), id(second)} not in used:
            draft.note(
                Kind.BRIDGE_IGNORED, first=first.residue, second=second.residue,
                length=_apart(first, second), remedy=Argument("disulfide"),
            )  # fmt: skip


def _asked(
    draft: Draft, cysteines: list[Member], found: Sequence[Bridge], pair: tuple[str, str]
) -> Bridge | None:
    """Return a bond that is asked for; None if it is found already."""
    at = {_place(member): member for member in cysteines}
    bond = f"{draft.source}: disulfide {pair[0]}-{pair[1]}"
    for name in pair:
        if name not in at:
            other = next((member for member in draft.members if _place(member) == name), None)
            what = f"{other} is no cysteine" if other else f"no cysteine {name}"
            raise StructureError(f"{bond}: {what}; its cysteines are {', '.join(at) or 'none'}")
    if pair[0] == pair[1]:
        raise StructureError(f"{bond}: one cysteine is no bond; give two")
    ends = {id(at[name]) for name in pair}
    if any({id(first), id(second)} == ends for first, second in found):
        return None
    for first, second in found:
        if {id(first), id(second)} & ends:
            raise StructureError(
                f"{bond}: {_place(first)} and {_place(second)} are bonded, and no cysteine has two bonds; "
                "leave one out, or drop the bonds that are found: ",
                Argument("disulfide", NO_BONDS),
            )
    held = next((name for name in pair if any(a.name == "SG" for a in at[name].links + at[name].metals)), "")
    if held:
        raise StructureError(
            f"{bond}: {held} is bonded to a molecule kept with the protein; leave one of them out"
        )
    first, second = (at[name] for name in pair)
    apart = _apart(first, second)
    kind = Kind.BRIDGE_FAR if apart >= DISULFIDE else Kind.BRIDGE_ASKED
    draft.note(kind, first=first.residue, second=second.residue, length=apart)
    return first, second


def _place(member: Member) -> str:
    return f"{member.chain_id}:{member.seqid}"


def _sulphur(member: Member) -> list[float]:
    sulphur = member.atom("SG")
    assert sulphur is not None
    return sulphur.pos.tolist()


def _apart(first: Member, second: Member) -> float:
    a, b = first.atom("SG"), second.atom("SG")
    return float(a.pos.dist(b.pos)) if a and b else float("inf")
