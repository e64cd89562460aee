"""How a structure is read, cut into rigid bodies and given an energy: the same for every kind of run."""

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

from protochain import defaults
from protochain.errors import ProtochainError

if TYPE_CHECKING:
    from protochain.chain import Chain
    from protochain.energies import Energy
    from protochain.structure import Structure

ALL_MODELS = "all"


class Prepared(NamedTuple):
    """All-atom structure, its rigid bodies and hinges, and its potential energy."""

    structure: "Structure"
    chain: "Chain"
    energy: "Energy"


@dataclass(frozen=True)
class Setup:
    """How a structure is read, cut into rigid bodies and given an energy.

    Parameters
    ----------
    hinges, root, move : str
        As in :func:`protochain.build_chain`.
    forcefield, solvent, engine : str
        As in :func:`protochain.energy`.
    threads : int, optional
        Threads for the energy; all by default.
    trust_forcefield : bool
        Allow a force-field file to run the Python scripts and open the files it names.
    model : int or "all", optional
        Number of the model in the file; the first by default. A batch, or the command ``minimise``, takes
        ``all`` to treat every model by itself.
    altloc : str
        Alternate location to prefer, which some atom must have; by default, and where it is absent, the one
        of highest occupancy.
    keep : tuple of str
        Molecules to keep as fixed obstacles, as in :func:`protochain.load`, or their names in one text with
        commas between.
    disulfide : tuple of pairs of str, optional
        Disulfide bonds, each ``("A:3", "A:40")`` or ``"A:3-A:40"``; by default, where sulphurs are near.
    ph : float
        Of the protonation of residues whose hydrogens or names do not show it.
    strict : bool
        Refuse chain breaks and incomplete backbones.

    Raises
    ------
    ProtochainError
        If the model or a disulfide bond cannot be read.
    """

    hinges: str = defaults.HINGES
    root: str = defaults.ROOT
    move: str = defaults.MOVE
    forcefield: str = defaults.FORCEFIELD
    solvent: str = defaults.SOLVENT
    engine: str = defaults.ENGINE
    threads: int | None = None
    trust_forcefield: bool = False
    model: int | str | None = None
    altloc: str = ""
    keep: tuple[str, ...] = ()
    disulfide: tuple[tuple[str, str], ...] | None = None
    ph: float = defaults.PH
    strict: bool = False

    def __post_init__(self) -> None:
        for name, read in (("model", _model), ("keep", words), ("disulfide", _pairs)):
            object.__setattr__(self, name, read(getattr(self, name)))

    def prepare(
        self, source: Any, name: str = "structure", build_energy: "Callable[..., Energy] | None" = None
    ) -> Prepared:
        """Prepare a structure, cut it into a chain, and build its energy.

        Parameters
        ----------
        source : path-like, Structure, or anything that :func:`protochain.as_structure` takes
            Structure to prepare; a Structure stays as it is.
        name : str
            Short name, where there is no file.
        build_energy : callable, optional
            Called in place of :func:`protochain.energy`, with the same arguments.

        Returns
        -------
        Prepared
            Structure, chain and energy.

        Raises
        ------
        ProtochainError
            One line naming the file or the setting, and the mend.
        """
        structure = self.load(source, name)
        return Prepared(structure, self.chain(structure), self.energy(structure, build_energy))

    def load(self, source: Any, name: str = "structure") -> "Structure":
        """Prepare the structure alone; arguments as in :meth:`prepare`."""
        from protochain.structure import as_structure

        if self.model == ALL_MODELS:
            raise ProtochainError("model all: one structure is prepared at a time; give its number")
        return as_structure(
            source, name, model=self.model, altloc=self.altloc, keep=self.keep, disulfide=self.disulfide,
            ph=self.ph, strict=self.strict, forcefield=self.forcefield,
        )  # fmt: skip

    def chain(self, structure: "Structure") -> "Chain":
        """Cut a structure into rigid bodies."""
        from protochain.articulate import build_chain

        return build_chain(structure, self.hinges, self.root, move=self.move)

    def energy(self, structure: "Structure", build_energy: "Callable[..., Energy] | None" = None) -> "Energy":
        """Build the energy of a structure; ``build_energy`` as in :meth:`prepare`."""
        from protochain.energies import energy

        return (build_energy or energy)(
            structure, forcefield=self.forcefield, solvent=self.solvent, engine=self.engine,
            threads=self.threads, trust_forcefield=self.trust_forcefield,
        )  # fmt: skip


def words(given: str | Iterable[str]) -> tuple[str, ...]:
    """Split a text at its commas; leave a sequence of words as it is."""
    split = given.split(",") if isinstance(given, str) else given
    return tuple(word.strip() for word in split if word.strip())


def _model(given: int | str | None) -> int | str | None:
    if given is None or given in ("", ALL_MODELS):
        return given or None
    try:
        return int(given)
    except ValueError:
        raise ProtochainError(f"model {given!r}: give its number, or all") from None


def _pairs(given: str | Iterable[str | tuple[str, str]] | None) -> tuple[tuple[str, str], ...] | None:
    if given is None:
        return None
    bonds = words(given) if isinstance(given, str) else given
    return tuple(_pair(bond) if isinstance(bond, str) else (bond[0], bond[1]) for bond in bonds)


def _pair(bond: str) -> tuple[str, str]:
    """Read ``A:3-A:40``, where numbers may be negative."""
    found = re.fullmatch(r"(\S*:-?\d+\w?)-(\S*:-?\d+\w?)", bond)
    if not found:
        raise ProtochainError(f"disulfide {bond!r}: give chain:number-chain:number, as A:3-A:40")
    return found[1], found[2]
