"""Extended all-atom chains of standard geometry, built from sequences."""

from protochain.core.checks import text
from protochain.core.errors import StructureError
from protochain.structure.molecule.member import Member, atom
from protochain.structure.molecule.model import Structure
from protochain.structure.molecule.residues import LETTERS
from protochain.structure.preparation.prepare import prepare
from protochain.structure.preparation.structure_draft import Draft, Part

PROLINE_PHI = -70.0
"""Degrees. The ring of proline fixes phi near this value, and would not close at the extended -120."""


def from_sequence(sequence: str) -> Structure:
    """Build an extended all-atom chain.

    Parameters
    ----------
    sequence : str
        One-letter codes of the 20 standard amino acids, upper or lower case. Blanks are ignored.

    Returns
    -------
    Structure
        Chain A, numbered from 1: phi -120 (proline -70), psi 140, omega 180 degrees, bond lengths and
        angles of PeptideBuilder (Tien, Sydykova, Meyer, Wilke, PeerJ 1:e80, 2013), charged termini,
        hydrogens at pH 7.

    Raises
    ------
    StructureError
        If a letter is not one of the 20, or there are fewer than two.

    Examples
    --------
    >>> pc.from_sequence("GAG").n_atoms
    27
    """
    # Imported here because Biopython would slow every start of the program.
    import PeptideBuilder

    letters = "".join(text(sequence, "sequence").split()).upper()
    if not letters:
        raise StructureError("the sequence is empty; give one-letter codes such as NLYIQWLKDGG")
    for place, letter in enumerate(letters, 1):
        if letter not in LETTERS:
            raise StructureError(
                f"sequence: letter {place} is {letter!r}; use the 20 codes {''.join(sorted(LETTERS))}"
            )
    if len(letters) < 2:
        raise StructureError("sequence: give at least 2 residues; force fields lack free amino acids")
    geometries = [PeptideBuilder.Geometry.geometry(letter) for letter in letters]
    for letter, geometry in zip(letters, geometries, strict=True):
        if letter == "P":
            geometry.phi = PROLINE_PHI
    model = PeptideBuilder.make_structure_from_geos(geometries)

    name = letters if len(letters) <= 20 else f"{letters[:17]}_{len(letters)}"
    members = [
        Member(
            built.get_resname(), str(number), "", "A",
            [atom(part.get_name(), part.element, [float(c) for c in part.coord]) for part in built],
        )
        for number, built in enumerate(model.get_residues(), 1)
    ]  # fmt: skip
    return prepare(Draft(name, "sequence", [Part("A", members)]))
