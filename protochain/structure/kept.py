"""Waters, ions and other molecules kept beside the protein as fixed obstacles."""

from collections.abc import Mapping, Sequence

from protochain import residues
from protochain.structure.draft import Draft, Member, Part
from protochain.structure.templates import Template

_PHOSPHATE_BREAK = 2.5
"""Angstrom: O3' and P further apart than this are not bonded (1.6)."""
_PHOSPHATE = ("P", "OP1", "OP2", "OP3", "O1P", "O2P", "O3P")


def is_wanted(member: Member, keep: Sequence[str], known: Mapping[str, Template]) -> bool:
    """Whether a non-protein residue is to be kept, by name or kind, and has a template."""
    kinds = {
        "water": member.name == "HOH",
        "ions": len(member.atoms) == 1 and member.name != "HOH",
        "nucleic": member.name in residues.NUCLEOTIDES,
        "all": True,
    }
    asked = member.name in keep or any(is_so and kind in keep for kind, is_so in kinds.items())
    return asked and member.name in known


def obstacles(draft: Draft, chain_id: str, members: Sequence[Member]) -> list[Part]:
    """Group residues into molecules: bonded nucleotides form a strand, all others stand alone."""
    parts: list[Part] = []
    for member in members:
        if parts and _is_bonded(parts[-1].members[-1], member):
            parts[-1].members.append(member)
        else:
            parts.append(Part(chain_id, [member], obstacle=True))
    for part in parts:
        first = part.members[0]
        gone = [atom.name for atom in first.atoms if atom.name in _PHOSPHATE]
        if first.name in residues.NUCLEOTIDES and gone:
            first.atoms = [atom for atom in first.atoms if atom.name not in gone]
            draft.repairs.append(f"{first}: 5' phosphate left out: the force fields do not have it")
    return parts


def _is_bonded(last: Member, first: Member) -> bool:
    end, start = last.atom("O3'"), first.atom("P")
    return bool(end and start and end.pos.dist(start.pos) < _PHOSPHATE_BREAK)
