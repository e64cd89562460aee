"""Parts of recipes for structure files: bases, geometry, changes of structures, habits of writers.

A recipe returns what a file means, as a gemmi structure, and the file itself, as text or bytes.
"""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import gemmi
import numpy as np

ROOT = Path(__file__).parents[1]
SAMPLES = ROOT / "structures"
SHARED = ROOT.parent / "shared"
MORE, COMPLEXES = SHARED / "structures", SHARED / "complexes"

Content = str | bytes
Build = Callable[[], gemmi.Structure]
Write = Callable[[gemmi.Structure], Content]


# --- bases -------------------------------------------------------------------------------------------------


@cache
def read_file(path: Path) -> gemmi.Structure:
    try:
        structure = gemmi.read_structure(str(path), merge_chain_parts=True)
    except RuntimeError:  # Entry names in the last columns of old files.
        lines = (line[:66] if is_atom(line) else line for line in path.read_text().splitlines())
        structure = gemmi.read_pdb_string("\n".join(lines))
        structure.merge_chain_parts()
    structure.setup_entities()
    return structure


def sample(name: str, hydrogens: bool = False, waters: bool = False, more: bool = False) -> gemmi.Structure:
    """A copy of a sample, one model, without alternate locations, hydrogens and waters."""
    folder = MORE if more else SAMPLES
    out = read_file(folder / (name if "." in name else f"{name}.pdb")).clone()
    while len(out) > 1:
        del out[-1]
    out.remove_alternative_conformations()
    if not hydrogens:
        out.remove_hydrogens()
    if not waters:
        out.remove_waters()
    out.remove_empty_chains()
    return out


def trp(hydrogens: bool = False) -> gemmi.Structure:
    """Trp-cage."""
    return sample("1l2y", hydrogens)


def of_shared(path: str, chains: str = "", keep: Callable[[gemmi.Residue], bool] | None = None) -> Build:
    """A build that reads a file of ../shared, some chains and residues of it."""

    def build() -> gemmi.Structure:
        out = read_file(SHARED / path).clone()
        while len(out) > 1:
            del out[-1]
        for model in out:
            for name in [c.name for c in model if chains and c.name not in chains.split(",")]:
                model.remove_chain(name)
            for chain in model:
                for i in reversed(range(len(chain))):
                    if keep and not keep(chain[i]):
                        del chain[i]
        out.remove_empty_chains()
        return out

    return build


def residue(structure: gemmi.Structure, number: int, chain: str = "") -> gemmi.Residue:
    chains = [c for c in structure[0] if not chain or c.name == chain]
    return next(r for c in chains for r in c if r.seqid.num == number)


def places(structure: gemmi.Structure) -> np.ndarray:
    return np.array([at.atom.pos.tolist() for at in structure[0].all()])


# --- geometry ----------------------------------------------------------------------------------------------


def grown(a: Iterable[float], b: Iterable[float], c: Iterable[float], r: float, theta: float, phi: float):
    """Place of an atom bonded to c: distance, angle b-c-atom, dihedral a-b-c-atom (degrees)."""
    a, b, c = (np.array(list(p)) for p in (a, b, c))
    theta, phi = np.radians([theta, phi])
    bc = (c - b) / np.linalg.norm(c - b)
    n = np.cross(b - a, bc)
    n /= np.linalg.norm(n)
    m = np.cross(n, bc)
    return c + r * (-np.cos(theta) * bc + np.sin(theta) * (np.cos(phi) * m + np.sin(phi) * n))


def beyond(at: Sequence[float], *others: Sequence[float], r: float) -> np.ndarray:
    """Place opposite to the bonds of an atom, as of the third neighbour in a plane."""
    at = np.array(at)
    away = -sum((np.array(o) - at) / np.linalg.norm(np.array(o) - at) for o in others)
    return at + r * away / np.linalg.norm(away)


def new_atom(name: str, element: str, at: Iterable[float], charge: int = 0) -> gemmi.Atom:
    made = gemmi.Atom()
    made.name, made.element, made.charge = name, gemmi.Element(element), charge
    made.occ, made.b_iso = 1.0, 20.0
    made.pos = gemmi.Position(*(round(float(value), 3) for value in at))
    return made


def new_residue(name: str, number: int, atoms: Iterable[gemmi.Atom], het: bool = True) -> gemmi.Residue:
    made = gemmi.Residue()
    made.name, made.seqid = name, gemmi.SeqId(number, " ")
    made.het_flag = "H" if het else "A"
    made.entity_type = gemmi.EntityType.NonPolymer if het else gemmi.EntityType.Polymer
    for each in atoms:
        made.add_atom(each)
    return made


def berth(structure: gemmi.Structure, x: np.ndarray, near: float = 3.4, turn: int = 0) -> np.ndarray:
    """Places x (n, 3) moved to the surface: no atom nearer than ``near``, and one not much farther."""
    there = places(structure)
    middle, k = there.mean(axis=0), 7 * turn + 3
    golden = np.pi * (3 - np.sqrt(5)) * k
    z = 1 - 2 * ((k * 0.137) % 1)
    out = np.array([np.sqrt(1 - z * z) * np.cos(golden), np.sqrt(1 - z * z) * np.sin(golden), z])
    x = x - x.mean(axis=0)
    for step in np.arange(0.0, 200.0, 0.1):
        placed = middle + x + step * out
        if np.linalg.norm(placed[:, None] - there[None], axis=2).min() >= near:
            return placed
    raise ValueError("no place found")


def with_chain(structure: gemmi.Structure, name: str, *residues: gemmi.Residue) -> gemmi.Structure:
    """Add residues in a chain of their own, or to one that is there."""
    chain = next((c for c in structure[0] if c.name == name), None)
    if chain is None:
        structure[0].add_chain(gemmi.Chain(name))
        chain = structure[0][name]
    for each in residues:
        chain.add_residue(each)
    return structure


def with_molecule(
    build: Build, name: str, atoms: Sequence[tuple[str, str, tuple[float, float, float]]], chain: str = "L",
    number: int = 501, charges: Mapping[str, int] | None = None, near: float = 3.4, turn: int = 0,
) -> Build:  # fmt: skip
    """A build with a small molecule at the surface."""

    def built() -> gemmi.Structure:
        out = build()
        x = berth(out, np.array([at for _, _, at in atoms]), near, turn)
        made = [
            new_atom(atom, element, at, (charges or {}).get(atom, 0))
            for (atom, element, _), at in zip(atoms, x, strict=True)
        ]
        return with_chain(out, chain, new_residue(name, number, made))

    return built


def with_ion(
    build: Build, name: str, atom: str, element: str, charge: int = 0, near: float = 2.4, **more
) -> Build:
    return with_molecule(
        build, name, [(atom, element, (0.0, 0.0, 0.0))], charges={atom: charge}, near=near, **more
    )


T = 1.49 / np.sqrt(3)
SULPHATE = [("S", "S", (0, 0, 0)), ("O1", "O", (T, T, T)), ("O2", "O", (T, -T, -T)), ("O3", "O", (-T, T, -T)),
            ("O4", "O", (-T, -T, T))]  # fmt: skip
PHOSPHATE = [("P", "P", (0, 0, 0)), *SULPHATE[1:]]
ACETATE = [("C", "C", (0, 0, 0)), ("O", "O", (1.22, 0.2, 0)), ("OXT", "O", (-0.55, 1.1, 0)),
           ("CH3", "C", (-0.75, -1.3, 0))]  # fmt: skip
GLYCEROL = [("C1", "C", (-1.25, 0.45, 0.1)), ("O1", "O", (-2.42, -0.34, 0.05)), ("C2", "C", (0.0, -0.41,
    0.0)),
            ("O2", "O", (0.0, -1.25, 1.15)), ("C3", "C", (1.25, 0.45, -0.1)), ("O3", "O", (2.42, -0.34,
                -0.05))]  # fmt: skip
BENZAMIDINE = [
    *((f"C{k + 1}", "C", (1.39 * np.cos(np.pi * k / 3), 1.39 * np.sin(np.pi * k / 3),
        0.0)) for k in range(6)),
    ("C", "C", (2.87, 0, 0)), ("N1", "N", (3.53, 1.14, 0)), ("N2", "N", (3.53, -1.14, 0)),
]  # fmt: skip
CHLOROPHENOL = [*BENZAMIDINE[:6], ("O1", "O", (2.75, 0, 0)), ("CL1", "Cl", (-3.13, 0, 0))]


def octahedron(r: float) -> list[tuple[float, float, float]]:
    return [tuple(s * r * e for e in axis) for axis in np.eye(3) for s in (1, -1)]  # type: ignore[misc]


def hydrated(build: Build, ion: str, element: str, r: float, charge: int = 2) -> Build:
    """A build with an ion in six waters, one of which touches the protein."""

    def built() -> gemmi.Structure:
        out = build()
        x = berth(out, np.array([(0.0, 0.0, 0.0), *octahedron(r)]), 2.8)
        with_chain(out, "I", new_residue(ion, 301, [new_atom(ion, element, x[0], charge)]))
        waters = [new_residue("HOH", 401 + k, [new_atom("O", "O", at)]) for k, at in enumerate(x[1:])]
        return with_chain(out, "W", *waters)

    return built


def chelated(name: str, number: int, oxygens: tuple[str, str], ion: str, element: str, r: float) -> Build:
    """A build with an ion between the two oxygens of a carboxylate."""

    def built() -> gemmi.Structure:
        out = sample(name)
        holder = residue(out, number)
        a, b = (np.array(holder[o][0].pos.tolist()) for o in oxygens)
        c = np.array(holder["CG" if holder.name == "ASP" else "CD"][0].pos.tolist())
        middle = (a + b) / 2
        out_of = (middle - c) / np.linalg.norm(middle - c)
        at = middle + out_of * np.sqrt(r**2 - np.linalg.norm(a - b) ** 2 / 4)
        return with_chain(out, "I", new_residue(ion, 301, [new_atom(ion, element, at, 2)]))

    return built


# --- writers -----------------------------------------------------------------------------------------------


def as_pdb(structure: gemmi.Structure) -> str:
    structure = structure.clone()
    structure.setup_entities()
    head = gemmi.PdbWriteOptions(
        atom_records=False, end_record=False, cryst1_record=structure.cell.is_crystal()
    )
    body = gemmi.PdbWriteOptions(minimal=True, cryst1_record=False, end_record=True)
    return str(structure.make_pdb_string(head)) + str(structure.make_pdb_string(body))


def as_bare_pdb(structure: gemmi.Structure) -> str:
    """Atoms, TER and END alone."""
    text = as_pdb(structure)
    return "".join(
        line for line in text.splitlines(True) if line.startswith(("ATOM", "HETATM", "TER", "END"))
    )


def as_cif(structure: gemmi.Structure) -> str:
    structure = structure.clone()
    structure.setup_entities()
    structure.assign_label_seq_id()
    document = structure.make_mmcif_document()
    return str(document.as_string(gemmi.cif.WriteOptions(gemmi.cif.Style.Pdbx)))


def then(write: Write, *changes: Callable[[str], Content]) -> Write:
    """A writer, and changes of its text."""

    def written(structure: gemmi.Structure) -> Content:
        text: Content = write(structure)
        for change in changes:
            text = change(text)  # type: ignore[arg-type]
        return text

    return written


def is_atom(line: str) -> bool:
    return line.startswith(("ATOM", "HETATM"))


def records(change: Callable[[str], str | None]) -> Callable[[str], str]:
    """A change of each atom record of a PDB file; None leaves it out."""

    def changed(text: str) -> str:
        lines = (change(line) if is_atom(line) else line for line in text.splitlines())
        return "".join(f"{line}\n" for line in lines if line is not None)

    return changed


def put(start: int, text: str) -> Callable[[str], str]:
    """A change of columns, the first being 1, of atom records."""
    return records(lambda line: line[: start - 1].ljust(start - 1) + text + line[start - 1 + len(text) :])


def four_letters(names: Mapping[str, str]) -> Callable[[str], str]:
    """Residue names of four letters in columns 18 to 21, by the name of three."""
    return records(lambda line: f"{line[:17]}{names.get(line[17:20], line[17:21]):4}{line[21:]}")


def lines_without(*starts: str) -> Callable[[str], str]:
    return lambda text: "".join(each for each in text.splitlines(True) if not each.startswith(starts))


def before_atoms(*lines: str) -> Callable[[str], str]:
    return lambda text: "".join(f"{line}\n" for line in lines) + text


def after(*lines: str) -> Callable[[str], str]:
    return lambda text: text.rstrip("\n") + "\n" + "".join(f"{line}\n" for line in lines)


def before_end(*lines: str) -> Callable[[str], str]:
    return lambda text: re.sub(r"(?m)^END\s*$", "\n".join((*lines, "END")), text, count=1)


def _body(text: str) -> str:
    """Atoms and TER, without the END record."""
    return lines_without("END")(text)


def cif_without(*categories: str) -> Callable[[str], str]:
    """mmCIF text without some categories, or items of atom_site."""

    def changed(text: str) -> str:
        document = gemmi.cif.read_string(text)
        block = document.sole_block()
        for name in categories:
            if name.endswith("."):
                block.find_mmcif_category(name).erase()
            elif block.find_loop(name):
                table = block.find_mmcif_category(name.split(".")[0] + ".")
                tags = [t for t in table.tags if t != name]
                rows = [list(row) for row in block.find(list(tags))]
                table.erase()
                loop = block.init_loop("", list(tags))
                for row in rows:
                    loop.add_row(row)
        return str(document.as_string(gemmi.cif.WriteOptions(gemmi.cif.Style.Pdbx)))

    return changed


def cif_with(category: str, tags: Sequence[str], rows: Sequence[Sequence[str]]) -> Callable[[str], str]:
    """mmCIF text with a further category before the atoms."""

    def changed(text: str) -> str:
        names = "".join(f"{category}{tag}\n" for tag in tags)
        values = "".join(" ".join(gemmi.cif.quote(v) for v in row) + "\n" for row in rows)
        at = text.index("loop_\n_atom_site.")
        return f"{text[:at]}loop_\n{names}{values}#\n{text[at:]}"

    return changed


# --- changes of structures ---------------------------------------------------------------------------------


def edited(build: Build, *changes: Callable[[gemmi.Structure], object]) -> Build:
    def built() -> gemmi.Structure:
        out = build()
        for change in changes:
            change(out)
        out.remove_empty_chains()
        return out

    return built


def renamed(residues: Mapping[str, str] | None = None, atoms: Mapping[str, Mapping[str, str]] | None = None):
    """Rename residues, and atoms by their residue's old name ('*' for all)."""

    def change(structure: gemmi.Structure) -> None:
        for chain in structure[0]:
            for r in chain:
                table = {**(atoms or {}).get("*", {}), **(atoms or {}).get(r.name, {})}
                for a in r:
                    a.name = table.get(a.name, a.name)
                r.name = (residues or {}).get(r.name, r.name)

    return change


def shifted_numbers(by: int):
    def change(structure: gemmi.Structure) -> None:
        for chain in structure[0]:
            for r in chain:
                r.seqid = gemmi.SeqId(r.seqid.num + by, r.seqid.icode)
        structure.connections = gemmi.ConnectionList([])

    return change


def chain_named(name: str, *others: str):
    """Rename chains, in order."""

    def change(structure: gemmi.Structure) -> None:
        structure.connections = gemmi.ConnectionList([])
        for chain, new in zip(structure[0], (name, *others), strict=False):
            chain.name = new

    return change


def without_atoms(test: Callable[[gemmi.Residue, gemmi.Atom], bool]):
    def change(structure: gemmi.Structure) -> None:
        for chain in structure[0]:
            for r in chain:
                for i in reversed(range(len(r))):
                    if test(r, r[i]):
                        del r[i]
            for i in reversed(range(len(chain))):
                if not len(chain[i]):
                    del chain[i]

    return change


def without_residues(*numbers: int):
    return without_atoms(lambda r, a: r.seqid.num in numbers)


def in_chain(name: str, test: Callable[[gemmi.Residue, gemmi.Atom], bool]):
    """Take atoms out of one chain."""

    def change(structure: gemmi.Structure) -> None:
        for r in structure[0][name]:
            for i in reversed(range(len(r))):
                if test(r, r[i]):
                    del r[i]

    return change


def every_atom(do: Callable[[gemmi.Residue, gemmi.Atom], object]):
    def change(structure: gemmi.Structure) -> None:
        for chain in structure[0]:
            for r in chain:
                for a in r:
                    do(r, a)

    return change


def unstated(structure: gemmi.Structure) -> None:
    """Without stated bonds."""
    structure.connections = gemmi.ConnectionList([])


def linked(first: tuple[str, int, str, str], second: tuple[str, int, str, str], kind: str = "Covale"):
    """State a bond, of (chain, number, residue, atom) each."""

    def change(structure: gemmi.Structure) -> None:
        link = gemmi.Connection()
        link.type = getattr(gemmi.ConnectionType, kind)
        link.name = f"link{len(structure.connections) + 1}"
        link.partner1, link.partner2 = (
            gemmi.AtomAddress(c, gemmi.SeqId(n, " "), r, a) for c, n, r, a in (first, second)
        )
        structure.connections.append(link)

    return change


def mirrored(structure: gemmi.Structure) -> None:
    every_atom(lambda r, a: setattr(a, "pos", gemmi.Position(-a.pos.x, a.pos.y, a.pos.z)))(structure)


D_NAMES = {
    "ALA": "DAL", "ARG": "DAR", "ASN": "DSG", "ASP": "DAS", "CYS": "DCY", "GLN": "DGN", "GLU": "DGL",
    "HIS": "DHI", "ILE": "DIL", "LEU": "DLE", "LYS": "DLY", "MET": "MED", "PHE": "DPN", "PRO": "DPR",
    "SER": "DSN", "THR": "DTH", "TRP": "DTR", "TYR": "DTY", "VAL": "DVA",
}  # fmt: skip


# --- modified residues: parent, number in the sample, name, atoms to take away, atoms to add ----------------

Grown = tuple[str, str, str, str, str, float, float, float]
"""Name, element, three atoms that lead to it, distance, angle, dihedral."""


def _oxygens(names: str, a: str, b: str, c: str, r: float, theta: float = 109.5) -> list[Grown]:
    given = names.split()
    return [(n, "O", a, b, c, r, theta, 60.0 + 360.0 * k / len(given)) for k, n in enumerate(given)]


@dataclass(frozen=True)
class Modified:
    sample: str
    number: int
    parent: str
    add: tuple[Grown, ...] = ()
    drop: str = ""
    names: Mapping[str, str] = ()  # type: ignore[assignment]
    elements: Mapping[str, str] = ()  # type: ignore[assignment]


MODIFIED: dict[str, Modified] = {
    "MSE": Modified("1vii", 53, "MET", names={"SD": "SE"}, elements={"SE": "Se"}),
    "SEP": Modified("1l2y", 13, "SER", (("P", "P", "CA", "CB", "OG", 1.61, 120, 180), *_oxygens("O1P O2P O3P",
        "CB", "OG", "P", 1.51))),
    "TPO": Modified("1vii", 54, "THR", (("P", "P", "CA", "CB", "OG1", 1.61, 120, 160),
        *_oxygens("O1P O2P O3P", "CB", "OG1", "P", 1.51))),
    "PTR": Modified("1l2y", 3, "TYR", (("P", "P", "CE1", "CZ", "OH", 1.61, 122, 90), *_oxygens("O1P O2P O3P",
        "CZ", "OH", "P", 1.51))),
    "TYS": Modified("1l2y", 3, "TYR", (("S", "S", "CE1", "CZ", "OH", 1.58, 118, 90), *_oxygens("O1 O2 O3",
        "CZ", "OH", "S", 1.45))),
    "HYP": Modified("1l2y", 18, "PRO", (("OD1", "O", "CA", "CB", "CG", 1.43, 110, -90),)),
    "MLE": Modified("1l2y", 2, "LEU", (("CN", "C", "C", "CA", "N", 1.46, 116, 60),)),
    "MLY": Modified("1l2y", 8, "LYS", (("CH1", "C", "CD", "CE", "NZ", 1.48, 111, 60), ("CH2", "C", "CD", "CE",
        "NZ", 1.48, 111, 180))),
    "M3L": Modified("1l2y", 8, "LYS", tuple((f"CM{k}", "C", "CD", "CE", "NZ", 1.5, 109,
        120.0 * k - 60) for k in (1, 2, 3))),
    "ALY": Modified("1l2y", 8, "LYS", (("CH", "C", "CD", "CE", "NZ", 1.33, 122, 180), ("OH", "O", "CE", "NZ",
        "CH", 1.23, 123, 0), ("CH3", "C", "CE", "NZ", "CH", 1.51, 116, 180))),
    "KCX": Modified("1l2y", 8, "LYS", (("CX", "C", "CD", "CE", "NZ", 1.35, 122, 180), ("OQ1", "O", "CE", "NZ",
        "CX", 1.26, 120, 0), ("OQ2", "O", "CE", "NZ", "CX", 1.26, 118, 180))),
    "CGU": Modified("1vii", 45, "GLU", (("CD2", "C", "CA", "CB", "CG", 1.52, 110, -60), ("OE21", "O", "CB",
        "CG", "CD2", 1.25, 119, 0), ("OE22", "O", "CB", "CG", "CD2", 1.25, 118, 180)), names={"CD": "CD1",
        "OE1": "OE11", "OE2": "OE12"}),
    "AIB": Modified("1l2y", 11, "GLY", (("CB1", "C", "N", "C", "CA", 1.53, 110, 122.5), ("CB2", "C", "N", "C",
        "CA", 1.53, 110, -122.5))),
    "NLE": Modified("1vii", 53, "MET", names={"SD": "CD"}, elements={"CD": "C"}),
    "ORN": Modified("1l2y", 8, "LYS", drop="NZ", names={"CE": "NE"}, elements={"NE": "N"}),
    "DAB": Modified("1l2y", 8, "LYS", drop="NZ CE", names={"CD": "ND"}, elements={"ND": "N"}),
    "NVA": Modified("1l2y", 7, "LEU", drop="CD2", names={"CD1": "CD"}),
    "ABA": Modified("1ubq", 5, "VAL", drop="CG2", names={"CG1": "CG"}),
    "SME": Modified("1vii", 53, "MET", (("OE", "O", "CB", "CG", "S", 1.5, 106, -60),), names={"SD": "S"}),
    "CYS": Modified("1l2y", 13, "SER", drop="OG", add=(("SG", "S", "N", "CA", "CB", 1.81, 114, -60),)),
    "CME": Modified("1l2y", 13, "SER", drop="OG", add=(("SG", "S", "N", "CA", "CB", 1.81, 114, -60), ("SD",
        "S", "CA", "CB", "SG", 2.04, 104, 90), ("CE", "C", "CB", "SG", "SD", 1.81, 104, 85), ("CZ", "C", "SG",
        "SD", "CE", 1.52, 112, 180), ("OH", "O", "SD", "CE", "CZ", 1.42, 111, 180))),
    "CSO": Modified("1l2y", 13, "SER", drop="OG", add=(("SG", "S", "N", "CA", "CB", 1.81, 114, -60), ("OD",
        "O", "CA", "CB", "SG", 1.66, 102, 90))),
    "OCS": Modified("1l2y", 13, "SER", drop="OG", add=(("SG", "S", "N", "CA", "CB", 1.79, 112, -60),
        *_oxygens("OD1 OD2 OD3", "CA", "CB", "SG", 1.45))),
    "SMC": Modified("1l2y", 13, "SER", drop="OG", add=(("SG", "S", "N", "CA", "CB", 1.81, 114, -60), ("CS",
        "C", "CA", "CB", "SG", 1.8, 101, 180))),
    "SEC": Modified("1l2y", 13, "SER", drop="OG", add=(("SE", "Se", "N", "CA", "CB", 1.95, 113, -60),)),
    "SAC": Modified("1l2y", 20, "SER"),
    "HIC": Modified("1ubq", 68, "HIS", (("CZ", "C", "CG", "CD2", "NE2", 1.47, 126, 180),)),
    "FME": Modified("1vii", 41, "MET", (("CN", "C", "C", "CA", "N", 1.34, 122, 120), ("O1", "O", "CA", "N",
        "CN", 1.23, 124, 0))),
    "UNK": Modified("1l2y", 7, "LEU", drop="CG CD1 CD2"),
    "DAL": Modified("1l2y", 11, "GLY", (("CB", "C", "N", "C", "CA", 1.53, 110, -122.5),)),
    "MEQ": Modified("1l2y", 5, "GLN", (("CH", "C", "CG", "CD", "NE2", 1.46, 121, 180),)),
    "PHI": Modified("1vii", 47, "PHE", (("I", "I", "CE1", "CZ", "CZ", 2.1, 120, 180),)),
}  # fmt: skip
del MODIFIED["SAC"], MODIFIED["PHI"]


def modify(structure: gemmi.Structure, name: str, chain: str = "") -> gemmi.Residue:
    """Make a residue of a structure a modified one, in place."""
    how = MODIFIED[name]
    r = residue(structure, how.number, chain)
    assert r.name == how.parent, (name, r.name)
    for i in reversed(range(len(r))):
        if r[i].name in how.drop.split() or r[i].is_hydrogen():
            del r[i]
    for a in r:
        a.name = dict(how.names).get(a.name, a.name)
        if a.name in dict(how.elements):
            a.element = gemmi.Element(dict(how.elements)[a.name])
    for atom, element, a, b, c, *geometry in how.add:
        at = grown(*(r[each][0].pos.tolist() for each in (a, b, c)), *geometry)
        r.add_atom(new_atom(atom, element, at))
    r.name = name
    r.het_flag = "A" if name in ("CYS", "UNK") else "H"
    return r


def with_modified(name: str, hydrogens: bool = False) -> Build:
    def built() -> gemmi.Structure:
        out = sample(MODIFIED[name].sample, hydrogens)
        modify(out, name)
        return out

    return built


def pyroglutamate() -> gemmi.Structure:
    """Trp-cage from its proline 12 on, which is made pyroglutamate."""
    out = trp()
    without_residues(*range(1, 12))(out)
    first = residue(out, 12)
    x = {a.name: a.pos.tolist() for a in first}
    first.add_atom(new_atom("OE", "O", beyond(x["CD"], x["N"], x["CG"], r=1.23)))
    first.name, first.het_flag = "PCA", "H"
    return out


def adduct(stated: bool, near: float = 1.81) -> Build:
    """Trp-cage with a cysteine that acetamide is bonded to."""

    def built() -> gemmi.Structure:
        out = trp()
        r = modify(out, "CYS")
        x = {a.name: np.array(a.pos.tolist()) for a in r}
        c1 = grown(x["CA"], x["CB"], x["SG"], near, 102, 90)
        c2 = grown(x["CB"], x["SG"], c1, 1.52, 112, 180)
        o = grown(x["SG"], c1, c2, 1.23, 121, 20)
        n = grown(x["SG"], c1, c2, 1.33, 117, -160)
        atoms = [("C1", "C", c1), ("C2", "C", c2), ("O3", "O", o), ("N4", "N", n)]
        with_chain(out, "L", new_residue("LIG", 1, [new_atom(*each) for each in atoms]))
        if stated:
            linked(("A", 13, "CYS", "SG"), ("L", 1, "LIG", "C1"))(out)
        return out

    return built


def pushed(atom: str, number: int, distance: float, molecule=tuple(SULPHATE), name: str = "SO4") -> Build:
    """Trp-cage with a small molecule whose second atom lies too near an atom of the protein."""

    def built() -> gemmi.Structure:
        out = trp()
        at = np.array(residue(out, number)[atom][0].pos.tolist())
        there = places(out)
        x = np.array([each for _, _, each in molecule], dtype=float)
        x -= x[1]
        best, room = x, -1.0
        for k in range(400):
            random = np.random.default_rng(k)
            q = random.normal(size=4)
            turn = rotation(q / np.linalg.norm(q))
            way = random.normal(size=3)
            placed = x @ turn.T + at + distance * way / np.linalg.norm(way)
            d = np.linalg.norm(placed[:, None] - there[None], axis=2)
            d[1, np.linalg.norm(there - at, axis=1) < 0.01] = 9.0
            if d.min() > room:
                best, room = placed, d.min()
        made = [new_atom(n, e, p) for (n, e, _), p in zip(molecule, best, strict=True)]
        return with_chain(out, "L", new_residue(name, 501, made))

    return built


def rotation(q: np.ndarray) -> np.ndarray:
    """Rotation matrix of a unit quaternion."""
    w, x, y, z = q
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip


# --- names of programs -------------------------------------------------------------------------------------

_CH2 = {
    "HB2": "HB1", "HB3": "HB2", "HG2": "HG1", "HG3": "HG2", "HD2": "HD1", "HD3": "HD2", "HE2": "HE1",
    "HE3": "HE2",
}  # fmt: skip
PAIRS = {
    "ARG": "HB HG HD", "ASN": "HB", "ASP": "HB", "CYS": "HB", "GLN": "HB HG", "GLU": "HB HG", "HIS": "HB",
    "LEU": "HB", "LYS": "HB HG HD HE", "MET": "HB HG", "PHE": "HB", "PRO": "HB HG HD", "SER": "HB",
    "TRP": "HB", "TYR": "HB",
}  # fmt: skip


def counted_from_one() -> dict[str, dict[str, str]]:
    """Hydrogens of CH2 counted from 1, as CHARMM, GROMACS and older files of the PDB have them."""
    tables = {
        name: {old: new for old, new in _CH2.items() if old[:2] in pairs.split()}
        for name, pairs in PAIRS.items()
    }
    tables["GLY"] = {"HA2": "HA1", "HA3": "HA2"}
    tables["ILE"] = {"HG12": "HG11", "HG13": "HG12"}
    return tables


def charmm_names(histidine: str = "HSD") -> Callable[[gemmi.Structure], None]:
    tables = counted_from_one()
    tables["*"] = {"H": "HN", "OXT": "OT2", "H1": "HT1", "H2": "HT2", "H3": "HT3"}
    tables["ILE"] |= {"CD1": "CD", "HD11": "HD1", "HD12": "HD2", "HD13": "HD3"}
    tables["SER"] |= {"HG": "HG1"}
    tables["CYS"] |= {"HG": "HG1"}

    def change(structure: gemmi.Structure) -> None:
        for chain in structure[0]:
            if any(a.name == "OXT" for a in chain[-1]):
                for a in chain[-1]:
                    a.name = "OT1" if a.name == "O" else a.name
        renamed({"HIS": histidine}, tables)(structure)

    return change


def gromacs_names(structure: gemmi.Structure) -> None:
    tables = counted_from_one()
    tables["ILE"] |= {"CD1": "CD", "HD11": "HD1", "HD12": "HD2", "HD13": "HD3"}
    for chain in structure[0]:
        if any(a.name == "OXT" for a in chain[-1]):
            for a in chain[-1]:
                a.name = {"O": "OC1", "OXT": "OC2"}.get(a.name, a.name)
    renamed({"LYS": "LYSH"[:3], "HIS": "HIE"}, tables)(structure)


def old_pdb_name(name: str) -> str:
    """Name of a hydrogen in version 2 of the format: HB2 is 1HB, HD21 1HD2."""
    return f"{name[-1]}{name[:-1]}" if name[0] == "H" and name[-1].isdigit() and len(name) > 2 else name


def old_hydrogens(text: str) -> str:
    """Hydrogens named as in version 2 of the format, digits first."""

    def change(line: str) -> str:
        name = line[12:16].strip()
        if line[76:78].strip() != "H" or not name[-1].isdigit() or len(name) < 3:
            return line
        return f"{line[:12]}{f'{name[-1]}{name[:-1]}':<4}{line[16:]}"

    return records(change)(renumbered(text))


def renumbered(text: str) -> str:
    """CH2 hydrogens counted from 1."""
    tables = counted_from_one()

    def change(line: str) -> str:
        name = tables.get(line[17:20], {}).get(line[12:16].strip())
        return f"{line[:12]}{f' {name:<3}' if len(name) < 4 else name}{line[16:]}" if name else line

    return records(change)(text)


def histidines(hydrogens: str) -> Callable[[gemmi.Structure], None]:
    """Give histidines their ring hydrogens: D, E or both, of bases with hydrogens from geometry."""

    def change(structure: gemmi.Structure) -> None:
        for chain in structure[0]:
            for r in chain:
                if r.name != "HIS":
                    continue
                x = {a.name: a.pos.tolist() for a in r}
                if "D" in hydrogens:
                    r.add_atom(new_atom("HD1", "H", beyond(x["ND1"], x["CG"], x["CE1"], r=1.01)))
                if "E" in hydrogens:
                    r.add_atom(new_atom("HE2", "H", beyond(x["NE2"], x["CD2"], x["CE1"], r=1.01)))

    return change


def with_hydrogen(
    number: int, name: str, a: str, b: str, c: str, chain: str = ""
) -> Callable[[gemmi.Structure], None]:
    def change(structure: gemmi.Structure) -> None:
        r = residue(structure, number, chain)
        at = grown(*(r[each][0].pos.tolist() for each in (a, b, c)), 0.98, 109.5, 180.0)
        r.add_atom(new_atom(name, "H", at))

    return change


def acetylated(build: Build, end: str = "NME") -> Build:
    """A build with ACE before the first residue and NME or NH2 after the last."""

    def built() -> gemmi.Structure:
        out = build()
        chain = out[0][0]
        first, last = chain[0], chain[-1]
        x = {a.name: np.array(a.pos.tolist()) for a in first}
        c = grown(x["C"], x["CA"], x["N"], 1.33, 122, 180)
        o = grown(x["CA"], x["N"], c, 1.23, 123, 0)
        ch3 = grown(x["CA"], x["N"], c, 1.51, 116, 180)
        ace = [new_atom(*each) for each in (("CH3", "C", ch3), ("C", "C", c), ("O", "O", o))]
        for i in reversed(range(len(last))):
            if last[i].name == "OXT":
                del last[i]
        y = {a.name: np.array(a.pos.tolist()) for a in last}
        n = beyond(y["C"], y["CA"], y["O"], r=1.33)
        tail = [new_atom("N", "N", n)]
        if end == "NME":
            tail.append(new_atom("C", "C", grown(y["CA"], y["C"], n, 1.45, 122, 180)))
        number = last.seqid.num
        chain.add_residue(new_residue("ACE", first.seqid.num - 1, ace, het=True), 0)
        chain.add_residue(new_residue(end, number + 1, tail, het=True))
        for r in (chain[0], chain[-1]):
            r.entity_type = gemmi.EntityType.Polymer
        return out

    return built
