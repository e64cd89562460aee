"""Modified residues as their standard parents."""

import gemmi

from protochain.structure.molecule.chirality import WELL_FORMED, chirality
from protochain.structure.molecule.member import Member
from protochain.structure.molecule.repairs import Kind, Reason, Repair
from protochain.structure.molecule.residues import name_in_file
from protochain.structure.molecule.templates import archive_parent, other_names
from protochain.structure.preparation.structure_draft import Changes, Draft, losses


def full_state(name: str) -> str:
    """Return the protonation state of an amino acid with all atoms of its other states."""
    return "HIP" if name == "HIS" else name


def convert_to_parent(draft: Draft, member: Member, reason: Reason) -> Changes:
    """Convert a modified residue of a chain to its standard parent."""
    residue, parent, original = member.residue, member.parent or archive_parent(member.name), member.name
    usual = draft.templates[full_state(parent)]
    expected = {*usual.element, *other_names(member.atoms, usual), "OXT", "H1", "H2", "H3", "H"}
    for name in set(usual.heavy) - {atom.name for atom in member.atoms}:
        # Selenium, or a sulphur of another name, becomes the parent's sulphur.
        chalcogens = [a for a in member.atoms if a.element.name in ("S", "Se") and a.name not in expected]
        if usual.element[name] == "S" and len(chalcogens) == 1:
            chalcogens[0].name, chalcogens[0].element = name, gemmi.Element("S")
    extra = [atom for atom in member.atoms if atom.name not in expected and not atom.is_hydrogen()]
    member.atoms = [
        atom for atom in member.atoms if atom.name in expected and not (extra and atom.is_hydrogen())
    ]
    member.name, member.state, member.source = parent, "", None
    removed = tuple(a.name for a in extra)
    lost = losses(member, extra, reason)
    if gemmi.find_tabulated_residue(original).kind not in (gemmi.ResidueKind.AA, gemmi.ResidueKind.AAD):
        # The table does not contain its configuration.
        member.is_d = chirality(member, least=WELL_FORMED) < 0
    if original == "MSE":
        yield Repair.of(Kind.SELENOMETHIONINE, lost, residue=residue)
    elif original != name_in_file(parent, member.is_d):
        truncated, complete = _TO_D if member.is_d else _TO_PARENT
        name = name_in_file(parent, member.is_d)
        yield Repair.of(truncated if removed else complete, lost, residue=residue, name=name, atoms=removed)
    elif removed or chirality(member) < 1:  # Other inversions are reported together.
        kind = Kind.MIRRORED_CUT if removed else Kind.MIRRORED
        yield Repair.of(kind, lost, residue=residue, atoms=removed)


_TO_D = Kind.CUT_TO_D, Kind.CONVERTED_TO_D
_TO_PARENT = Kind.CUT_TO_PARENT, Kind.CONVERTED
"""Kinds of repairs with and without removed atoms."""
