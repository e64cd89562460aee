"""How a structure is read, cut into rigid bodies and given an energy: the same for every kind of run."""

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

from protochain import defaults
from protochain.checks import (
    Bond,
    acidity,
    bonds,
    check_fields,
    cutoff_of,
    file_name,
    flag,
    integer,
    kinds,
    optional,
    selection,
    text,
    words,
)
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
    cutoff : float, "auto" or None
        As in :func:`protochain.energy`.
    threads : int, optional
        Threads for the energy; all by default.
    trust_forcefield : bool
        Allow a force-field file to run the Python scripts and open the files it names.
    model : int or str, optional
        Number of the model in the file; the first by default. A batch, or the command ``minimise``, also
        takes ``all`` or numbers as ``1-5,8``, and treats each of these models by itself.
    altloc : str
        Alternate location to prefer, which some atom must have; by default, and where it is absent, the one
        of highest occupancy.
    keep : tuple of str
        Molecules to keep beside the protein, as in :func:`protochain.load`, or their names in one text with
        commas between.
    disulfide : tuple of pairs of str, optional
        Disulfide bonds beside those where sulphurs are near, each ``("A:3", "A:40")`` or ``"A:3-A:40"``;
        ``"none"`` among them drops those.
    ph : float
        Of the protonation of residues whose hydrogens or names do not show it.
    strict : bool
        Refuse chain breaks and incomplete backbones.
    chains : tuple of str
        Chains to take, or their names in one text with commas between; all by default.

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
    cutoff: float | Literal["auto"] | None = defaults.CUTOFF
    threads: int | None = None
    trust_forcefield: bool = False
    model: int | str | None = None
    altloc: str = ""
    keep: tuple[str, ...] = defaults.KEEP
    disulfide: tuple[Bond, ...] | None = None
    ph: float = defaults.PH
    strict: bool = False
    chains: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        check_fields(
            self, hinges=kinds, root=text, move=selection, forcefield=file_name, solvent=text, engine=text,
            cutoff=cutoff_of, threads=optional(integer), trust_forcefield=flag, model=_model, altloc=text,
            keep=words, disulfide=optional(bonds), ph=acidity, strict=flag, chains=words,
        )  # fmt: skip

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

        if isinstance(self.model, str):
            raise ProtochainError(f"model {self.model}: one structure is prepared at a time; give its number")
        return as_structure(
            source, name, model=self.model, altloc=self.altloc, keep=self.keep, disulfide=self.disulfide,
            ph=self.ph, strict=self.strict, forcefield=self.forcefield, chains=self.chains,
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
            cutoff=self.cutoff, threads=self.threads, trust_forcefield=self.trust_forcefield,
        )  # fmt: skip


def models_asked(model: int | str) -> tuple[int, ...]:
    """Return the numbers of the models asked for by number or as ``1-5,8``, in that order and once each."""
    numbers: dict[int, None] = {}
    for part in str(model).split(","):
        first, _, last = part.partition("-")
        numbers |= dict.fromkeys(range(int(first), int(last or first) + 1))
    return tuple(numbers)


def _model(given: int | str | None, name: str) -> int | str | None:
    if given is None or given in ("", ALL_MODELS):
        return given or None
    asked = "".join((given if isinstance(given, str) else str(integer(given, name))).split())
    parts = [re.fullmatch(r"(\d{1,9})(?:-(\d{1,9}))?", part) for part in asked.split(",")]
    ranges = [(int(part[1]), int(part[2] or part[1])) for part in parts if part]
    if len(ranges) < len(parts) or any(not 0 <= b - a < _MOST_MODELS for a, b in ranges):
        raise ProtochainError(f"{name} {given!r}: give its number, or all, or a range such as 1-5")
    return int(asked) if asked.isdigit() else asked


_MOST_MODELS = 100_000
"""In one range: more are a slip."""
