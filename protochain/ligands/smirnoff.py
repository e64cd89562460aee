"""Force fields of the Open Force Field Initiative (.offxml): read, and given to a molecule.

The last rule whose pattern fits wins (Mobley et al., J. Chem. Theory Comput. 14:6076, 2018). Files may be
untrusted: they are plain XML of bounded size, and a pattern parses quantities.
"""

import math
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from protochain.core.arrays import Floats, Value, read_only
from protochain.core.errors import Argument, ForceFieldError
from protochain.core.graph import neighbours
from protochain.core.optional_libraries import library
from protochain.core.storage import regular
from protochain.ligands.energy import Parameters, Term
from protochain.ligands.molecule import Molecule, in_mdl_aromaticity, quietly

SAGE_2_2, SAGE_2_3 = (
    Path(__file__).with_name(f"openff_unconstrained-{version}.offxml") for version in ("2.2.1", "2.3.0")
)
"""Sage: Boothroyd et al., J. Chem. Theory Comput. 19:3251 (2023). CC BY 4.0, see NOTICE."""
_LARGEST = 10_000_000  # Bytes. Sage has 100 000.
_MOST_MATCHES = 1_000_000
_LENGTH, _SPRING, _PER_ANGLE, _ENERGY, _ANGLE = (1, 0, 0), (-2, 1, -1), (0, 1, -1), (0, 1, -1), (0, 0, 0)
"""Powers of length, energy and mole. Angles have no dimension."""
_UNITS = {
    "angstrom": (0.1, _LENGTH),
    "nanometer": (1.0, _LENGTH),
    "kilocalorie": (4.184, (0, 1, 0)),
    "kilojoule": (1.0, (0, 1, 0)),
    "mole": (1.0, (0, 0, 1)),
    "kilocalorie_per_mole": (4.184, _ENERGY),
    "kilojoule_per_mole": (1.0, _ENERGY),
    "degree": (math.pi / 180.0, _ANGLE),
    "radian": (1.0, _ANGLE),
}
_QUANTITY = re.compile(
    r"\s*([-+]?[\d.]+(?:[eE][-+]?\d+)?)\s*((?:[*/]\s*[a-z_]+\s*(?:\*\*\s*-?\d\s*)?)*)", re.ASCII
)
_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?", re.ASCII)
_FACTOR = re.compile(r"([*/])\s*([a-z_]+)\s*(?:\*\*\s*(-?\d))?")


@dataclass(frozen=True)
class Rule(Value):
    """One line of a force field: a pattern with numbered atoms, and its parameters in nm, kJ/mol and rad."""

    name: str
    smirks: str
    values: tuple[tuple[float, ...], ...] = ()


@dataclass(frozen=True)
class ForceField(Value):
    """Rules of a file."""

    path: Path
    # By section; of sections that are not handled, only name and pattern.
    rules: Mapping[str, tuple[Rule, ...]]
    scale_lj: float  # Factors of pairs three bonds apart.
    scale_coulomb: float


def read(path: Path) -> ForceField:
    """Read an .offxml file, or one that comes with the package, by its name."""
    if not path.exists() and str(path) in (SAGE_2_2.name, SAGE_2_3.name):
        path = SAGE_2_2.with_name(path.name)
    root = _root(path)
    if root.tag != "SMIRNOFF":
        raise ForceFieldError(f"{path}: is no SMIRNOFF force field; give an .offxml file")
    _require(path, root, aromaticity_model="OEAroModel_MDL")
    rules: dict[str, tuple[Rule, ...]] = {}
    scales = {"vdW": 0.5, "Electrostatics": 0.8333333333}
    for section in root:
        _require(path, section, **_FORMS.get(section.tag, {}))
        if section.tag in scales:
            scales[section.tag] = _quantity(path, section, "scale14", _ANGLE)
        values = _VALUES.get(section.tag)
        rules[section.tag] = tuple(
            Rule(
                f"{row.tag} {row.get('id', number)}",
                row.attrib["smirks"],
                tuple(values(path, row)) if values else (),
            )
            for number, row in enumerate(section, 1)
            if "smirks" in row.attrib
        )
    if not rules.get("vdW"):
        raise ForceFieldError(f"{path}: has no vdW parameters; give a whole force field")
    return ForceField(path, rules, scales["vdW"], scales["Electrostatics"])


def assign_parameters(
    molecule: Molecule, force_field: ForceField, charges: Callable[[Molecule], Floats], own_charges: bool
) -> Parameters:
    """Assign the parameters of a force field to a molecule."""
    typing = _Typing(molecule, force_field)
    if force_field.path in (SAGE_2_2, SAGE_2_3):
        typing.refuse_crowded()
    typing.refuse_unhandled({"LibraryCharges"} if own_charges else set())
    types = typing.fit("vdW", lambda atoms: atoms, ((i,) for i in range(molecule.n_atoms)))
    bonds = typing.fit("Bonds", _one_way, map(tuple, molecule.bonds.tolist()))
    # Both sulphurs of a dithiophosphate end at P alike, only one is drawn with a double bond.
    for sulphur, phosphorus, second in typing.matches(_DITHIOPHOSPHATE, 3):
        bonds[_one_way((sulphur, phosphorus))] = bonds[_one_way((second, phosphorus))]
    angles = typing.fit("Angles", _one_way, typing.angles())
    torsions = typing.fit("ProperTorsions", _one_way, typing.torsions())
    rows = [(*atoms, *row) for atoms, rule in torsions.items() for row in rule.values]
    for (i, centre, j, k), rule in typing.fit("ImproperTorsions", _sort_outer, ()).items():
        # The trefoil: three impropers about the centre, all in one sense of rotation.
        for outer in ((i, j, k), (j, k, i), (k, i, j)):
            rows.extend((centre, *outer, *row) for row in rule.values)
    sigma, epsilon = np.array([types[(i,)].values[0] for i in range(molecule.n_atoms)]).T
    return Parameters(
        _term([(*atoms, *rule.values[0]) for atoms, rule in bonds.items()], 2, 2),
        _term([(*atoms, *rule.values[0]) for atoms, rule in angles.items()], 3, 2),
        _term(rows, 4, 3),
        read_only(charges(molecule)), read_only(sigma), read_only(epsilon),
        force_field.scale_lj, force_field.scale_coulomb,
    )  # fmt: skip


_DITHIOPHOSPHATE = Rule("dithiophosphate", "[#16X1-:1]-[#15X4:2]=[#16X1:3]")
Atoms = tuple[int, ...]


class _Typing:
    """Matches of the patterns of a force field in one molecule."""

    def __init__(self, molecule: Molecule, force_field: ForceField) -> None:
        self.molecule, self.force_field = molecule, force_field
        self.chem = library("rdkit.Chem")
        self.mol = in_mdl_aromaticity(molecule)
        self.near = neighbours(molecule.bonds, molecule.n_atoms)

    def fit(self, section: str, key: Callable[[Atoms], Atoms], targets: Iterable[Atoms]) -> dict[Atoms, Rule]:
        """The last rule that fits, by atoms. Raise ForceFieldError if target atoms have none."""
        rules = self.force_field.rules.get(section, ())
        assigned = {key(atoms): rule for rule in rules for atoms in self.matches(rule, _ATOMS[section])}
        for atoms in targets:
            if key(atoms) not in assigned:
                raise self._lacks(section, "-".join(self.molecule.names[i] for i in atoms))
        return assigned

    def _lacks(self, section: str, atoms: str) -> ForceFieldError:
        return ForceFieldError(
            f"{self.molecule.source}: {self.force_field.path.name} has no {section} for {atoms}; "
            "give a force field that has as ", Argument("forcefield"),
        )  # fmt: skip

    def matches(self, rule: Rule, n: int = 0) -> set[Atoms]:
        query = quietly(self.chem.MolFromSmarts, rule.smirks)
        place = f"{self.force_field.path}: {rule.name}"
        atoms = query.GetAtoms() if query is not None else ()
        numbers = {atom.GetAtomMapNum(): atom.GetIdx() for atom in atoms if atom.GetAtomMapNum()}
        if query is None or (n and sorted(numbers) != [*range(1, n + 1)]):
            problem = f"is no SMIRKS pattern of {n} atoms" if n else "is no SMIRKS pattern"
            raise ForceFieldError(f"{place}: {rule.smirks[:60]!r} {problem}; mend it")
        tagged = [numbers[number] for number in sorted(numbers)]
        hits = self.mol.GetSubstructMatches(
            query, uniquify=False, useChirality=True, maxMatches=_MOST_MATCHES
        )
        if len(hits) == _MOST_MATCHES:
            raise ForceFieldError(f"{place}: fits {self.molecule.source} too often; make it more specific")
        return {tuple(match[i] for i in tagged) for match in hits}

    def refuse_crowded(self) -> None:
        """Refuse an atom with five or six neighbours: Sage has one angle for them, near 109 degrees."""
        for i, around in enumerate(self.near):
            if len(around) > 4:
                raise self._lacks("Angles", f"{self.molecule.names[i]} with {len(around)} neighbours")

    def refuse_unhandled(self, allowed: set[str]) -> None:
        """Other sections may be there, but none of their patterns may fit this molecule."""
        for section, rules in self.force_field.rules.items():
            for rule in () if section in {*_VALUES, *_CHARGE_MODELS, *allowed} else rules:
                for atoms in self.matches(rule):
                    names = ", ".join(self.molecule.names[i] for i in atoms)
                    remedy = (
                        ("give a file of charges as ", Argument("charges")) if section == "LibraryCharges"
                        else ("give another force field as ", Argument("forcefield"))
                    )  # fmt: skip
                    raise ForceFieldError(
                        f"{self.molecule.source}: {section} ({rule.name}) of {self.force_field.path.name} "
                        f"fits {names}, and is not handled; ", *remedy,
                    )  # fmt: skip

    def angles(self) -> Iterator[Atoms]:
        for centre, around in enumerate(self.near):
            yield from ((i, centre, j) for i in around for j in around if i < j)

    def torsions(self) -> Iterator[Atoms]:
        for i, j in self.molecule.bonds.tolist():
            ends = ((a, b) for a in self.near[i] for b in self.near[j])
            yield from ((a, i, j, b) for a, b in ends if len({a, i, j, b}) == 4)


def _one_way(atoms: Atoms) -> Atoms:
    """Atoms in the direction with the smaller first atom."""
    return atoms if atoms[0] < atoms[-1] else atoms[::-1]


def _sort_outer(atoms: Atoms) -> Atoms:
    """Atoms of an improper, the outer three sorted."""
    first, third, fourth = sorted((atoms[0], *atoms[2:]))
    return first, atoms[1], third, fourth


def _term(rows: list[tuple[float, ...]], n_atoms: int, n_parameters: int) -> Term:
    table = np.array(rows, dtype=float).reshape(-1, n_atoms + n_parameters)
    return Term(read_only(table[:, :n_atoms], np.int64), read_only(table[:, n_atoms:]))


def _root(path: Path) -> ElementTree.Element:
    try:
        if regular(path).stat().st_size > _LARGEST:
            raise ForceFieldError(f"{path}: is too large for a force field; give an .offxml file")
        text = path.read_text(encoding="utf-8")
        if "<!DOCTYPE" in text:  # Entities could grow without bound.
            raise ForceFieldError(f"{path}: has a DOCTYPE, which no force field needs; remove it")
        return ElementTree.fromstring(text)
    except OSError as error:
        raise ForceFieldError(f"{path}: cannot be read ({error.strerror}); give an .offxml file") from None
    except (UnicodeDecodeError, ElementTree.ParseError) as error:
        raise ForceFieldError(f"{path}: is no XML ({error}); give an .offxml file") from None


_FORMS = {
    "Bonds": {"potential": "harmonic"},
    "Angles": {"potential": "harmonic"},
    "ProperTorsions": {"potential": "k*(1+cos(periodicity*theta-phase))"},
    "ImproperTorsions": {"potential": "k*(1+cos(periodicity*theta-phase))"},
    "vdW": {
        "potential": "Lennard-Jones-12-6", "combining_rules": "Lorentz-Berthelot", "scale12": "0.0",
        "scale13": "0.0", "scale15": "1.0",
    },
    "Electrostatics": {"scale12": "0.0", "scale13": "0.0", "scale15": "1.0"},
}  # fmt: skip


def _require(path: Path, node: ElementTree.Element, **expected: str) -> None:
    """Refuse a section with another meaning than the computed one. Absent attributes have usual values."""
    for name, value in expected.items():
        actual = node.get(name, value)
        if actual != value and not (name.startswith("scale") and _number(actual) == float(value)):
            raise ForceFieldError(
                f"{path}: {name} of <{node.tag}> is {actual[:60]!r}; only {value!r} is handled"
            )


def _number(text: str) -> float | None:
    return float(text) if _NUMBER.fullmatch(text.strip()) else None


def _quantity(path: Path, node: ElementTree.Element, name: str, dimension: tuple[int, int, int]) -> float:
    """An attribute as ``0.5 * kilocalorie_per_mole / angstrom ** 2``, in nm, kJ/mol and rad."""
    text = node.get(name, "")
    place = f"{path}: {name} of <{node.tag}> {node.get('id', node.get('smirks', ''))[:60]}"
    read = _QUANTITY.fullmatch(text)
    value = _number(read[1]) if read else None
    if read is None or value is None:
        raise ForceFieldError(f"{place} is {text[:60]!r}, not a number with its unit; mend it")
    powers = np.zeros(3, dtype=int)
    for sign, plural, exponent in _FACTOR.findall(read[2]):
        unit = re.sub(r"s(?=_|$)", "", plural)
        if unit not in _UNITS:
            raise ForceFieldError(f"{place}: the unit {plural!r} is unknown; give one of {', '.join(_UNITS)}")
        power = int(exponent or 1) * (1 if sign == "*" else -1)
        factor, dimensions = _UNITS[unit]
        value *= factor**power
        powers += power * np.array(dimensions)
    if tuple(powers) != dimension or not math.isfinite(value):
        raise ForceFieldError(f"{place} is {text[:60]!r}, which has another dimension or no size; mend it")
    return value


Rows = Iterator[tuple[float, ...]]


def _bond(path: Path, row: ElementTree.Element) -> Rows:
    yield _quantity(path, row, "length", _LENGTH), _quantity(path, row, "k", _SPRING)


def _angle(path: Path, row: ElementTree.Element) -> Rows:
    yield _quantity(path, row, "angle", _ANGLE), _quantity(path, row, "k", _PER_ANGLE)


def _torsion(path: Path, row: ElementTree.Element) -> Rows:
    for number in [name.removeprefix("periodicity") for name in row.attrib if name.startswith("periodicity")]:
        if row.tag == "Improper":  # The default, "auto", shares the barrier among the three.
            row.attrib.setdefault(f"idivf{number}", "3.0")
        periodicity, phase, divisor = (
            _quantity(path, row, f"{name}{number}", _ANGLE) for name in ("periodicity", "phase", "idivf")
        )
        if divisor <= 0.0 or periodicity % 1.0:
            place = f"{path}: <{row.tag}> {row.get('id')}"
            raise ForceFieldError(f"{place} has a strange idivf or periodicity; mend it")
        yield periodicity, phase, _quantity(path, row, f"k{number}", _ENERGY) / divisor


def _vdw(path: Path, row: ElementTree.Element) -> Rows:
    if "sigma" in row.attrib:
        sigma = _quantity(path, row, "sigma", _LENGTH)
    else:
        sigma = _quantity(path, row, "rmin_half", _LENGTH) * 2.0 ** (5 / 6)
    epsilon = _quantity(path, row, "epsilon", _ENERGY)
    if sigma < 0.0 or epsilon < 0.0:
        raise ForceFieldError(f"{path}: <Atom> {row.get('id')} has a negative radius or well; mend it")
    yield sigma, epsilon


_VALUES: dict[str, Callable[[Path, ElementTree.Element], Rows]] = {
    "Bonds": _bond, "Angles": _angle, "ProperTorsions": _torsion, "ImproperTorsions": _torsion, "vdW": _vdw,
}  # fmt: skip
_ATOMS = {"vdW": 1, "Bonds": 2, "Angles": 3, "ProperTorsions": 4, "ImproperTorsions": 4}
_CHARGE_MODELS = {"ToolkitAM1BCC", "ChargeIncrementModel", "NAGLCharges", "Electrostatics"}
"""Sections in whose place the charges are that the caller names."""
