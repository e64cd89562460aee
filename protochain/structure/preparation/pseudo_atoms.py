"""Particles of programs that are not atoms: virtual sites, lone pairs, Drude particles, centroids, averages.

PyMOL writes PS, CYANA Q (averages of hydrogens), Rosetta CEN, NV and V1, GROMACS M (virtual sites),
RFdiffusion3 V0 to V8, CHARMM LP (lone pairs) and D before the name of an atom (Drude particles).
"""

import re
from collections.abc import Collection

import gemmi

from protochain.structure.molecule.repairs import Kind, Repair
from protochain.structure.molecule.residues import CAPS, NUCLEOTIDES, STANDARD, Residue
from protochain.structure.molecule.templates import Template, standard_name, template_name, templates
from protochain.structure.preparation.structure_draft import Changes, Draft

_ELEMENT_LETTERS = "CHNOSPD"
"""First letters of atom names in amino acids and nucleotides, without leading digits."""
_PSEUDO = re.compile(r"PS\d*|CEN|NV\d*|ORIG")
_PADDING = re.compile(r"V[0-8]")
_SITE_NAME = re.compile(r"[MELVX]|DO|OM")
"""First letters of the names of virtual sites of a water."""


def remove_pseudo_atoms(draft: Draft) -> Changes:
    """Remove pseudo-atoms from amino acids, nucleotides and waters of a model, and report them."""
    all_templates, sites, waters = templates(), 0, 0
    for chain in draft.model:
        for residue in chain:
            name = standard_name(residue.name.strip().upper())[0]
            is_known = name in STANDARD or name in CAPS or name in NUCLEOTIDES
            template = all_templates.get(template_name(name)) if is_known else None
            of_water = [] if is_known else _virtual_sites(residue)
            places = of_water or _pseudo_atoms(residue, template)
            names = tuple(dict.fromkeys(residue[k].name for k in places))
            for k in reversed(places):
                del residue[k]
            if of_water:
                _name_water(residue)
                sites, waters = sites + len(places), waters + 1
            elif places:
                place = Residue(chain.name.strip(), str(residue.seqid).strip(), residue.name)
                yield Repair.of(Kind.VIRTUAL, residue=place, atoms=names)
    if sites:
        yield Repair.of(Kind.SITES, count=sites, waters=waters)


def _name_water(residue: gemmi.Residue) -> None:
    """Name a water of four or five sites as the archive does: T4P is a ligand there."""
    residue.name = "HOH"
    for atom in residue:
        atom.name = "O" if atom.name.lstrip("0123456789").startswith("O") else atom.name


def _pseudo_atoms(residue: gemmi.Residue, template: Template | None) -> list[int]:
    """Return the indices of pseudo-atoms. Names count only in amino acids and nucleotides without beads."""
    is_atomic = {"CA", "C1'", "C1*", "CH3"} & {atom.name for atom in residue}
    template = template if is_atomic else None
    atoms = {*template.element, *template.synonyms} if template else set()
    heavy = {*template.heavy} if template else set()
    return [
        k
        for k, atom in enumerate(residue)
        if atom.calc_flag == gemmi.CalcFlag.Dummy
        or (_PADDING.fullmatch(atom.name) and "CA" in residue)
        or (template and atom.name not in atoms and _is_pseudo_name(atom.name, heavy))
    ]


def _is_pseudo_name(name: str, heavy: Collection[str]) -> bool:
    """Whether an unknown name names a pseudo-atom: a Drude particle has a heavy atom's name after D."""
    letter = name.lstrip("0123456789")[:1]
    if name == "X":
        # The reader gives this name to an atom without one.
        return False
    is_drude = letter == "D" and name[1:] in heavy
    return letter not in _ELEMENT_LETTERS or is_drude or bool(_PSEUDO.fullmatch(name))


def _virtual_sites(residue: gemmi.Residue) -> list[int]:
    """Return the indices of a water's virtual sites, if its other sites are one oxygen and two hydrogens."""
    names = [atom.name.lstrip("0123456789") for atom in residue]
    sites = [k for k, name in enumerate(names) if _SITE_NAME.match(name) and not residue[k].element.is_metal]
    letters = sorted(name[:1] for k, name in enumerate(names) if k not in sites)
    return sites if letters in (["H", "H", "O"], ["D", "D", "O"]) else []
