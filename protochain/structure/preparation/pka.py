"""pKa of side chains in their surroundings, by PROPKA.

Olsson, Soendergaard, Rostkowski, Jensen, J. Chem. Theory Comput. 7:525 (2011), and Soendergaard, Olsson,
Rostkowski, Jensen, J. Chem. Theory Comput. 7:2284 (2011).
"""

import logging
from collections.abc import Mapping, Sequence
from io import StringIO
from string import ascii_letters, digits

import gemmi

from protochain.core.errors import StructureError
from protochain.core.optional_libraries import library
from protochain.structure.molecule.member import Member
from protochain.structure.preparation.structure_draft import Draft

_PER_CHAIN = 9000
"""Residues per chain of the PDB text, and the names of its chains."""
_CHAINS = ascii_letters + digits
_GROUPS = {"ASP", "GLU", "HIS", "CYS", "LYS"}


def compute_pka(draft: Draft) -> Mapping[int, float]:
    """Compute the pKa of a protein's acids and bases, in the presence of the hetero molecules."""
    run = library("propka.run", "pka")
    members = draft.members
    if len(members) > _PER_CHAIN * len(_CHAINS):
        raise StructureError(f"{draft.source}: ph auto: {len(members)} residues are too many for PROPKA")
    logging.getLogger("propka").setLevel(logging.ERROR)
    try:
        result = run.single("x.pdb", ["-q"], StringIO(_as_pdb(draft, members)), write_pka=False)
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        raise StructureError(f"{draft.source}: PROPKA fails ({error}); give ph a number") from None
    groups = [group for group in result.conformations["AVR"].groups if group.residue_type in _GROUPS]
    places = {_chain_and_number(k): id(member) for k, member in enumerate(members)}
    return {places[g.atom.chain_id, g.atom.res_num]: float(g.pka_value) for g in groups}


def _chain_and_number(k: int) -> tuple[str, int]:
    """Return the chain and number of a residue in the input of PROPKA."""
    return _CHAINS[k // _PER_CHAIN], k % _PER_CHAIN + 1


def _as_pdb(draft: Draft, members: Sequence[Member]) -> str:
    """Return the heavy atoms as PDB records, with a TER after each piece of a chain."""
    number = {id(member): _chain_and_number(k) for k, member in enumerate(members)}
    lines = list[str]()
    for part in draft.parts:
        record = "HETATM" if part.obstacle else "ATOM"
        for member in part.members:
            chain, n = number[id(member)]
            for a in member.atoms:
                if not a.is_hydrogen():
                    place = "".join(f"{coordinate:8.3f}" for coordinate in a.pos.tolist())
                    lines.append(
                        f"{record:6}{1:5d} {_aligned_name(a):4} {member.name[:3]:>3} {chain}{n:4d}    {place}"
                        f"{1.0:6.2f}{0.0:6.2f}          {a.element.name.upper():>2}"
                    )
        lines.append("TER")
    return "\n".join([*lines, "END", ""])


def _aligned_name(a: gemmi.Atom) -> str:
    """Return the name of an atom, aligned by its element."""
    return a.name[:4] if len(a.element.name) > 1 or len(a.name) > 3 else f" {a.name}"
