"""Changes to the contents of files: kinds, texts and summaries."""

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from enum import Enum, IntEnum, StrEnum
from functools import partial
from string import Formatter
from textwrap import shorten
from types import MappingProxyType
from typing import Any, NamedTuple

from protochain.core import defaults
from protochain.core.arrays import Value
from protochain.core.errors import Angle, Argument, ProtochainError
from protochain.core.markup import abridge, plural
from protochain.structure.molecule.residues import Atom

_SHOWN = 8  # Number of places, or structures, listed in a line about many changes.
_LOSS_WIDTH = 200  # Characters of the report of the losses of one structure.
KEEP_ALL = Argument("keep", "all")
"""Argument that includes removed molecules."""

Render = Callable[[Argument | Angle], str]
"""Function that writes an argument or angle for the reader. For Python it is ``str``."""


class Rank(IntEnum):
    """Order in a summary."""

    LEFT_OUT = 0
    GAP = 1
    LOSS = 2
    CHANGE = 3
    HISTIDINE = 4
    HYDROGENS = 5


class Words(NamedTuple):
    """Words of a kind of repair."""

    one: str  # A template, whose fields are the facts of the repair.
    many: str = ""  # Text about several residues, by default the text of ``one`` after its residue.
    rank: Rank = Rank.CHANGE


_Loss = partial(Words, rank=Rank.LOSS)
_Omission = partial(Words, rank=Rank.LEFT_OUT)


class Kind(Enum):
    """Kinds of repairs, with their words: the template alone, or ``Words``."""

    def __init__(self, *words: Any) -> None:
        self.words = Words(*words)

    # Of the file and its models.
    LOWER_CASE = "{count:n atom record} in lower case read as upper case"
    NOT_A_NUMBER = "occupancy of {count:n atom} is no number below 1000: read as 0"
    NO_ELEMENT = (
        "columns 77-78 of {count:n atom record}, from line {line} on, hold no element: elements derived "
        "from atom names"
    )
    NO_ENDMDL = "{count:n model} without an ENDMDL record, taken to end where the next begins"
    INDENTED = "{count:n atom record} with blanks before the record name: read without these blanks"
    SEGMENTS_JOINED = (
        "{count:n atom record} after the END or ENDMDL record of line {line}: read as parts of one structure"
    )
    CHAIN_RENAMED = "chain {before} called {after}: one before it has its id and numbers"
    MOLECULES_RENUMBERED = "molecules that share number and name renumbered: {count} more"
    ATOMS_NUMBERED = "atoms that share a name numbered in {count:n molecule}"
    ASSEMBLY = "assembly {name} built of {before:n chain}: chains {chains:8}"
    BLOCKS_LEFT_OUT = _Loss(
        "data block {used} used, others with atoms left out: {others:4}; give each its own file"
    )
    MODELS_LEFT_OUT = _Loss("model {used} used, {count:n other model} left out")
    MODELS_ARE_COPIES = _Loss(
        "model {used} used, {count:n other model} left out: rigid copies of it, as of an assembly; "
        "{remedy} joins them"
    )
    NO_END = _Loss(
        "the file ends at {residue} without an end mark (END, or # in mmCIF) or a terminal oxygen: check "
        "that it is complete"
    )
    MADE_WHOLE = (
        "{count:n residue} broken across the periodic box of {box} angstrom made whole, first {residue}"
    )
    IMAGE_MOVED = (
        "{count:n molecule} moved to the image of the periodic box of {box} angstrom next to the others: "
        "those of {residues:6}"
    )
    # Of its residues.
    ELEMENTS = "elements of {count:n atom} of standard residues corrected by their names, first {atom}"
    DEUTERIUM = "{count:n deuterium atom} read as hydrogen"
    ALTERNATES = _Loss(
        "{residue}: alternate location {used} kept (occupancy {occupancy:.2f}), {others} left out",
        "alternate locations left out",
    )
    EXCLUDED = _Loss(
        "{residue}: left out (occupancy {occupancy:.2f}): an alternate of {other}, which lies upon it"
    )
    COINCIDENT = _Loss(
        "{residue} lies upon {other}: both kept; leave one out of the file, or give each its occupancy"
    )
    REPEATED = Words(
        "{residue}: {atoms} given more than once; the first of each kept",
        "atoms given more than once, the first of each kept",
    )
    UNRESOLVED = "{count:n atom} of zero occupancy kept, in {residues:1}"
    RENAMED = "{residue}: read as {name}"
    STATE_NAMED = "{residue}: read as {name} in protonation state {state}"
    NO_PLACE = Words(
        "{residue}: {atoms} at the origin, upon CA or over 15 angstrom away: treated as missing",
        "atoms at the origin, upon CA or over 15 angstrom away treated as missing",
    )
    VIRTUAL = Words("{residue}: pseudo-atoms {atoms} removed", "pseudo-atoms removed")
    SITES = "{count:n virtual site} of {waters:n water} removed"
    SELENOMETHIONINE = "{residue}: selenomethionine converted to MET"
    CONVERTED = Words(
        "{residue}: converted to its standard parent {name}",
        "modified residues converted to their standard parents",
    )
    CUT_TO_PARENT = _Loss(
        "{residue}: converted to its standard parent {name}, {atoms} left out",
        "modified residues converted to their standard parents",
    )
    CONVERTED_TO_D = "{residue}: converted to its D-amino acid {name}"
    CUT_TO_D = _Loss("{residue}: converted to its D-amino acid {name}, {atoms} left out")
    MIRRORED = "{residue}: D-amino acid, with the parameters of its mirror image"
    MIRRORED_CUT = _Loss("{residue}: D-amino acid, with the parameters of its mirror image, {atoms} left out")
    NO_BACKBONE = _Loss(
        "{residue}: left out: its backbone atom {atom} is missing", "left out, without a backbone atom,"
    )
    CAP = _Loss("{residue}: left out: this cap is not at the end of a chain")
    ALONE = "{residue}: no part of a chain: it is bonded to no other residue"
    TORN = "the bond of {last} and {first} is {length:.1f} angstrom long: kept as a peptide bond"
    GAP = Words(
        "chain {last.chain_name} is broken between {last.number} and {first.number} ({length:.1f} angstrom): "
        "split there, with charged termini; {caps} adds caps, or model the missing residues",
        rank=Rank.GAP,
    )
    CAP_AT_BREAK = Words(
        "{residue}: cap built at the break of the chain between {last.number} and {first.number} "
        "({length:.1f} angstrom)",
        "caps built at breaks of chains",
    )
    CAP_AT_END = Words("{residue}: cap built at the end of the chain", "caps built at the ends of chains")
    OXYGEN_TURNED = "{residue}: O turned for a cap, which has no room opposite to its place in the file"
    NOT_CAPPED = "{residue}: not capped: {why}"
    CHAIN_GOES_ON = "{last} and {first} are bonded: one chain, whose ids are kept"
    CYCLIC = "chain {last.chain_name} is cyclic: {last} is bonded to {first}"
    # Hetero molecules.
    WATERS_LEFT_OUT = _Omission(
        "{count:n water} left out: the solvent is implicit; {remedy} keeps everything"
    )
    LEFT_OUT = _Omission("{counts} left out; {remedy} keeps everything")
    KEPT = "{counts:8} kept with the protein"
    KEPT_BY_ELEMENT = (
        "{counts:8} kept with the protein ({bare:8} by element, unless the force field has parameters)"
    )
    PHOSPHATE = _Loss("{residue}: phosphate of a lone nucleotide left out: the force fields do not have it")
    COORDINATED = "{atom} is coordinated by {ends}: held at these distances by springs"
    ION_HELD = "{atom} is coordinated by {ends}: held at these distances by springs; the ion stays in place"
    ION_MOVES = "{atom} is coordinated by {ends}: held at these distances by springs, and moves with them"
    BONDED = "{atom} is bonded to {ends}: held at these distances by springs"
    BOND_IGNORED = _Loss("bond of the file between {atoms:and} ignored: {why}; mend the file if it is real")
    BONDS_LEFT_OUT = _Omission("{count:n bond} of the file to atoms that are left out")
    IMAGES = _Omission(
        "{count:n bond} of the file to symmetry mates, which are not in the model, ignored: of {atoms:6}"
    )
    NEAR = "{count:n pair} of atoms as near as bonded ones, but not bonded in the file: {pairs:2}"
    STAYS = "{residue} stays in place, though its parameters are known: it is bonded to another molecule"
    STAYS_UNKNOWN = "{residue} stays in place: {why}"
    BOUND = "{residue} moves, in torsions as a rigid body: chemistry of {source}, charge {charge}"
    COMPLEX = "{residue}: springs at the distances of the file in the place of the bonds of {atoms}"
    MODIFIED = (
        "{residue}: kept, with the force field of small molecules: chemistry of {source}, charge {charge}"
    )
    CHARGES_OF_MMFF94 = (
        "{residue}: partial charges of MMFF94: {atoms:8} are outside the domain of NAGL's model"
    )
    CHARGES_OF_DICTIONARY = "{residue}: charges of the Chemical Component Dictionary, {charge} in total"
    LINKED = "{atoms:and} are bonded ({length:.2f} angstrom): kept, in the place of {gone}"
    NO_PARAMETERS = "the bond between {atoms:and} has no parameters: {why}"
    CHARGED = "{residue}: charged for pH {ph:g}: {atoms}"
    CHARGE_UNSURE = (
        "{residue}: the charge of {atoms} at pH {ph:g} is uncertain; give the molecule with charges"
    )
    INVERTED = _Loss("{residue}: of another configuration than in its source: {atoms}")
    MOBILE = "{counts} with parameters of the force field: free to move, in torsions as a rigid body"
    STRAND = "strand of {count:n nucleotide}, {first} to {last}: free to move, in torsions as a rigid body"
    GLYCAN = (
        "{atoms:and} are bonded: the glycan of {count:n sugar} is free to move, with the parameters of "
        "GLYCAM-06j ({codes}), in torsions rigid with its residue"
    )
    SACCHARIDE = (
        "{count:n sugar} bonded to one another, {residue} first: free to move, with the parameters of "
        "GLYCAM-06j ({codes}), in torsions as a rigid body"
    )
    OTHER_ANOMER = (
        "{residue}: by its atoms the other anomer than by its name: it stays so, with the parameters of that"
    )
    SUGAR_INVERTED = _Loss("{residue}: of another configuration than its name says: {atoms}")
    NUCLEOTIDES_STAY = (
        "{count:n nucleotide} of a strand without parameters: {residues:6}; in place, the rest tied to them"
    )
    # Heavy atoms.
    ATOMS_RENAMED = "atoms renamed: {changes:4}"
    INVERTED_IN_FILE = "inverted stereocentres in the file: {atoms:6}"
    INNER_OXT = _Loss("{residue}: OXT left out: the chain continues")
    OXT_ADDED = "{residue}: missing OXT added"
    ATOMS_ADDED = Words("{residue}: missing {atoms} added", "missing atoms added")
    BUILT_AS_D = "{residue}: built as a D-amino acid, as others of its chain are under such names"
    BRIDGES_DROPPED = _Loss("disulfide bonds left out, as requested: {pairs:6}")
    BRIDGE = "disulfide bond between {first} and {second}"
    BRIDGE_ASKED = "disulfide bond between {first} and {second}, as requested"
    BRIDGE_FAR = (
        "disulfide bond between {first} and {second}, as requested; their sulphurs are {length:.1f} "
        "angstrom apart"
    )
    BRIDGE_IGNORED = _Loss(
        "disulfide bond of the file between {first} and {second} ignored: it is {length:.1f} angstrom long; "
        "request it as {remedy} if it is real"
    )
    # Hydrogens.
    USUAL_STATE = "{residue}: kept in its usual state: the force field has no terminal {state}"
    NO_PARTNER = "{residue}: called {name} in the file, without a disulfide bond: read as {residue.name}"
    RING_TURNED = Words(
        "{residue}: ring turned by 180 degrees, by its hydrogen bonds and contacts",
        "rings turned by 180 degrees",
    )
    AMIDE_TURNED = Words(
        "{residue}: amide turned by 180 degrees, by its hydrogen bonds and contacts",
        "amides turned by 180 degrees",
    )
    STATE_CHOSEN = "{residue} modelled as {state}"
    IMIDAZOLATE = "{residue} modelled as imidazolate: it bridges two metals"
    STATE_BY_PKA = "{residue} modelled as {state}: its pKa is {pka:.1f} by PROPKA"
    STRANGE_HYDROGENS = _Loss(
        "{residue}: hydrogens left out, not of its state: {atoms:6}",
        "hydrogens left out that do not belong to the state",
    )
    HYDROGENS_RENAMED = "{count:n hydrogen} with an unknown name renamed after the parent atom"
    HYDROGENS_ADDED = Words(
        "{count:n hydrogen} added at pH {ph:g} ({present} were in the file)", rank=Rank.HYDROGENS
    )
    # By relax, mutate and repack.
    SIDE_CHAIN_BUILT = Words("{residue}: side chain built anew", "side chains built anew")
    MUTATED = "{residue}: mutated to {name}"
    SIDE_CHAIN_TURNED = Words("{residue}: side chain turned from {before} to {after}", "side chains turned")
    HYDROGEN_TURNED = Words("{residue}: polar hydrogen turned", "polar hydrogens turned")
    NOT_PROVEN = "side chains turned into good rotamers, perhaps not the best: there are too many to try"
    HAND_TURNED = Words(
        "{residue}: inverted stereocentre {atoms:and} corrected", "inverted stereocentres corrected"
    )
    TURNED_TRANS = "{residue}: twisted peptide bond before it turned to trans"
    TURNED_CIS = "{residue}: twisted peptide bond before it turned to cis"


@dataclass(frozen=True)
class Count:
    """Number of molecules of a kind, and the reason for their removal."""

    n: int
    kind: str
    reason: str = ""

    def __str__(self) -> str:
        return f"{self.n} {self.kind}{self.reason and f' ({self.reason})'}"


@dataclass(frozen=True)
class AtomDistance:
    """One atom or two, and their distance, angstrom."""

    atoms: tuple[Atom, ...]
    length: float

    def __str__(self) -> str:
        return f"{' and '.join(map(str, self.atoms))} ({self.length:.2f} angstrom)"


@dataclass(frozen=True)
class AtomRename:
    """Name of an atom in the file, and its new name."""

    before: str
    after: Atom

    def __str__(self) -> str:
        return f"{self.before} to {self.after}"


class Reason(StrEnum):
    """Reasons for the loss of atoms of a file."""

    PARENT = "the force fields have only its standard parent"
    END = "the force fields have only its standard parent at the end of a chain"
    INCOMPLETE = "other atoms of the modified residue are missing or unknown"
    ASKED = "standard residues are asked for"
    PHOSPHATE = "the force fields have no phosphate of a lone nucleotide"
    INNER = "the chain continues"
    BONDED = "a bond takes its place"
    BACKBONE = "an atom of its backbone is missing"
    CAP = "a cap that is not at the end of a chain"
    ELEMENT = "its element is unknown"
    CHARGE = "the charge of this ion is unknown; give it in the file"
    DUMMY = "a dummy atom of a membrane"
    FAR = f"it is further than {defaults.KEEP_WITHIN:g} angstrom from the protein"

    @property
    def is_of_whole(self) -> bool:
        """Whether the whole residue is lost."""
        return self in (Reason.BACKBONE, Reason.CAP, Reason.ELEMENT, Reason.CHARGE, Reason.DUMMY, Reason.FAR)


@dataclass(frozen=True)
class Loss:
    """Lost heavy atoms of a residue of the file, without atoms excluded by options."""

    chain: str  # Of the residue in the file. The number has its insertion code.
    number: str
    name: str
    atoms: tuple[str, ...]  # Names in the file.
    why: Reason

    def __str__(self) -> str:
        place = f"{self.chain}:{self.number} {self.name}"
        return place if self.why.is_of_whole else f"{place} {', '.join(self.atoms)}"


@dataclass(frozen=True)
class Repair(Value):
    """A change to the contents of a file, with a sentence as its text."""

    kind: Kind
    # Facts in the text of the kind, and more: ``residue`` (a ``residues.Residue``), ``atoms``, ``count``,
    # ``length`` (angstrom), ...
    facts: Mapping[str, Any] = field(default_factory=dict, hash=False)
    lost: tuple[Loss, ...] = ()  # Lost atoms.

    @classmethod
    def of(cls, kind: Kind, lost: tuple[Loss, ...] = (), **facts: Any) -> "Repair":
        """Describe a change, with the facts of its text."""
        return cls(kind, facts, lost)

    def __post_init__(self) -> None:
        object.__setattr__(self, "facts", MappingProxyType(dict(self.facts)))

    def __str__(self) -> str:
        return self.sentence()

    def __repr__(self) -> str:
        return f"<Repair {self.kind.name}: {self}>"

    def sentence(self, render: Render = str) -> str:
        """Return the text as a sentence."""
        return _fill(self.kind.words.one, self, render)


class _Form(Formatter):
    """Fill templates. The format of a list is its shown length or ``and``, of a count ``n`` and a noun."""

    def __init__(self, render: Render) -> None:
        self.render = render

    def format_field(self, value: Any, spec: str) -> str:
        if isinstance(value, Argument):
            return self.render(value)
        if isinstance(value, ProtochainError):
            return value.render(self.render)
        if isinstance(value, tuple):
            texts = [str(item) for item in value]
            return " and ".join(texts) if spec == "and" else abridge(texts, int(spec or len(texts)))
        if spec.startswith("n "):
            return plural(value, spec[2:])
        return str(super().format_field(value, spec))


def _fill(template: str, repair: Repair, render: Render) -> str:
    return _Form(render).vformat(template, (), repair.facts)


def summarise(repairs: Iterable[Repair], render: Render = str) -> tuple[str, ...]:
    """Summarise repairs."""
    groups: dict[tuple[Rank, str], list[Repair]] = defaultdict(list)
    for repair in repairs:
        groups[_group(repair, render)].append(repair)
    ranked = sorted(groups.items(), key=lambda item: item[0][0])
    return tuple(_group_text(*group, alike, render) for group, alike in ranked)


_ACTION = frozenset({
    Kind.NOT_A_NUMBER, Kind.BLOCKS_LEFT_OUT, Kind.NO_END, Kind.EXCLUDED, Kind.COINCIDENT, Kind.NO_BACKBONE,
    Kind.TORN, Kind.GAP, Kind.NOT_CAPPED, Kind.BOND_IGNORED, Kind.NEAR, Kind.STAYS_UNKNOWN,
    Kind.NO_PARAMETERS, Kind.CHARGE_UNSURE, Kind.INVERTED, Kind.OTHER_ANOMER, Kind.SUGAR_INVERTED,
    Kind.NUCLEOTIDES_STAY, Kind.INVERTED_IN_FILE, Kind.BRIDGE_FAR, Kind.BRIDGE_IGNORED, Kind.ASSEMBLY,
    *(kind for kind in Kind if kind.words.rank is Rank.LOSS and kind is not Kind.ALTERNATES),
})  # fmt: skip


def needs_action(repair: Repair) -> bool:
    """Whether a user should check a change: a loss, a choice of the model, or an error in the file."""
    return repair.kind in _ACTION


def counts_of_changes(repairs: Iterable[Repair]) -> str:
    """Count added atoms, hetero molecules and removed molecules in one line."""
    log: dict[Kind, list[Mapping[str, Any]]] = defaultdict(list)
    for repair in repairs:
        log[repair.kind].append(repair.facts)
    completed = len(log[Kind.ATOMS_ADDED]) + len(log[Kind.OXT_ADDED])
    molecules = [count for facts in log[Kind.LEFT_OUT] for count in facts["counts"]]
    included = [
        str(count) for kind in (Kind.KEPT, Kind.KEPT_BY_ELEMENT) for f in log[kind] for count in f["counts"]
    ]
    added = [plural(facts["count"], "hydrogen") for facts in log[Kind.HYDROGENS_ADDED]]
    caps = len(log[Kind.CAP_AT_BREAK]) + len(log[Kind.CAP_AT_END])
    added += [plural(caps, "cap")] if caps else []
    added += [f"missing atoms of {plural(completed, 'residue')}"] if completed else []
    removed = [plural(facts["count"], "water") for facts in log[Kind.WATERS_LEFT_OUT]]
    removed += [f"{count.n} {count.kind}" for count in molecules]
    removed += [f"altlocs of {plural(len(log[Kind.ALTERNATES]), 'residue')}"] if log[Kind.ALTERNATES] else []
    charges = [f"charge of {facts['residue']} {facts['charge']}" for facts in log[Kind.BOUND]]
    parts = (added, " added"), (included, " kept"), (charges, ""), (removed, " removed")
    return "; ".join(f"{abridge(names, _SHOWN)}{verb}" for names, verb in parts if names)


def _group(repair: Repair, render: Render) -> tuple[Rank, str]:
    """Return the rank of a repair in the summary, and the text shared by the repairs of a line."""
    one, many, rank = repair.kind.words
    if rank is Rank.GAP:
        return rank, ""
    is_of_state = repair.kind in (Kind.STATE_NAMED, Kind.STATE_CHOSEN)
    if is_of_state and repair.facts["state"] in ("HID", "HIE", "HIP"):
        return Rank.HISTIDINE, ""
    return rank, _fill(many or one.removeprefix("{residue}").removeprefix(":").lstrip(), repair, render)


def _group_text(rank: Rank, change: str, alike: list[Repair], render: Render) -> str:
    """Summarise a group of repairs. A single repair has its own text, unless it is a histidine state."""
    if rank is Rank.HISTIDINE:
        his: dict[str, list[str]] = defaultdict(list)
        for item in alike:
            his[item.facts["state"]].append(item.facts["residue"].place)
        return "HIS states: " + "; ".join(f"{state} {abridge(his[state], _SHOWN)}" for state in sorted(his))
    if len(alike) == 1 or (rank is not Rank.GAP and "residue" not in alike[0].facts):
        return alike[0].sentence(render)
    if rank is Rank.GAP:
        facts = [(gap.facts["last"], gap.facts["first"], gap.facts["length"]) for gap in alike]
        gaps = [f"{last.place}-{first.number} ({length:.1f} angstrom)" for last, first, length in facts]
        return (
            f"split at {len(gaps)} gaps in the chains, with charged termini: {abridge(gaps, _SHOWN)}; "
            f"{render(alike[0].facts['caps'])} adds caps, or model the missing residues"
        )
    places = [str(repair.facts["residue"]) for repair in alike]
    return f"{change} in {len(places)} residues: {abridge(places, _SHOWN)}"


def lost_atoms(losses: Iterable[Loss]) -> list[str]:
    """Return the residues that lost atoms with these atoms, as in a record."""
    return [str(loss) for loss in losses if loss.why is not Reason.FAR]


def n_lost(losses: Iterable[Loss]) -> int:
    """Return the number of lost atoms."""
    return sum(len(loss.atoms) for loss in losses if loss.why is not Reason.FAR)


def far_molecules(losses: Iterable[Loss]) -> list[str]:
    """Return the molecules removed because they are far from the protein, as in a record."""
    return [str(loss) for loss in losses if loss.why is Reason.FAR]


def loss_lines(rows: Iterable[Mapping[Any, Any]], render: Render = str) -> list[str]:
    """Report the losses of the structures of a run."""
    row_of = {str(row.get("structure")): row for row in rows}
    lines = []
    for key, heading in _LOSS_COLUMNS.items():
        remedy = f"; {render(KEEP_ALL)} keeps them" if key == "far_molecules" else ""
        cells = {name: row.get(key) for name, row in row_of.items()}
        texts = {name: "; ".join(cell) if isinstance(cell, list) else cell for name, cell in cells.items()}
        filled = {name: text for name, text in texts.items() if isinstance(text, str) and text}
        lost = {name: shorten(text, _LOSS_WIDTH, placeholder=" ...") for name, text in filled.items()}
        if len(row_of) == 1 and lost:
            lines.append(f"{heading}: {''.join(lost.values())}{remedy}")
        elif lost:
            stated = ", ".join(f"{name} ({text})" for name, text in [*lost.items()][:_SHOWN])
            suffix = f" and {len(lost) - _SHOWN} more" if len(lost) > _SHOWN else ""
            lines.append(f"{len(lost)} of {len(row_of)} structures {heading}: {stated}{suffix}{remedy}")
    return lines


_LOSS_COLUMNS = {
    "lost_atoms": "lost atoms",
    "far_molecules": f"left out molecules further than {defaults.KEEP_WITHIN:g} angstrom from the protein",
}
"""Columns and their texts."""
