"""Settings for reading a structure, its rigid bodies and its energy, shared by all kinds of runs."""

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

from protochain.core import checks, defaults
from protochain.core.checks import NO_BONDS, Bond, LigandSource
from protochain.core.errors import Argument, ProtochainError, refusal
from protochain.core.settings import Settings, document_fields, setting

if TYPE_CHECKING:
    from protochain.chains.chain import Chain
    from protochain.energies import Energy
    from protochain.structure import Structure

ALL_MODELS = "all"
OF_ENERGY = (
    "forcefield", "solvent", "salt", "engine", "device", "cutoff", "accuracy", "threads", "trust_forcefield",
    "terms", "calculator",
)  # fmt: skip
"""Settings that are arguments of :func:`protochain.energy`."""
_MOST_MODELS = 100_000  # Most models in one range. Larger ranges are errors.


class Prepared(NamedTuple):
    """All-atom structure, its rigid bodies and hinges, and its potential energy."""

    structure: "Structure"
    chain: "Chain"
    energy: "Energy"

    @property
    def energy_function(self) -> "Energy":
        """Energy, by the name that results have."""
        return self.energy


@document_fields
@dataclass(frozen=True)
class Setup(Settings):
    """Settings for reading a structure, its rigid bodies and its energy.

    Raises
    ------
    ProtochainError
        If the model or a disulfide bond cannot be read.

    Examples
    --------
    >>> structure, chain, energy = pc.Setup(solvent="vacuum").prepare("structures/ala10.pdb")
    >>> structure.n_residues
    10
    """

    # As in :func:`protochain.build_chain`.
    hinges: str = setting(
        defaults.HINGES,
        "Degrees of freedom: any of phi psi omega chi polar rotors angles nucleic ligand glycan.",
        checks.kinds,
    )
    root: str = setting(defaults.ROOT, "", checks.text)  # As in :func:`protochain.build_chain`.
    # As in :func:`protochain.build_chain`.
    move: str = setting(
        defaults.MOVE,
        "Mobile atoms, in MDAnalysis's selection language, with sidechain, ligand, interface: 'resid 5:20'.",
        checks.selection,
    )
    rigid_protein: bool = setting(
        False,
        "Move only poses (--ligands POSE), or without poses ligands of known chemistry.",
        checks.flag,
        bool,
        doc="Whether only added poses move, or without poses all ligands of known chemistry. Sets ``move`` "
        "to ``ligand``.",
    )
    forcefield: str = setting(
        defaults.FORCEFIELD,
        "amber14, amber19, amber99sb, amber99sbildn, charmm36, an OpenMM XML file, or several (a,b).",
        checks.file_name,
    )
    solvent: str = setting(defaults.SOLVENT, "vacuum, hct, obc1, obc2, gbn or gbn2.", checks.text)
    salt: float = setting(
        defaults.SALT,
        "Concentration of salt in the solvent, mol/l, as --solvent gbn2 --salt 0.15.",
        checks.concentration,
        float,
        doc="Concentration of salt in the solvent, mol/l, as in :func:`protochain.energy`.",
    )
    engine: str = setting(defaults.ENGINE, "auto, native or openmm.", checks.text)
    device: str = setting(
        defaults.DEVICE,
        "Device for the energy: cpu, or with OpenMM cuda, hip or opencl. auto uses a GPU from 5,000 atoms, "
        "in frames from 1,000, if there is one.",
        checks.text,
    )
    terms: str = setting(
        "all",
        "Terms of the force field: all, or nonbonded, without dihedrals, for methods that only turn hinges.",
        checks.text,
        doc="As in :func:`protochain.energy`.",
    )
    calculator: str | None = setting(
        None,
        "xtb, aimnet2 or mace-off, within the ligands, or within a small structure without ligands.",
        checks.optional(checks.text),
        option="--energy",
        doc="As in :func:`protochain.energy`.",
    )
    cutoff: float | Literal["auto"] | None = setting(
        defaults.CUTOFF,
        "Cutoff distance of pairs, nm, none, or auto: none, or 2 above 20,000 atoms without a tree.",
        checks.cutoff_of,
        type='float, "auto" or None',
    )
    accuracy: float | Literal["auto", "exact"] = setting(
        defaults.ACCURACY,
        "RMS error of forces of a tree for far pairs, kJ/mol/nm, exact, or auto: 0.001 from 5,000 atoms.",
        checks.accuracy_of,
        type='float, "auto" or "exact"',
    )
    threads: int | None = setting(None, "Threads [default: all].", checks.optional(checks.at_least(1)), int)
    trust_forcefield: bool = setting(False, "Allow a force-field file to run its scripts.", checks.flag, bool)
    model: int | str | None = setting(
        None,
        "Number of the model [default: the first]. minimise, relax, batch and validate also accept all, "
        "or 1-5,8.",
        lambda value, name: _model(value, name),
        doc="Number of the model in the file, by default the first. A batch, or the command ``minimise``, "
        "also accepts ``all`` or numbers as ``1-5,8``, and treats each of these models separately.",
    )
    assembly: str = setting(
        "",
        "Biological assembly to build, by its name in the file, or models to join all models "
        "[default: the molecules of the file].",
        checks.text,
    )
    altloc: str = setting("", "Preferred alternate location [default: highest occupancy].", checks.text)
    keep: tuple[str, ...] = setting(
        defaults.KEEP,
        "Hetero molecules to include, separated by commas: near (within 5 angstrom, without waters), "
        "none, all, water, ions, nucleic, ligands, or names of residues [default: near].",
        checks.words,
        type="tuple of str",
        doc="Hetero molecules to include, as in :func:`protochain.load`, or their names in one text, "
        "separated by commas.",
    )
    disulfide: tuple[Bond, ...] | None = setting(
        None,
        "Disulfide bonds, also without near sulphurs, separated by commas. The option may be repeated.",
        checks.optional(checks.bonds),
        list[str],
        metavar="A:3-A:40",
        type="tuple of pairs of str, optional",
        doc='Disulfide bonds in addition to bonds of near sulphurs, each ``("A:3", "A:40")`` or '
        '``"A:3-A:40"``. ``"none"`` among them removes the bonds of near sulphurs.',
        word=("no_disulfide", "Use only the disulfide bonds of --disulfide.", NO_BONDS),
    )
    ph: float | Literal["auto"] = setting(
        defaults.PH,
        "pH for residues whose protonation the file does not show, or auto: 7, with pKa values by "
        "PROPKA [default: 7].",
        checks.acidity_or_auto,
        read=checks.number_in,
        type='float or "auto"',
        doc="pH for the protonation of residues whose hydrogens or names do not show it, as in "
        ":func:`protochain.load`.",
    )
    strict: bool = setting(False, "Refuse chain breaks and incomplete backbones.", checks.flag, bool)
    chains: tuple[str, ...] = setting(
        (),
        "Chains to read, separated by commas [default: all].",
        checks.words,
        option="--chains --chain",
        metavar="A,B",
        type="tuple of str",
    )
    ligands: tuple[LigandSource, ...] = setting(
        (),
        "Chemistry of a ligand by the name of its residue, or a pose to add (only FILE). relax, score and "
        "batch accept several poses, in a folder or a file, and add each separately. Repeat for more.",
        checks.ligands,
        list[str],
        option="--ligands --ligand --ligand-poses",
        metavar="NAME=SDF|MOL2|SMILES",
        type="tuple of (str, str)",
        doc="Sources of ligands' chemistry, and poses to add, as in :func:`protochain.load`.",
    )
    ligand_charges: str = setting(
        defaults.LIGAND_CHARGES,
        "Partial charges of ligands: nagl, mmff94, gasteiger, or a file.",
        checks.charges_of_ligands,
    )
    standard_residues: bool = setting(
        False, "Convert modified residues to their standard parents: SEP to SER.", checks.flag, bool
    )
    cap: str = setting(
        defaults.CAP,
        "Chain ends to cap with ACE and NME: none, breaks, ends (unless the file's sequence ends there), or "
        "all.",
        checks.one_of(defaults.CAPPED),
    )
    # Residues whose side chains are rebuilt together from the backbone alone: ``all``, or a selection.
    rebuild_side_chains: str = setting("", "", checks.text)
    # Sequence to put on the backbone: a FASTA file, or letters with ``/`` between chains. Side chains of
    # mutated residues are built.
    sequence: str = setting("", "", checks.sequences)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.rigid_protein and self.move not in (defaults.MOVE, defaults.LIGAND):
            raise ProtochainError(
                Argument("rigid_protein"), ": only ligands move; remove ", Argument("move", self.move)
            )
        if self.rigid_protein:
            object.__setattr__(self, "move", defaults.LIGAND)

    @property
    def solvent_label(self) -> str:
        """Name of the solvent model, with its salt."""
        from protochain.energies.factory import solvent_label

        return solvent_label(self.solvent, self.salt)

    @property
    def poses(self) -> tuple[str, ...]:
        """Files of added poses."""
        return tuple(source for name, source in self.ligands if not name)

    def save_ligands(self, result: Any, path: Path) -> None:
        """Write the added poses first. Without poses, or with ``keep="all"``, write all ligands."""
        from protochain.structure.ligand_files import save_ligands

        save_ligands(result, path, self.poses, others="all" in self.keep)

    def prepare(
        self, source: Any, name: str = "structure", build_energy: "Callable[..., Energy] | None" = None
    ) -> Prepared:
        """Prepare a structure, cut it into a chain, and build its energy.

        Parameters
        ----------
        source : path-like, Structure, or any argument of :func:`protochain.as_structure`
            Structure to prepare. A Structure stays unchanged. The setup determines hinges and energy, also
            for a result, which has others.
        name : str
            Short name, for a source without a file.
        build_energy : callable, optional
            Called in place of :func:`protochain.energy`, with the same arguments.

        Returns
        -------
        Prepared
            Structure, chain and energy.

        Raises
        ------
        ProtochainError
            If the structure cannot be prepared. The message names the file or the setting, and a remedy.
        """
        structure = self.load(source, name)
        return Prepared(structure, self.chain(structure), self.energy(structure, build_energy))

    def load(self, source: Any, name: str = "structure") -> "Structure":
        """Prepare the structure alone, with arguments as in :meth:`prepare`."""
        from protochain.structure import as_structure

        if isinstance(self.model, str):
            raise refusal("model", self.model, "only one model can be prepared; give its number")
        if checks.designs(self.sequence):
            raise refusal("sequence", self.sequence, checks.choose_record(self.sequence))
        structure = as_structure(
            source, name, model=self.model, assembly=self.assembly, altloc=self.altloc, keep=self.keep,
            disulfide=self.disulfide, ph=self.ph, strict=self.strict, forcefield=self.forcefield,
            chains=self.chains, ligands=self.ligands, ligand_charges=self.ligand_charges,
            standard_residues=self.standard_residues, cap=self.cap,
        )  # fmt: skip
        if not (self.rebuild_side_chains or self.sequence):
            return structure
        from protochain.structure.substitute import rebuild

        return rebuild(structure, self.rebuild_side_chains, self.sequence, **self.of_building)

    @property
    def of_building(self) -> dict[str, Any]:
        """Settings for completing a prepared structure again."""
        return {name: getattr(self, name) for name in ("forcefield", "ph", "disulfide", "ligand_charges")}

    def chain(self, structure: "Structure") -> "Chain":
        """Cut a structure into rigid bodies."""
        from protochain.chains.articulate import build_chain

        return build_chain(structure, self.hinges, self.root, move=self.move)

    def energy(self, structure: "Structure", build_energy: "Callable[..., Energy] | None" = None) -> "Energy":
        """Build the energy of a structure, with ``build_energy`` as in :meth:`prepare`."""
        from protochain.energies import energy

        return (build_energy or energy)(structure, **{name: getattr(self, name) for name in OF_ENERGY})

    def energy_of(self, source: Any, structure: "Structure", names: Iterable[str]) -> "Energy":
        """Energy of a result with the named settings replaced, otherwise the energy of the setup."""
        from protochain.energies import as_energy

        return as_energy(None, structure, source, **{n: getattr(self, n) for n in OF_ENERGY if n in names})


def parse_models(model: int | str) -> tuple[int, ...]:
    """Return the models of a number or of ``1-5,8``, in order, without duplicates."""
    numbers: dict[int, None] = {}
    for part in str(model).split(","):
        first, _, last = part.partition("-")
        numbers |= dict.fromkeys(range(int(first), int(last or first) + 1))
    return tuple(numbers)


def _model(value: int | str | None, name: str) -> int | str | None:
    if value is None or value in ("", ALL_MODELS):
        return value or None
    compact = "".join((value if isinstance(value, str) else str(checks.integer(value, name))).split())
    parts = [re.fullmatch(r"(\d{1,9})(?:-(\d{1,9}))?", part) for part in compact.split(",")]
    ranges = [(int(part[1]), int(part[2] or part[1])) for part in parts if part]
    if len(ranges) < len(parts) or any(not 0 <= b - a < _MOST_MODELS for a, b in ranges):
        raise refusal(name, f"{value!r}", "give its number, or all, or a range such as 1-5")
    return int(compact) if compact.isdigit() else compact
