"""Arguments of public calls, converted or refused once, in one line that names them.

A check receives a value and the name of its argument. It returns the value that the function works with.
"""

import inspect
import re
import sys
import warnings
from collections.abc import Callable, Iterable, Mapping
from functools import wraps
from numbers import Integral, Real
from pathlib import Path
from typing import Any, Literal, ParamSpec, TypeVar

from protochain.core.errors import Argument, ProtochainError, refusal
from protochain.core.markup import excerpt

Check = Callable[[Any, str], Any]

P = ParamSpec("P")
R = TypeVar("R")


def check_arguments(**checks: Check) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Decorate a function whose arguments of these names are checked before a call, without defaults."""

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        signature = inspect.signature(function)
        usual = {name: parameter.default for name, parameter in signature.parameters.items()}
        (keywords,) = [n for n, p in signature.parameters.items() if p.kind is p.VAR_KEYWORD] or [""]
        renamed = {o: n for o, n in RENAMED_KEYWORDS.items() if (keywords or n in usual) and o not in usual}

        @wraps(function)
        def call(*args: P.args, **kwargs: P.kwargs) -> R:
            for old, new in renamed.items():
                if old in kwargs and new not in kwargs:
                    message = f"{function.__name__}: {old}= is now {new}=; the old name will be removed"
                    warnings.warn(message, DeprecationWarning, stacklevel=2)
                    kwargs[new] = kwargs.pop(old)
            try:
                bound = signature.bind(*args, **kwargs)
            except TypeError:
                # A chain given twice, as the first argument and by name, is meant as a name of chains.
                used = signature.parameters.keys() - {*list(signature.parameters)[: len(args)]}
                for name in kwargs.keys() - used:
                    refuse_misplaced(function.__name__, name)
                raise
            for arguments in (bound.arguments, bound.arguments.get(keywords, {})):
                for name, check in checks.items():
                    if name in arguments and arguments[name] is not usual.get(name, inspect.Parameter.empty):
                        arguments[name] = check(arguments[name], name)
            return function(*bound.args, **bound.kwargs)

        return call

    return decorate


RENAMED_KEYWORDS = {"restraint": "restraints"}
"""New names of keywords by their former ones, which are accepted for one release."""


def refuse_misplaced(call: str, name: str) -> None:
    """Refuse an option that belongs to another call, with the name of this call. Ignore other options."""
    place = next((place for place, names in _OPTIONS_OF.items() if name in names.split()), None)
    if name == "chain" or place:
        takes = (
            f"{place.format(name)} takes it" if place else "pc.load(file, chains='A') reads chains of a file"
        )
        raise ProtochainError(f"{call} has no option {name!r}; {takes}")


_OPTIONS_OF = {
    "pc.load(file, {}=...)": "model assembly altloc keep disulfide ph strict chains ligands ligand_charges "
    "standard_residues cap",
    "pc.build_chain(structure, {}=...)": "hinges root move hydrogen_mass",
    "pc.energy(structure, {}=...)": "forcefield solvent salt engine device cutoff accuracy threads "
    "trust_forcefield system",
}
"""Options of a run that the functions with these options decide before it."""


def check_fields(of: Any, **checks: Check) -> None:
    """Check fields of a frozen dataclass in its ``__post_init__``, and set them to the checked values."""
    for name, check in checks.items():
        object.__setattr__(of, name, check(getattr(of, name), name))


def anything(value: Any, name: str) -> Any:
    """Return a value as it is. The code that uses it checks it."""
    return value


def number(value: Any, name: str) -> float:
    """Return a real number as it is."""
    if isinstance(value, Real) and not isinstance(value, bool):
        return value  # type: ignore[return-value]  # numpy's numbers, too
    raise refusal(name, brief(value), *_instead(value, "a number", name))


def acidity(value: Any, name: str) -> float:
    """Return a pH as it is."""
    if not 0.0 <= number(value, name) <= 14.0:
        raise ProtochainError(f"pH {value:g}: give a number from 0 to 14")
    return value


AUTO = "auto"
"""Name of a pH of 7 with pKa by PROPKA."""


def acidity_or_auto(value: Any, name: str) -> float | str:
    """Return a pH as it is, or ``auto``."""
    return AUTO if isinstance(value, str) and value == AUTO else acidity(value, name)


def number_in(text_or_number: str) -> float | str:
    """Return the number in a text, or the text if it has none."""
    try:
        return float(text_or_number)
    except ValueError:
        return text_or_number


def integer(value: Any, name: str) -> int:
    """Return a whole number as an int, also one that is given as 1e4."""
    if isinstance(value, Real) and not isinstance(value, bool) and float(value).is_integer():
        return int(value) if isinstance(value, Integral) else round(float(value))
    raise refusal(name, brief(value), *_instead(value, "a whole number", name))


def at_least(least: int) -> Check:
    """Check for a whole number of at least this size."""

    def check(value: Any, name: str) -> int:
        count = integer(value, name)
        if count < least:
            raise refusal(name, count, f"give at least {least}" if least else "give 0 or more")
        return count

    return check


def in_range(check: Check, allows: Callable[[float], bool], remedy: str, unit: str = "") -> Check:
    """Check further that a number is in the range of ``allows``, which is False of NaN."""

    def narrower(value: Any, name: str) -> Any:
        number_found = check(value, name)
        if not allows(number_found):
            raise refusal(name, f"{number_found:g}{unit and ' '}{unit}", remedy)
        return number_found

    return narrower


def quantity(unit: str) -> Check:
    """Check for a number, or a Quantity of OpenMM, which is converted: ``kelvin``, ``1/picosecond``."""

    def check(value: Any, name: str) -> float:
        return number(plain(value, unit, name), name)

    return check


def plain(value: Any, unit: str, name: str) -> Any:
    """Return the number or array of a Quantity of OpenMM in a unit, or any other value as it is."""
    if not hasattr(value, "value_in_unit"):
        return value
    # Its module is loaded, or there would be no Quantity; others need not import it.
    units = sys.modules["openmm.unit"]
    above, *below = (getattr(units, name) if name != "1" else units.dimensionless for name in unit.split("/"))
    product = above
    for divisor in below:
        product /= divisor
    try:
        return value.value_in_unit(product)
    except TypeError:
        raise ProtochainError(Argument(name), f" is in {value.unit}; give it in {unit}") from None


def optional(check: Check) -> Check:
    """Check that leaves None as it is."""
    return lambda value, name: None if value is None else check(value, name)


def cutoff_of(value: Any, name: str) -> Any:
    """Return a distance in nm, also from a text. Return "auto" as it is, None and "none" as no cutoff."""
    if value in ("auto", "none", None):
        return None if value == "none" else value
    try:
        distance = float(value) if isinstance(value, str) else float(number(value, name))
    except ValueError:
        distance = 0.0
    if not 0.0 < distance <= LONGEST_CUTOFF:
        raise refusal(name, brief(value), "give a distance in nm, auto, or none")
    if distance < SHORTEST_CUTOFF:
        remedy = f"is shorter than contacts between atoms; give {SHORTEST_CUTOFF:g} nm or more, or none"
        raise refusal(name, f"{distance:g} nm", remedy)
    return distance


def concentration(value: Any, name: str) -> float:
    """Return a concentration in mol/l from 0 to 10, also from a Quantity."""
    molar = number(plain(value, "mole/liter", name), name)
    # A saturated solution of NaCl has 6 mol/l. Larger numbers are usually in mmol/l.
    if not 0.0 <= molar <= 10.0:
        raise refusal(name, f"{molar:g}", "give a concentration in mol/l, from 0 to 10")
    return float(molar)


def accuracy_of(value: Any, name: str) -> Any:
    """Return an RMS error of forces in kJ/mol/nm, also from a text, or "auto", or "exact"."""
    if value in ("auto", "exact"):
        return value
    try:
        error = float(value) if isinstance(value, str) else float(number(value, name))
    except ValueError:
        error = 0.0
    if 0.0 < error < float("inf"):
        return error
    raise refusal(name, brief(value), "give an RMS error of the forces in kJ/mol/nm, auto, or exact")


LONGEST_CUTOFF = 1e6
"""nm. Structures are smaller, and reaction fields cube it."""
SHORTEST_CUTOFF = 0.5
"""nm. Atoms three bonds apart, which every cutoff includes, and the minima of all Lennard-Jones pairs (0.4 of
two sulphurs) lie within, and so do the neighbours that make most of a Born radius. Below, energies mean
nothing: forces on Trp-cage are off by an eighth at 0.5, a quarter at 0.4, two thirds at 0.3, all at 0.1."""


def text(value: Any, name: str) -> str:
    """Return a text as it is."""
    if isinstance(value, str):
        return value
    raise refusal(name, brief(value), "give a text")


def refuse_unknown(value: str, name: str, choices: Iterable[str]) -> None:
    """Refuse a word that is not among those known."""
    if value not in (names := [*choices]):
        from difflib import get_close_matches  # needed here alone

        near = get_close_matches(value, names, 5, 0.0)
        listed = f"{len(names)} names, as {', '.join(near)}" if len(names) > 12 else ", ".join(names)
        raise ProtochainError(Argument(name), f" {excerpt(value)!r} is not known; choose from {listed}")


def one_of(choices: Iterable[str]) -> Check:
    """Check for one of some words."""

    def check(value: Any, name: str) -> str:
        refuse_unknown(text(value, name), name, choices)
        return str(value)

    return check


def selection(value: Any, name: str) -> str:
    """Return a text that selects atoms."""
    if text(value, name).strip():
        return str(value)
    raise refusal(name, brief(value), "selects nothing; give a selection, as 'resid 5:20', or all")


def flag(value: Any, name: str) -> bool:
    """Return True or False as a bool."""
    if isinstance(value, bool) or type(value).__name__ in ("bool_", "bool"):
        return bool(value)
    raise refusal(name, brief(value), "give True or False")


def path(value: Any, name: str) -> Path:
    """Return the path of a file."""
    try:
        return Path(value)
    except TypeError:
        raise refusal(name, brief(value), "give the path of a file") from None


def file_name(value: Any, name: str) -> str:
    """Return a name, or the path of a file as text."""
    return text(str(value) if isinstance(value, Path) else value, name)


def sequences(value: Any, name: str) -> str:
    """Letters of chains, with ``/`` between and ``NAME=`` before, of a text like that or of a FASTA file.

    Records are chains, or designs of all chains. ``FILE#chains`` and ``FILE#designs`` state which, and
    ``FILE#2`` is the second design. Without a statement, records with titles of ProteinMPNN or LigandMPNN are
    designs, and so are records with ``/`` or ``:`` between chains. Records of different lengths, or with
    names of chains, are chains. All others are refused. The name of a file of several designs stays:
    :func:`designs` reads it.
    """
    specification = text(str(value) if isinstance(value, Path) else value, name).strip()
    file, part = _file_and_part(specification)
    if designs(specification):
        return specification
    if file:
        specification = _read_fasta(file, part, name)
    if specification and not re.fullmatch(r"(\w*=)?[A-Z-]+(/(\w*=)?[A-Z-]+)*", specification.upper()):
        raise refusal(name, brief(value), "give a FASTA file, or letters, with / between chains")
    entries = (entry.rpartition("=") for entry in specification.split("/"))
    return "/".join(f"{of}{sign}{letters.upper()}" for of, sign, letters in entries)


def _file_and_part(specification: str) -> tuple[Path | None, str]:
    """FASTA file, and ``chains``, ``designs`` or the number of a record after ``#``."""
    names = specification, *specification.rpartition("#")[::2]
    is_file = [0 < len(name) < 256 and Path(name).is_file() for name in names[:2]]
    if is_file[0]:
        return Path(specification), ""
    is_part = names[2].isdecimal() or names[2] in (_CHAINS, _DESIGNS)
    return (Path(names[1]), names[2]) if is_file[1] and is_part else (None, "")


def designs(specification: str, of_backbone: bool = True) -> list[tuple[str, str]]:
    """Unique names and sequences of the designs of a FASTA file, of one backbone more than one, or none."""
    file, part = _file_and_part(specification)
    records = _records(file) if file else []
    is_stated = part == _DESIGNS or (not part and _are_designs(records))
    if of_backbone and not (is_stated and len(records) > 1):
        return []
    names, used = dict[str, str](), set[str]()
    for number, (head, letters) in enumerate(records, 1):
        # Programs number designs: x, id=3, or sample=3. Names are parts of names of files.
        stem = "" if "=" in (first := re.split(r"[\s,]", head)[0]) else re.sub(r"[^\w.-]+", "_", first)
        stem = stem.strip(".")[:_LONGEST_NAME]
        counter = re.search(r"\b(sample|id)=(\d+)", head)
        name = f"{stem or counter[1]}_{counter[2]}" if counter else stem or str(number)
        while name.lower() in used:  # Some file systems ignore case.
            name += f"_{number}"
        used.add(name.lower())
        names[name] = "/".join(letters)
    return list(names.items())


def _records(file: Path) -> list[tuple[str, list[str]]]:
    """Title and chains of each record of a FASTA file."""
    content = file.read_text(encoding="utf-8-sig", errors="replace")
    # ProteinMPNN names the designed chains once, and writes only their letters.
    names = re.findall(r"'(\w+)'", next(iter(re.findall(r"designed_chains=\[([^\]]*)", content)), ""))
    records = []
    for head, body in re.findall(r"(?m)^(?:>(.*))?((?:\n?[^>\n]*$)*)", content):
        if letters := "".join(body.upper().split()).strip("/:*"):
            chains = re.split("[/:]", letters)
            if len(chains) == len(names):
                chains = [f"{name}={chain}" for name, chain in zip(names, chains, strict=True)]
            records.append((head.strip(), chains))
    return records


def _are_designs(records: list[tuple[str, list[str]]]) -> bool | None:
    """Whether records are alternatives, not the chains of one structure. None if both are possible."""
    if any(_DESIGN.search(head) for head, _ in records):
        return True
    if len(records) < 2 or all(len(letters) > 1 for _, letters in records):
        return len(records) > 1
    is_alike = len({tuple(map(len, letters)) for _, letters in records}) == 1
    has_names = any(len(re.split(r"[\s,|]", head)[0]) > _LONGEST_CHAIN_NAME for head, _ in records)
    return None if is_alike and has_names else False


def _read_fasta(file: Path, part: str, name: str) -> str:
    """Sequences of a FASTA file, or of one of its designs, counted from 1."""
    records = _records(file)
    if part.isdecimal() and not 0 < int(part) <= len(records):
        raise refusal(name, brief(f"{file}#{part}"), choose_record(str(file)))
    is_stated = part == _DESIGNS or (not part and _are_designs(records))
    if part.isdecimal() or (records and is_stated):
        return "/".join(records[int(part) - 1 if part.isdecimal() else 0][1])
    if not part and is_stated is None:
        kinds = f"{file}#{_CHAINS} or {file}#{_DESIGNS}"
        raise refusal(name, brief(str(file)), f"its records may be chains or designs; give {kinds}")
    chains = [(re.match(r"\w*", head), letters) for head, letters in records]
    return "/".join(
        f"{of[0]}={chain}" if of and of[0] and len(letters) == 1 else chain
        for of, letters in chains
        for chain in letters
    )


def choose_record(specification: str) -> str:
    """Remedy for a FASTA file with several designs, if there can be only one."""
    file = _file_and_part(specification)[0] or Path(specification)
    n = len(_records(file))
    return f"has {n} records; choose one as {file}#{n}"


_CHAINS, _DESIGNS = "chains", "designs"
_LONGEST_CHAIN_NAME = 4
_LONGEST_NAME = 100  # Characters of the name of a design. Names of files have at most 255 bytes.
_DESIGN = re.compile(r"\b(sample|score|global_score|seq_rec\w*|overall_confidence|num_res)=")
"""What ProteinMPNN and LigandMPNN write above each design."""


def force_field_parts(spec: str) -> list[str]:
    """Names and paths of a force field that is given in parts, with commas between."""
    return [spec] if Path(spec).exists() else [name.strip() for name in spec.split(",") if name.strip()]


NO_BONDS: Literal["none"] = "none"
"""Word that drops the bonds that are found."""

Bond = tuple[str, str] | Literal["none"]
"""Two places, as ``("A:3", "A:40")``, or a single word."""


def bonds(value: Any, name: str) -> tuple[Bond, ...]:
    """Read bonds, ``("A:3", "A:40")``, ``"none"``, ``"A:3-A:40"``, with commas between. Refuse empty ones."""
    if value is None:
        return ()
    entries = [value] if isinstance(value, str) else value
    if not isinstance(entries, Iterable):
        raise refusal(name, brief(value), "give pairs, as [('A:3', 'A:40')]")
    bonds = [bond for entry in entries for bond in (words(entry) if isinstance(entry, str) else [entry])]
    read = tuple(bond if bond == NO_BONDS else _pair(bond, name) for bond in bonds)
    if not read:
        remedy = "names no bond; remove it, or ", Argument(name, NO_BONDS), " drops those found"
        raise refusal(name, brief(value), *remedy)
    return read


def _pair(bond: Any, name: str) -> tuple[str, str]:
    """Read ``A:3-A:40``, with numbers that may be negative, or a pair of places."""
    if isinstance(bond, str):
        matches = re.fullmatch(r"(\S*:-?\d+\w?)-(\S*:-?\d+\w?)", bond)
        if matches:
            return matches[1], matches[2]
    elif isinstance(bond, tuple | list) and len(bond) == 2 and all(isinstance(end, str) for end in bond):
        return bond[0], bond[1]
    raise refusal(name, brief(bond), "give chain:number-chain:number, as A:3-A:40")


CHARGE_RULES = ("nagl", "mmff94", "gasteiger")
"""Methods for the charges of ligands, in addition to a file."""


def charges_of_ligands(value: Any, name: str) -> str:
    """Return a rule for charges, or the path of a file of them, as text."""
    if file_name(value, name) in CHARGE_RULES or Path(value).is_file():
        return str(value)
    raise refusal(name, brief(value), f"is not a file; give one, or {' or '.join(CHARGE_RULES)}")


LigandSource = tuple[str, str]
"""Name of a residue, or none for an additional molecule, with SMILES or the path of a file."""
MOLECULE_SUFFIXES = (".sdf", ".mol", ".mol2")
"""Of files with small molecules."""


def file_and_record(specification: str | Path) -> tuple[Path, int]:
    """File and number of its molecule in ``FILE.sdf#2``. The number is 0 if the text has none."""
    file, sign, number = str(specification).rpartition("#")
    is_record = sign and number.isdecimal() and file.lower().endswith(MOLECULE_SUFFIXES)
    return (Path(file), int(number)) if is_record else (Path(str(specification)), 0)


def ligands(value: Any, name: str) -> tuple[LigandSource, ...]:
    """Read sources of ligands: a mapping, or one or several of ``NAME=FILE``, ``NAME=SMILES``, ``FILE``."""
    if value is None:
        return ()
    if isinstance(value, Mapping):
        value = [*value.items()]
    elif isinstance(value, str | Path):
        value = [value]
    if not isinstance(value, Iterable):
        raise refusal(name, brief(value), "give names and molecules, as {'LIG': 'ligand.sdf'}")
    read = tuple(_ligand(ligand, name) for ligand in value)
    codes = [code for code, _ in read if code]
    twice = next((code for code in codes if codes.count(code) > 1), None)
    if twice:
        raise refusal(name, repr(twice), "occurs twice; give one molecule for each name")
    return read


def _ligand(value: Any, name: str) -> LigandSource:
    last = str(value[-1] if isinstance(value, tuple | list) and value else value).rpartition("=")[2]
    if last.lower().endswith(".pdbqt"):
        to = last[: -len("pdbqt")] + "sdf"
        remedy = f"convert it: mk_export.py {last} -s {to}, or obabel {last} -O {to}"
        raise refusal(name, brief(value), remedy)
    if isinstance(value, tuple | list) and len(value) == 2:
        residue_name, source = value
    else:
        residue_name, source = "", value
        file, _ = file_and_record(value)
        is_file = file.suffix.lower() in MOLECULE_SUFFIXES
        before, sign, after = str(value).partition("=")
        has_name = sign and re.fullmatch(r"[A-Za-z0-9+-]{1,5}", before)
        if has_name and not (is_file and file.exists()):  # ./a=b.sdf is a file.
            residue_name, source = before, after
        elif not is_file and not Path(str(value)).is_dir():
            raise refusal(name, brief(value), f"give NAME=SMILES, NAME=FILE, or a file of {_SUFFIXES}")
    if isinstance(residue_name, str) and isinstance(source, str | Path) and str(source).strip():
        return residue_name.strip().upper(), str(source).strip()
    raise refusal(name, brief(value), "give a name and a file or SMILES, as LIG=ligand.sdf")


_SUFFIXES = ", ".join(MOLECULE_SUFFIXES)


def ends(value: Any, name: str) -> tuple[str, str]:
    """Read two places: ``("A:1:N", "A:20:C")``, ``"A:1:N-A:20:C"``, or any two with `` - `` between."""
    if isinstance(value, str):
        matches = re.fullmatch(rf"({_PLACE})-({_PLACE})", value.strip())
        parts = tuple(part.strip() for part in value.split(" - "))
        read = matches.groups() if matches else parts
    else:
        read = tuple(value) if isinstance(value, tuple | list) else ()
    if len(read) == 2 and all(isinstance(end, str) and end.strip() for end in read):
        return read[0].strip(), read[1].strip()
    raise refusal(name, brief(value), "give two atoms, as A:1:N-A:20:C, or two selections with ' - ' between")


_PLACE = r"\S*?:-?\d+\w?(?::[^\s:]+?)?"  # A residue, or an atom of it.


def words(value: str | Iterable[str], name: str = "keep") -> tuple[str, ...]:
    """Split a text at its commas. Return a sequence of words as it is."""
    split = value.split(",") if isinstance(value, str) else _texts(value, name)
    return tuple(word.strip() for word in split if word.strip())


def several(value: Any, name: str) -> tuple[Any, ...]:
    """Return a sequence of anything as a tuple. Split a text at its commas, wrap a single object."""
    if isinstance(value, str):
        return words(value, name)
    return tuple(value) if isinstance(value, Iterable) else (value,)


def kinds(value: str | Iterable[str], name: str) -> str:
    """Return words, given as one text or as a sequence, as one text with blanks between."""
    return " ".join(re.split(r"[,\s]+", value.strip()) if isinstance(value, str) else _texts(value, name))


def function(*parameters: str) -> Check:
    """Check for a callable of parameters with these names in the message. None stays as it is."""

    def check(value: Any, name: str) -> Any:
        if value is None or (callable(value) and _takes(value, len(parameters))):
            return value
        value_text = getattr(value, "__qualname__", None) or brief(value)
        raise refusal(name, value_text, f"give a callable of {', '.join(parameters)}")

    return check


WATCHER = function("row", "x")
"""Check for a callable that receives each row of a log and its positions."""


def instance(kind: type, remedy: str) -> Check:
    """Check for an object of a class. ``remedy`` describes how to make one."""

    def check(value: Any, name: str) -> Any:
        if isinstance(value, kind):
            return value
        raise refusal(name, brief(value), f"give a {kind.__name__}, for example from {remedy}")

    return check


def following(protocol: type, *names: str) -> Check:
    """Check for a user's object with the attributes of a protocol."""

    def check(value: Any, name: str) -> Any:
        refuse_class(value, name)
        members = {n: getattr(protocol, n) for n in names}
        present = {n for n in names if hasattr(value, n) and getattr(type(value), n, None) is not members[n]}
        if lacking := [n for n in names if n not in present]:
            raise ProtochainError(
                f"{name} {type(value).__name__}: has no {', '.join(lacking)}; a {protocol.__name__} has "
                f"{', '.join(names)}: python.md, 'Methods, restraints and energies of your own'"
            )
        return value

    return check


def refuse_class(value: Any, name: str) -> None:
    """Refuse a class in place of its instance."""
    if isinstance(value, type):
        raise ProtochainError(f"{name} {value.__name__}: is a class; give an object, as {value.__name__}()")


def _texts(value: Any, name: str) -> list[str]:
    items = list(value) if isinstance(value, Iterable) else [value]
    strange = next((item for item in items if not isinstance(item, str)), None)
    if strange is not None or not isinstance(value, Iterable):
        raise refusal(name, brief(value), "give words, as one text or a list")
    return items


def _takes(value: Any, n: int) -> bool:
    try:
        inspect.signature(value).bind(*[None] * n)
    except TypeError:
        return False
    except ValueError:  # Some callables that are not of Python have no signature.
        return True
    return True


def brief(value: Any) -> str:
    """Return a short text of a value for a message, on one line."""
    stated = " ".join(repr(value).split())
    return stated if len(stated) <= 60 else f"of type {type(value).__name__}"


def _instead(value: Any, remedy: str, name: str) -> tuple[object, ...]:
    """Valid values to replace an invalid one. Numbers in a text are shown without their quotes."""
    bare = value.strip() if isinstance(value, str) else ""
    try:
        float(bare)
    except ValueError:
        return (f"give {remedy}",)
    return f"give {remedy}, not a text: ", Argument(name), f"={bare}"
