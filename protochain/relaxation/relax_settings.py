"""Settings of a relaxation, validated once."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, fields, replace
from typing import Any

from protochain.chains.restraint import Restraint
from protochain.chains.restraint_lines import read_restraints
from protochain.chains.setup import Setup
from protochain.core import defaults
from protochain.core.checks import at_least, flag, in_range, number, optional, refuse_unknown, sequences, text
from protochain.core.errors import Argument, ProtochainError, refusal
from protochain.core.settings import Settings, document_fields, setting
from protochain.minimisers.minimise_settings import TOLERANCE
from protochain.relaxation.presets import PRESETS, PROTOCOLS, Preset


@document_fields
@dataclass(frozen=True)
class RelaxSettings(Settings):
    """Settings of a relaxation.

    Raises
    ------
    ProtochainError
        If a setting makes no sense.
    """

    # ``predicted`` for models: springs from all heavy atoms to the input. ``crystal``: weaker on side chains.
    # ``design``: on the backbone alone, weakened and removed in three stages, after soft repulsion.
    preset: str = setting(defaults.PRESET, "Springs to the input: predicted, crystal or design.", text)
    # ``alphafold`` for AlphaFold's force field (amber99sb), solvent (vacuum), springs and tolerance, for
    # comparisons. Unlike in AlphaFold, bonds to hydrogen are not constrained. Empty for none.
    protocol: str = setting(
        "", "alphafold: amber99sb in vacuum, for comparison (X-H bonds are not constrained here).", text
    )
    tolerance: float | None = setting(
        None, "RMS force at the end, kJ/mol/nm [default: 10].", TOLERANCE, float,
        doc="RMS force at which a minimisation ends, kJ/mol/nm, with springs. By default, the preset's.",
    )  # fmt: skip
    stiffness: float | None = setting(
        None,
        "Springs, kJ/mol/nm^2 [default: of the preset, 4184, AlphaFold's 10 kcal/mol/angstrom^2].",
        optional(in_range(number, lambda k: 0 <= k < math.inf, "give kJ/mol/nm^2, none below 0")),
        float,
        doc="Springs of the backbone, E = k/2 d^2, kJ/mol/nm^2. Springs of side chains scale with them. By "
        "default, the preset's. AlphaFold's 10 kcal/mol/angstrom^2 are 4184.",
    )
    max_iterations: int = setting(
        defaults.MAX_ITERATIONS, "Iterations of each minimisation, or 0 for no limit.", at_least(0), int
    )
    max_outer_iterations: int = setting(
        defaults.MAX_OUTER_ITERATIONS,
        "Most rounds. After the first, residues with violations have weaker springs.",
        at_least(1),
        int,
        doc="Most rounds. After the first, residues that still have violations or overlaps, and their "
        "neighbours, have a tenth of their springs, and in the next round none.",
    )
    exclude: str = setting(
        "", "Residues without springs, in MDAnalysis's selection language: 'resid 5:20'.", text
    )
    keep_hydrogens: bool = setting(
        True, "Whether the output has hydrogens.", flag, bool, "--keep-hydrogens/--strip-hydrogens"
    )
    repack: bool = setting(
        False, "First repack side chains that clash, or are far from every rotamer.", flag, bool
    )
    posebusters: bool = setting(
        False, "Run PoseBusters' tests on ligands before and after, in seconds for each.", flag, bool
    )
    free_ligands: bool = setting(False, "No springs on ligands.", flag, bool)
    score_only: bool = setting(
        False, "Measure poses, or the structure, as they are, without moving an atom.", flag, bool
    )
    repack_region: str = setting(
        "", "First repack all side chains of a selection: 'interface A B', 'chainID A'.", text,
        doc="Residues whose side chains are first repacked together, with or without clashes, in the "
        "selection language of MDAnalysis: ``chainID A``, ``interface A B``. Input side chains are "
        "candidates, too. Implies ``repack``.",
    )  # fmt: skip
    # As in :class:`protochain.Setup`: selection of side chains to rebuild from the backbone, or ``all``.
    rebuild_side_chains: str = setting(
        "", "First rebuild side chains on rotamers: all, or those of a selection.", text,
        metavar="all|SELECTION",
    )  # fmt: skip
    # As in :class:`protochain.Setup`: sequence to build on the backbone.
    sequence: str = setting(
        "", "First mutate the backbone to this sequence: letters, with / between chains, or a FASTA file, "
        "with a result for each design.",
        sequences, metavar="FASTA",
    )  # fmt: skip
    restraints: tuple[Restraint, ...] = setting(
        (), "Further restraint, as 'distance A:3:CA A:9:CA 0 6 1000', or a file of them.",
        read_restraints, list[str], "--restraints --restrain", metavar="LINE|FILE",
        type="Restraint, str, path-like, or sequence of them",
        doc="Restraints in addition to the springs, in all rounds: Restraints, lines, or a file.",
    )  # fmt: skip
    interface: str = setting(
        "",
        "Also score the interface of two sides before and after, like protochain score: A:B.",
        text,
        metavar="A,B:C",
    )
    mirror: bool = setting(
        False, "Treat all-D chains with L residue names as intended, and rename their residues.", flag, bool,
        doc="Whether mirror-image chains, with mostly D stereocentres and L names, are intended. Their "
        "residues are then renamed as D-amino acids. Otherwise they are violations.",
    )  # fmt: skip

    def __post_init__(self) -> None:
        super().__post_init__()
        refuse_unknown(self.preset, "preset", PRESETS)
        if self.protocol:
            refuse_unknown(self.protocol, "protocol", PROTOCOLS)
        if self.protocol and self.preset != defaults.PRESET:
            remedy = Argument("protocol"), f" {self.protocol} has its own; give one of them"
            raise refusal("preset", self.preset, *remedy)
        if self.score_only and (self.repack or self.repack_region):
            raise ProtochainError(Argument("score_only"), ": no atom moves; remove ", Argument("repack"))

    @property
    def strength(self) -> Preset:
        """The preset or protocol, with the tolerance and stiffness of the settings, if given."""
        preset = PROTOCOLS[self.protocol] if self.protocol else PRESETS[self.preset]
        if self.tolerance is not None:
            preset = replace(preset, tolerance=self.tolerance)
        if self.stiffness is not None:
            share = self.stiffness / max(preset.backbone)
            backbone = tuple(share * k for k in preset.backbone)
            side_chains = tuple(share * k for k in preset.side_chains)
            preset = replace(preset, backbone=backbone, side_chains=side_chains)
        return preset

    def setup(self, base: Setup) -> Setup:
        """Return a setup with the protocol's force field and solvent, and the side chains to build."""
        strength = self.strength
        for name, usual in (("forcefield", defaults.FORCEFIELD), ("solvent", defaults.SOLVENT)):
            value, fixed = getattr(base, name), getattr(strength, name)
            if fixed and value not in (usual, fixed):
                remedy = Argument("protocol"), f" {self.protocol} is {fixed}; leave one of them out"
                raise refusal(name, value, *remedy)
        return replace(
            base, forcefield=strength.forcefield or base.forcefield,
            solvent=strength.solvent or base.solvent,
            rebuild_side_chains=self.rebuild_side_chains or base.rebuild_side_chains,
            sequence=self.sequence or base.sequence,
        )  # fmt: skip


NAMES = tuple(field.name for field in fields(RelaxSettings))


def fixed_options(relaxing: RelaxSettings, options: Iterable[str]) -> set[str]:
    """Names of settings that options or the protocol set."""
    return {*options, *(name for name in ("forcefield", "solvent") if getattr(relaxing.strength, name))}


def split(options: dict[str, Any]) -> tuple[RelaxSettings, Setup]:
    """Split options into settings of the relaxation and of the setup."""
    of_setup = tuple(field.name for field in fields(Setup) if field.name not in WITHOUT)
    unknown = next((name for name in options if name not in (*NAMES, *of_setup)), None)
    if unknown is not None:
        from difflib import get_close_matches

        names = {name.lower(): name for name in (*NAMES, *of_setup)}
        near = [names[name] for name in get_close_matches(unknown.lower(), names, 1)]
        suggestion = f"did you mean {near[0]}? " if near else ""
        raise ProtochainError(
            f"relax has no option {unknown!r}; {suggestion}it takes {', '.join(names.values())}"
        )
    relaxing = RelaxSettings(**{name: value for name, value in options.items() if name in NAMES})
    setup = Setup(**{name: value for name, value in options.items() if name in of_setup})
    return relaxing, relaxing.setup(setup)


WITHOUT = ("hinges", "root")
"""Settings of rigid bodies, which a relaxation of all atoms does not have."""
