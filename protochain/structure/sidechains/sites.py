"""Residues whose side chains are to be completed."""

from dataclasses import dataclass

import numpy as np

from protochain.core.arrays import dihedral
from protochain.structure.molecule.member import Member
from protochain.structure.sidechains.ideal import Places
from protochain.structure.sidechains.rotamers import BACKBONE


@dataclass(frozen=True, eq=False)
class Site:
    """A residue whose side chain is to be completed."""

    member: Member
    sign: int  # 1, or -1 for a D-amino acid, which is built as its mirror image.
    before: Member | None  # Its neighbours in the chain.
    after: Member | None

    @property
    def heavy_positions(self) -> Places:
        """Positions of the present heavy atoms, mirrored for a D-amino acid."""
        return self._places(self.member)

    @property
    def backbone(self) -> tuple[float, float]:
        """Phi and psi, degrees, of the L-amino acid, usual at chain ends."""
        positions = self.heavy_positions
        n, alpha, c = (positions[name] for name in ("N", "CA", "C"))
        before = self._places(self.before).get("C") if self.before else None
        after = self._places(self.after).get("N") if self.after else None
        phi = BACKBONE[0] if before is None else float(np.rad2deg(dihedral(before, n, alpha, c)))
        psi = BACKBONE[1] if after is None else float(np.rad2deg(dihedral(n, alpha, c, after)))
        return phi, psi

    def _places(self, member: Member) -> Places:
        heavy = member.heavy
        return {atom.name: self.sign * np.array(atom.pos.tolist()) for atom in heavy}
