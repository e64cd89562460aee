"""Damaged files, by kind and seed, each with a command that reads it; odd options, by command and seed.

``case(kind, seed)`` is the same wherever ../shared is the same. Restraints are options, not files.
"""

import bz2
import gzip
import io
import lzma
import random
import re
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import typer
from openmm import app as openmm_app
from recipes import MORE, SAMPLES, SHARED, as_cif, read_file

from protochain.cli import app

Rng = random.Random
Lines = list[str]


@dataclass(frozen=True)
class Case:
    """A command and the files that it finds.

    Parameters
    ----------
    kind, seed : str, int
    words : tuple of str
    files : mapping
        Relative path: content.
    named : tuple of str
        Files of which a refusal must name one; none if options are refused.
    outputs : tuple of str
        Files that may be replaced.
    """

    kind: str
    seed: int
    words: tuple[str, ...]
    files: Mapping[str, bytes]
    named: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()


# Sources.

SMALL = ("1l2y", "ala10")
SMALL_SHARED = (
    "ala3", "ala5_ideal", "ala_dipeptide", "a6pa6_alpha", "aaqaa3_capped", "3znf_zinc_finger",
    "1le1_trpzip2", "5vav_cyclic", "1grm_gramicidin", "2n0n_lactam", "ubiquitin_ca_only",
    "trpcage_d9e_missing", "2ptc_I_bpti_occ0", "unordered_icode",
)  # fmt: skip
LARGEST = 140_000
"""Bytes."""
LARGE = 0.08
"""Share of larger files, which only quick commands read."""


@cache
def sources() -> tuple[list[Path], list[Path], list[Path]]:
    """Small PDB files, larger ones, mmCIF files."""
    small = [SAMPLES / f"{name}.pdb" for name in SMALL] + [MORE / f"{name}.pdb" for name in SMALL_SHARED]
    every = [*SAMPLES.glob("*"), *MORE.glob("*"), *(SHARED / "complexes").rglob("*")]
    fit = sorted(path for path in every if path.is_file() and path.stat().st_size <= LARGEST)
    large = [path for path in fit if path.suffix == ".pdb" and path not in small]
    return [path for path in small if path.exists()], large, [path for path in fit if path.suffix == ".cif"]


@cache
def cif_of(path: Path) -> bytes:
    return as_cif(read_file(path)).encode()


def pdb(rng: Rng) -> tuple[str, bytes, bool]:
    """Name, content, whether it is large."""
    small, large, _ = sources()
    is_large = bool(large) and rng.random() < LARGE
    path = rng.choice(large if is_large else small)
    return path.name, path.read_bytes(), is_large


def cif(rng: Rng) -> tuple[str, bytes, bool]:
    small, _, real = sources()
    if rng.random() < 2 * LARGE:
        path = rng.choice(real)
        return path.name, path.read_bytes(), True
    # gemmi writes no mmCIF of a model without residues that bond.
    path = rng.choice([path for path in small if "ca_only" not in path.name])
    return f"{path.stem}.cif", cif_of(path), False


# Damage of lines.

ODD = (
    "nan", "NaN", "inf", "-inf", "1e30", "1e308", "-9999.99", "99999999", "-9999999", "********", "12,34",
    "0x10", "1_0.0", "--1", "1.2.3", "1e-320", "", "?", ".", "0", "-0.0", "ABC", "\u0661\u0662", "\u00e9",
    "\u6771\u4eac", "\0", "\x1b[31m", "\t", "'", '"', "#", ";",
)  # fmt: skip
FIELDS = {
    "serial": (6, 11), "name": (12, 16), "altloc": (16, 17), "residue": (17, 20), "chain": (21, 22),
    "number": (22, 26), "icode": (26, 27), "x": (30, 38), "y": (38, 46), "z": (46, 54),
    "occupancy": (54, 60), "b": (60, 66), "element": (76, 78), "charge": (78, 80),
}  # fmt: skip
RESIDUES = (
    "XYZ", "MSE", "HYP", "DAL", "ACE", "NME", "NH2", "HID", "DA", "HOH", "ZN", "", "SEP", "UNK", "GLY",
    "PRO", "CYX", "ala",
)  # fmt: skip


def put(line: str, field: str, text: str) -> str:
    start, end = FIELDS[field]
    return f"{line:<80}"[:start] + text[: end - start].rjust(end - start) + f"{line:<80}"[end:]


def value(line: str, field: str) -> str:
    return line[slice(*FIELDS[field])]


def is_atom(line: str) -> bool:
    return line.startswith(("ATOM", "HETATM"))


def some(lines: Lines, rng: Rng) -> Callable[[int], bool]:
    """Which lines to damage: one, some or all."""
    share = rng.choice((0.0, 0.01, 0.1, 1.0))
    one = rng.randrange(len(lines)) if lines else 0
    chosen = {k for k in range(len(lines)) if rng.random() < share} | {one}
    return chosen.__contains__


def of_atoms(change: Callable[[str, Rng], str]) -> Callable[[Lines, Rng], Lines]:
    """Damage of one, some or all records of atoms."""

    def damage(lines: Lines, rng: Rng) -> Lines:
        atoms = [k for k, line in enumerate(lines) if is_atom(line)]
        chosen = some([lines[k] for k in atoms], rng)
        spoilt = {k for j, k in enumerate(atoms) if chosen(j)}
        return [change(line, rng) if k in spoilt else line for k, line in enumerate(lines)]

    return damage


def block(lines: Lines, rng: Rng) -> slice:
    start = rng.randrange(max(len(lines), 1))
    return slice(start, start + rng.choice((1, 5, 40, 200)))


def dropped(lines: Lines, rng: Rng) -> Lines:
    if rng.random() < 0.5:
        share = rng.choice((0.01, 0.1, 0.5, 0.95))
        return [line for line in lines if rng.random() > share]
    out = list(lines)
    del out[block(lines, rng)]
    return out


def doubled(lines: Lines, rng: Rng) -> Lines:
    part = lines[block(lines, rng)]
    place = rng.randrange(len(lines) + 1)
    return [*lines[:place], *part, *lines[place:]]


def swapped(lines: Lines, rng: Rng) -> Lines:
    out, place = list(lines), block(lines, rng)
    part = out[place]
    rng.shuffle(part)
    out[place] = part
    for _ in range(rng.choice((1, 3, 30))):
        i, j = rng.randrange(len(out)), rng.randrange(len(out))
        out[i], out[j] = out[j], out[i]
    return out


def cut_lines(lines: Lines, rng: Rng) -> Lines:
    chosen, width = some(lines, rng), rng.choice((3, 10, 20, 27, 30, 40, 53, 54, 60, 66, 77))
    return [
        (line[:width] if rng.random() < 0.7 else line[width:]) if chosen(k) else line
        for k, line in enumerate(lines)
    ]


def characters(lines: Lines, rng: Rng) -> Lines:
    odd = "\0\x01\x07\x08\x0b\x0c\x1a\x1b\x7f\x85\xa0\xff\u0301\u200b\u202e\u2028\ufeff\u00e9\u6771\U0001f600"
    text = list("\n".join(lines))
    for _ in range(rng.choice((1, 20, 400))):
        text[rng.randrange(len(text))] = rng.choice(odd)
    return "".join(text).split("\n")


def line_ends(lines: Lines, rng: Rng) -> Lines:
    ends = rng.choice(
        (("\r\n",), ("\r",), ("\n", "\r\n", "\r"), ("\n", "\x0b", "\x0c"), ("\n\n", " \n"), ("\n\r",))
    )
    text = "".join(line + rng.choice(ends) for line in lines)
    return [text + rng.choice(("", "\x1a", "\0" * 512, "\n" * 500))]


def huge(lines: Lines, rng: Rng) -> Lines:
    out = list(lines)
    k = rng.randrange(len(out))
    at = rng.randrange(len(out[k]) + 1)
    out[k] = out[k][:at] + rng.choice("AX9 '\t;") * rng.choice((90, 1000, 100_000)) + out[k][at:]
    return out


def field_over(line: str, rng: Rng) -> str:
    return put(line, rng.choice(tuple(FIELDS)), rng.choice(ODD))


def numbers_over(line: str, rng: Rng) -> str:
    return put(line, rng.choice(("x", "y", "z")), rng.choice(ODD))


def blanked(line: str, rng: Rng) -> str:
    return put(line, rng.choice(tuple(FIELDS)), "")


def columns_shifted(line: str, rng: Rng) -> str:
    at = rng.choice((4, 6, 12, 17, 22, 30, 54, 76))
    return rng.choice((f"{line[:at]} {line[at:]}", line[:at] + line[at + 1 :], f"{line[:at]}\t{line[at:]}"))


def moved(line: str, rng: Rng) -> str:
    far = rng.choice((0.0, 0.5, 3.0, 999.0))
    for axis in "xyz":
        line = put(line, axis, f"{rng.uniform(-far, far):8.3f}")
    return line


def atoms_renamed(line: str, rng: Rng) -> str:
    names = (
        "CA",
        "N",
        "C",
        "O",
        "OXT",
        "CB",
        "HA",
        "1HB",
        "SG",
        "ZN",
        "X",
        "",
        "H1",
        "D",
        "CA'",
        "HO5'",
        "XX1",
    )
    return put(line, "name", f" {rng.choice(names):<3}")


def altlocs(line: str, rng: Rng) -> str:
    return put(line, "altloc", rng.choice("AB19 .?a*"))


def occupancies(line: str, rng: Rng) -> str:
    odd = (*ODD, "0.00", "-1.00", "2.00", "0.50")
    return put(line, rng.choice(("occupancy", "b")), rng.choice(odd))


def elements(line: str, rng: Rng) -> str:
    if rng.random() < 0.5:
        return put(line, "charge", rng.choice(("1+", "9-", "+1", "-", "99", "xx", "2-", "+")))
    return put(
        line, "element", rng.choice(("C", "H", "D", "ZN", "X", "XX", "FE", "c", "1", "U", "Og", "??", "NA"))
    )


def models(lines: Lines, rng: Rng) -> Lines:
    atoms = [line for line in lines if is_atom(line) or line.startswith("TER")]
    out = [line for line in lines if not is_atom(line) and not line.startswith(("TER", "END"))]
    for k in range(rng.choice((1, 2, 2, 3, 12))):
        number = rng.choice((str(k + 1), "1", "0", "-1", "nan", "", "9999", "99999", "A"))
        own = dropped(atoms, rng) if rng.random() < 0.4 else atoms
        out += [f"MODEL     {number:>4}"] * (rng.random() < 0.9) + own + ["ENDMDL"] * (rng.random() < 0.8)
    return [*out, "END"]


def residues_renumbered(lines: Lines, rng: Rng) -> Lines:
    by = rng.choice((-9999, -200, -1, 1, 3000, 99999))
    shape = rng.choice(("{}", "1", "", "{}A", "A{}", "-{}"))

    def change(line: str, rng: Rng) -> str:
        if not value(line, "number").strip().lstrip("-").isdecimal():
            return line
        number = int(value(line, "number")) + (by if rng.random() < 0.9 else 0)
        return put(line, "number", shape.format(number % 10_000 if rng.random() < 0.5 else number))

    return of_atoms(change)(lines, rng)


def residues_doubled(lines: Lines, rng: Rng) -> Lines:
    atoms = [line for line in lines if is_atom(line)]
    if not atoms:
        return lines
    chosen = value(rng.choice(atoms), "number")
    part = [line for line in atoms if value(line, "number") == chosen]
    if rng.random() < 0.6:
        part = [put(line, "icode", rng.choice("AB ")) for line in part]
    if rng.random() < 0.5:
        part = [put(line, "residue", rng.choice(RESIDUES)) for line in part]
    if rng.random() < 0.6:
        part = [moved(line, rng) for line in part]
    place = rng.randrange(len(lines) + 1)
    return [*lines[:place], *part, *lines[place:]]


def residues_renamed(line: str, rng: Rng) -> str:
    return put(line, "residue", rng.choice(RESIDUES))


def chains(lines: Lines, rng: Rng) -> Lines:
    ids = rng.choice(("A", "AB", " ", "AB ", "1", "a\u00e9", "*?'\"", "ABCDEFGHIJ"))
    renamed = of_atoms(lambda line, rng: put(line, "chain", rng.choice(ids)))(lines, rng)
    if rng.random() < 0.5:
        return renamed
    shift = rng.choice((0.0, 0.01, 30.0))

    def away(line: str) -> str:
        try:
            return put(put(line, "chain", rng.choice(ids)), "x", f"{float(value(line, 'x')) + shift:8.3f}")
        except ValueError:
            return line

    part = [away(line) for line in lines if is_atom(line)]
    return [*lines[:-1], *part, *rng.choice((["END"], [], ["TER", "END"]))]


def bonds(lines: Lines, rng: Rng) -> Lines:
    atoms = [line for line in lines if is_atom(line)] or [" " * 80]

    def end() -> str:
        line = f"{rng.choice(atoms):<80}"
        return f"{line[12:16]}{line[16]}{line[17:20]} {line[21:27]}"

    out = list(lines)
    for _ in range(rng.choice((1, 3, 30))):
        a, b = f"{rng.choice(atoms):<80}", f"{rng.choice(atoms):<80}"
        symmetry = rng.choice(("  1555   1555", "  1555   2655", "     0      0", "   nan    inf", ""))
        length = rng.choice((" 2.03", "  nan", "-1.00", "", "99999"))
        record = rng.choice((
            "CONECT" + a[6:11] + b[6:11] * rng.choice((1, 2, 4, 9)),
            f"CONECT{rng.choice(ODD):>5}{rng.choice(ODD):>5}",
            f"LINK        {end()}               {end()}  {symmetry} {length}",
            f"SSBOND{rng.randrange(99):4} CYS {a[21]} {a[22:27]}   CYS {b[21]} {b[22:27]}{symmetry:>34}",
            f"SSBOND   1 CYS {a[21]} {rng.choice(ODD):>4}    CYS {b[21]} {rng.choice(ODD):>4}",
            f"CISPEP{rng.randrange(99):4} {a[17:20]} {a[21:27]}   {b[17:20]} {b[21:27]}",
        ))  # fmt: skip
        out.insert(rng.choice((0, len(out) - 1, rng.randrange(len(out) + 1))), record)
    return out


def headers(lines: Lines, rng: Rng) -> Lines:
    odd = rng.choice(ODD)
    records = (
        f"HEADER    {odd}", f"TITLE     {odd * 20}", f"EXPDTA    {odd}",
        f"CRYST1{odd:>9}{odd:>9}   10.000  90.00  {odd:>5}  90.00 P 1 21 1",
        "CRYST1    0.000    0.000    0.000   0.00   0.00   0.00 P 1",
        f"SEQRES   1 A{odd:>5}  ALA GLY {odd:>3} XXX", "SEQRES   1 A    3  TRP TRP TRP",
        f"SEQRES{odd:>4} {odd:>1}   10  ALA", f"MODRES XXXX ALA A{odd:>5}  {odd:>3}  {odd}",
        "MODRES 1L2Y TRP A    6  ALA  ODD", "REMARK 465   M RES C SSSEQI", f"REMARK 465     ALA A{odd:>6}",
        "REMARK 470     TRP A   6    CB   CG", f"REMARK   2 RESOLUTION. {odd:>7} ANGSTROMS.",
        f"HET    {odd:>3}  A{odd:>4}      10", f"DBREF  {odd:>4} A    1  {odd:>4}  UNP    X", "MODEL",
        "TER", "END", "ENDMDL", f"SCALE1   {odd:>10}", f"ORIGX1   {odd:>10}", f"MTRIX1   1{odd:>10}",
        "REMARK 350 BIOMOLECULE: 1", f"REMARK 350   BIOMT1   1{odd:>10}", f"HELIX    1 {odd:>3} ALA A",
        f"SHEET    1 {odd:>3} 2 ALA A", f"ANISOU{odd:>5}", f"NUMMDL    {odd}", "MASTER", "HETNAM",
    )  # fmt: skip
    out = list(lines)
    for _ in range(rng.choice((1, 3, 10))):
        out.insert(rng.choice((0, 0, rng.randrange(len(out) + 1))), rng.choice(records))
    return out


# Damage of mmCIF.


def tokens(change: Callable[[str, Rng], str]) -> Callable[[Lines, Rng], Lines]:
    """Damage of one or some tokens."""

    def damage(lines: Lines, rng: Rng) -> Lines:
        parts = re.split(r"([ \n]+)", "\n".join(lines))
        for _ in range(rng.choice((1, 1, 5, 100))):
            k = 2 * rng.randrange((len(parts) + 1) // 2)
            parts[k] = change(parts[k], rng)
        return "".join(parts).split("\n")

    return damage


def quotes(token: str, rng: Rng) -> str:
    shape = rng.choice(
        ("'{}", '"{}', "'{}'", '"{}"', "{}'", "\n;{}\n;\n", "\n;{}", "#{}", "'{} {}'", "{}'x", "$_{}", "[{}")
    )
    return shape.replace("{}", token)


def words_over(token: str, rng: Rng) -> str:
    return rng.choice(
        (*ODD[:-4], "loop_", "data_x", "save_", "stop_", "global_", "_atom_site.x", "_x", "data_")
    )


def loop_values(lines: Lines, rng: Rng) -> Lines:
    """Values left out of rows, or too many."""
    chosen = some(lines, rng)

    def change(line: str) -> str:
        parts = line.split(" ")
        k = rng.randrange(len(parts))
        return " ".join(rng.choice((parts[:k] + parts[k + 1 :], [*parts[:k], "7", *parts[k:]])))

    return [change(line) if chosen(k) else line for k, line in enumerate(lines)]


def cif_columns(lines: Lines, rng: Rng) -> Lines:
    """Names of columns left out, renamed, doubled or swapped."""
    at = [k for k, line in enumerate(lines) if line.startswith("_")]
    sites = [k for k in at if lines[k].startswith("_atom_site.")]
    out = list(lines)
    if not at:
        return out
    k = rng.choice(sites if sites and rng.random() < 0.7 else at)
    what = rng.randrange(5)
    if what == 0:
        del out[k]
    elif what == 1:
        out.insert(k, out[k])
    elif what == 2:
        j = rng.choice(sites or at)
        out[k], out[j] = out[j], out[k]
    elif what == 3:
        out[k] = rng.choice((out[k].upper(), f"{out[k].rstrip()}_x", out[k].replace(".", "_"), "_"))
    else:
        out[k] = re.sub(r"auth|label", rng.choice(("auth", "label")), out[k])
    return out


def cif_categories(lines: Lines, rng: Rng) -> Lines:
    """Categories removed, doubled or moved."""
    parts = re.split(r"\n#\s*\n|\n(?=loop_)", "\n".join(lines))
    for _ in range(rng.choice((1, 2))):
        k = rng.randrange(len(parts))
        part = parts.pop(k)
        for _ in range(rng.choice((0, 0, 1, 2))):
            parts.insert(rng.randrange(len(parts) + 1), part)
    return "\n#\n".join(parts).split("\n")


def cif_keywords(lines: Lines, rng: Rng) -> Lines:
    text = "\n".join(lines)
    old = rng.choice(("loop_", "data_", "_atom_site.", "ATOM", "#", "\n", " ", "A", "?", "."))
    new = rng.choice(
        ("", "LOOP_", "data_", "data_x\ndata_x\n", "save_x", "?", "HETATM", "_atom_site.id", "\t", "\0")
    )
    return text.replace(old, new, rng.choice((1, 1, 3, -1))).split("\n")


# Damage of bytes.


def flipped(data: bytes, rng: Rng) -> bytes:
    out = bytearray(data)
    for _ in range(rng.choice((1, 1, 4, 40, 1000))):
        if out:
            k = rng.randrange(len(out))
            out[k] = rng.choice((out[k] ^ 1 << rng.randrange(8), rng.randrange(256)))
    return bytes(out)


def truncated(data: bytes, rng: Rng) -> bytes:
    if rng.random() < 0.1:
        return data[: rng.choice((0, 1, 2, 3, 10, 20))]
    return data[: rng.randrange(len(data) + 1)]


def broken(data: bytes, rng: Rng) -> bytes:
    """Bytes flipped, cut off, left out, put in, or put before and after."""
    k = rng.randrange(len(data) + 1)
    return rng.choice((
        lambda: flipped(data, rng), lambda: truncated(data, rng), lambda: data[:k] + data[k + 7 :],
        lambda: data[:k] + rng.randbytes(9) + data[k:], lambda: data + rng.randbytes(40),
        lambda: rng.randbytes(5) + data, lambda: data + data, lambda: rng.randbytes(200), lambda: b"",
    ))()  # fmt: skip


def packed(name: str, data: bytes, rng: Rng) -> tuple[str, bytes]:
    suffix, pack = rng.choice(((".gz", gzip.compress), (".bz2", bz2.compress), (".xz", lzma.compress)))
    content = pack(data)
    if rng.random() < 0.1:
        content = pack(content)
    # Also one packing under another's name.
    wrong = rng.choice(("", ".gz", ".bz2", ".xz", ".zip", ".Z"))
    return name + (suffix if rng.random() < 0.8 else wrong), broken(content, rng)


def arrays(data: bytes, rng: Rng) -> bytes:
    """An .npz file with an array or the text in it damaged, and its checksums right."""
    with zipfile.ZipFile(io.BytesIO(data)) as old:
        members = {name: old.read(name) for name in old.namelist()}
    name = rng.choice([*members, "text.npy", "text.npy"])
    if name == "text.npy":
        array = np.load(io.BytesIO(members[name]))
        text = array.item() if array.ndim == 0 and array.dtype.kind in "US" else ""
        raw = text if isinstance(text, str) else text.decode()
        cut = tokens(words_over)([raw.replace(", ", " , ").replace(":", " : ")], rng)
        members[name] = saved(np.array("\n".join(cut)))
    else:
        array = np.load(io.BytesIO(members[name]))
        spoil = rng.randrange(8)
        if spoil == 0:
            del members[name]
        elif spoil == 1:
            members[name] = truncated(members[name], rng)
        elif spoil == 2:
            members[f"../{name}"] = members.pop(name)
        else:
            with np.errstate(all="ignore"):
                new = (
                    lambda: array * np.nan, lambda: array * 1e300, lambda: np.array(array.tolist(), object),
                    lambda: array[..., None], lambda: array.astype("U"), lambda: array.ravel()[:1],
                    lambda: array.astype(complex), lambda: -array,
                )  # fmt: skip
                if array.dtype.kind in "fiu":
                    members[name] = saved(rng.choice(new)())
                else:
                    members[name] = saved(np.zeros(3))
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as made:
        for each, content in members.items():
            made.writestr(each, content)
    return out.getvalue()


def saved(array: np.ndarray) -> bytes:
    out = io.BytesIO()
    np.save(out, array, allow_pickle=True)
    return out.getvalue()


# Files beside structures.

MANIFEST = (
    "path,methods,tolerance,max_evaluations,seed,ph\n"
    "ala10.pdb,lbfgs,1.0,3,0,7\n1l2y.pdb,cartesian,10.0,3,1,6.5\n"
)


def manifest(text: str, rng: Rng) -> str:
    lines = text.split("\n")
    columns = rng.choice((
        "", "path", "path,path", "path,model", "path,keep,chains", "Path", "path,nonsense", "path,workers",
        "path,disulfide", "path,methods", "\ufeffpath,seed", "path;seed", '"path,seed',
        "path,max_evaluations",
    ))  # fmt: skip
    if rng.random() < 0.4:
        lines[0] = columns
    for _ in range(rng.choice((0, 1, 3))):
        k = rng.randrange(len(lines))
        cells = lines[k].split(",")
        cells[rng.randrange(len(cells))] = rng.choice(
            (*ODD, "missing.pdb", "in", "../in/ala10.pdb", "/dev/null", "in/*")
        )
        lines[k] = ",".join(cells)
    change = rng.choice(
        (dropped, doubled, swapped, cut_lines, characters, line_ends, loop_values, lambda x, _: x)
    )
    return "\n".join(change(lines, rng))


@cache
def forcefield() -> str:
    """The part of a force field that chains of alanine need."""
    text = (Path(openmm_app.__file__).parent / "data" / "amber99sb.xml").read_text()
    own = re.compile(r'\n *<Residue name="(?!N?ALA"|CALA")[^>]*>.*?</Residue>', re.DOTALL)
    return own.sub("", text)


def xml(text: str, rng: Rng) -> str:
    change = rng.choice((
        lambda: dropped(text.split("\n"), rng), lambda: doubled(text.split("\n"), rng),
        lambda: swapped(text.split("\n"), rng), lambda: cut_lines(text.split("\n"), rng),
        lambda: characters(text.split("\n"), rng), lambda: tokens(words_over)(text.split("\n"), rng),
        lambda: attributes(text, rng), lambda: attributes(text, rng), lambda: attributes(text, rng),
        lambda: elements_renamed(text, rng),
    ))  # fmt: skip
    return "\n".join(change())


def attributes(text: str, rng: Rng) -> Lines:
    """Values of attributes overwritten."""
    at = [*re.finditer(r'(\w+)="([^"]*)"', text)]
    for match in sorted(rng.sample(at, rng.choice((1, 1, 5, 50))), key=lambda m: -m.start()):
        new = rng.choice((*ODD[:24], "&#1;", "&amp;", "-1", "1e9", "CALA"))
        text = f"{text[: match.start(2)]}{new}{text[match.end(2) :]}"
    return text.split("\n")


def elements_renamed(text: str, rng: Rng) -> Lines:
    name = rng.choice(
        ("Residue", "Atom", "Bond", "HarmonicBondForce", "NonbondedForce", "Type", "AtomTypes", "ForceField")
    )
    new = rng.choice(
        ("Residues", "", "Script", "atom", "CustomNonbondedForce", "Patch", "Include", "InitializationScript")
    )
    return re.sub(rf"(</?){name}\b", rf"\1{new}", text, count=rng.choice((1, 2, 0))).split("\n")


# Cases.

THREADS = ("--threads", "1")
QUICK = (
    (("info",), 40, THREADS), (("validate",), 20, ()), (("rmsd", "in/ala10.pdb"), 10, ()),
)  # fmt: skip
COMMANDS = (
    *QUICK,
    (("minimise", "-o"), 12, ("--max-evaluations", "3", *THREADS)),
    (("relax", "-o"), 10, ("--max-iterations", "3", *THREADS)),
    (("simulate",), 8, ("--steps", "5", "--every", "1", "-o", "sim", *THREADS)),
)
"""Words before the file, weight, words after it."""
BESIDE = ("in/ala10.pdb", "in/1l2y.pdb")
MODELLED = (("--model", "2"), ("--chain", "A"), ("--keep", "all"), ("--strict",), ("--altloc", "B"))


def beside() -> dict[str, bytes]:
    return {name: (SAMPLES / Path(name).name).read_bytes() for name in BESIDE}


def reading(kind: str, seed: int, name: str, data: bytes, is_large: bool, rng: Rng) -> Case:
    """A command that reads a structure."""
    choice = QUICK if is_large else COMMANDS
    first, _, last = rng.choices(choice, [weight for _, weight, _ in choice])[0]
    path = f"in/{name}"
    words = [*first, path, *last]
    if first[-1] == "-o":
        words = [first[0], path, "-o", rng.choice(("out.pdb", "out.cif", "out.pdb.gz")), *last]
    if first[0] == "simulate" and rng.random() < 0.5:
        words.append("--no-relax")
    if first[0] not in ("rmsd",) and rng.random() < 0.2:
        words += rng.choice(MODELLED)
    if rng.random() < 0.6:
        words.append("--json")
    return Case(kind, seed, tuple(words), beside() | {path: data}, (path,))


def text_case(
    kind: str,
    seed: int,
    source: Callable[[Rng], tuple[str, bytes, bool]],
    change: Callable[[Lines, Rng], Lines],
) -> Case:
    rng = Rng(f"{kind} {seed}")
    name, data, is_large = source(rng)
    lines = change(data.decode("utf-8", "replace").split("\n"), rng)
    return reading(kind, seed, name, "\n".join(lines).encode("utf-8", "replace"), is_large, rng)


def bytes_case(
    kind: str,
    seed: int,
    source: Callable[[Rng], tuple[str, bytes, bool]],
    change: Callable[[bytes, Rng], bytes],
) -> Case:
    rng = Rng(f"{kind} {seed}")
    name, data, is_large = source(rng)
    return reading(kind, seed, name, change(data, rng), is_large, rng)


def packed_case(kind: str, seed: int) -> Case:
    rng = Rng(f"{kind} {seed}")
    name, data, is_large = rng.choice((pdb, pdb, cif))(rng)
    name, data = packed(name, data, rng)
    return reading(kind, seed, name, data, is_large, rng)


def manifest_case(kind: str, seed: int) -> Case:
    rng = Rng(f"{kind} {seed}")
    data = manifest(MANIFEST, rng).encode("utf-8", "replace")
    words = ("batch", "--manifest", "in/list.csv", "--max-evaluations", "3", "--workers", "1", "--dry-run")
    # Which of its files a line of a manifest is about is known to its reader only.
    return Case(kind, seed, words, beside() | {"in/list.csv": data}, ("in/list.csv",))


def forcefield_case(kind: str, seed: int) -> Case:
    rng = Rng(f"{kind} {seed}")
    data = xml(forcefield(), rng).encode("utf-8", "replace")
    data = broken(data, rng) if rng.random() < 0.1 else data
    commands = (
        ("info", "in/ala10.pdb"), ("info", "in/ala10.pdb"),
        ("minimise", "in/ala10.pdb", "-o", "out.pdb", "--max-evaluations", "3", "--json"),
    )  # fmt: skip
    words = (*rng.choice(commands), "--forcefield", "in/own.xml", "--solvent", "vacuum", *THREADS)
    return Case(kind, seed, words, beside() | {"in/own.xml": data}, ("in/own.xml", "in/ala10.pdb"))


Made = Callable[[str], Mapping[str, bytes]]
"""Name in MADE to files."""
METHODS = ("cartesian", "lbfgs", "kcm", "newton", "hybrid")
MINIMISED = ("minimise", "in/ala10.pdb", "-o", "out.pdb", "--max-evaluations", "3", *THREADS)
SIMULATED = (
    "simulate",
    "in/ala10.pdb",
    "--every",
    "1",
    "--checkpoint-every",
    "1",
    "--no-relax",
    "-o",
    "sim",
    *THREADS,
)
BATCHED = ("batch", "in/ala10.pdb", "--max-evaluations", "3", "--workers", "1", "-o", "b")
MADE = {
    **{
        f"checkpoint {method}": (*MINIMISED, "--method", method, "--checkpoint", "state.npz")
        for method in METHODS
    },
    "simulation": (*SIMULATED, "--steps", "3"),
    "batch": BATCHED,
}
"""Commands whose files are then damaged."""


def checkpoint_case(kind: str, seed: int, made: Made) -> Case:
    rng = Rng(f"{kind} {seed}")
    method = rng.choice(METHODS)
    data = rng.choice((broken, arrays, arrays, arrays))(made(f"checkpoint {method}")["state.npz"], rng)
    words = (*MINIMISED, "--method", method, "--resume", "state.npz", "--max-evaluations", "5", "--json")
    return Case(kind, seed, words, beside() | {"state.npz": data}, ("state.npz", "in/ala10.pdb"))


def simulation_case(kind: str, seed: int, made: Made) -> Case:
    rng = Rng(f"{kind} {seed}")
    files = {name: data for name, data in made("simulation").items() if name.startswith("sim/")}
    name = rng.choice(sorted(files))
    if name.endswith(".npz"):
        files[name] = rng.choice((broken, arrays, arrays))(files[name], rng)
    elif name.endswith(".dcd"):
        files[name] = broken(files[name], rng)
    else:
        files[name] = "\n".join(loop_values(files[name].decode().split("\n"), rng)).encode()
        files[name] = broken(files[name], rng)
    words = (*SIMULATED, "--steps", "5", "--resume", "--json")
    return Case(kind, seed, words, beside() | files, ("sim",), tuple(files))


def batch_case(kind: str, seed: int, made: Made) -> Case:
    rng = Rng(f"{kind} {seed}")
    files = {name: data for name, data in made("batch").items() if name.startswith("b/")}
    name = rng.choice(("b/summary.csv", "b/traces.csv", "b/settings.json", "b/summary.parquet"))
    files[name] = broken(files[name], rng)
    return Case(kind, seed, (*BATCHED, "--resume"), beside() | files, ("b",), tuple(files))


FILES: dict[str, tuple[float, Callable[..., Case]]] = {}
"""Kind: (weight, what makes a case of kind and seed, and of the files of MADE if it damages those)."""


def _text(
    kind: str, change: Callable[[Lines, Rng], Lines], *where: Callable[[Rng], tuple[str, bytes, bool]]
) -> None:
    for source in where or (pdb,):
        name = f"{'mmCIF' if source is cif else 'PDB'}, {kind}"
        FILES[name] = (1.0, lambda kind, seed, source=source: text_case(kind, seed, source, change))


_text("lines left out", dropped, pdb, cif)
_text("lines doubled", doubled, pdb, cif)
_text("lines in another order", swapped, pdb, cif)
_text("lines cut", cut_lines, pdb, cif)
_text("odd characters", characters, pdb, cif)
_text("line ends", line_ends, pdb, cif)
_text("huge fields", huge, pdb, cif)
_text("fields overwritten", of_atoms(field_over))
_text("coordinates overwritten", of_atoms(numbers_over))
_text("fields blank", of_atoms(blanked))
_text("columns shifted", of_atoms(columns_shifted))
_text("atoms elsewhere", of_atoms(moved))
_text("atoms renamed", of_atoms(atoms_renamed))
_text("alternate locations", of_atoms(altlocs))
_text("occupancies and B", of_atoms(occupancies))
_text("elements and charges", of_atoms(elements))
_text("models", models)
_text("chains", chains)
_text("residues renumbered", residues_renumbered)
_text("residues twice", residues_doubled)
_text("residues renamed", of_atoms(residues_renamed))
_text("bonds at random", bonds)
_text("headers", headers)
_text("quotes", tokens(quotes), cif)
_text("values overwritten", tokens(words_over), cif)
_text("values missing or too many", loop_values, cif)
_text("columns", cif_columns, cif)
_text("categories", cif_categories, cif)
_text("keywords", cif_keywords, cif)
for _name, _source in (("PDB", pdb), ("mmCIF", cif)):
    FILES[f"{_name}, bytes changed"] = (1.0, lambda k, s, _source=_source: bytes_case(k, s, _source, flipped))
    FILES[f"{_name}, cut short"] = (1.0, lambda k, s, _source=_source: bytes_case(k, s, _source, truncated))
FILES |= {
    "packed files": (2.0, packed_case),
    "manifests": (1.0, manifest_case),
    "force fields": (1.0, forcefield_case),
}
OF_MADE = {
    "checkpoints": (1.0, checkpoint_case),
    "simulations, to go on with": (1.0, simulation_case),
    "batches, to go on with": (0.15, batch_case),
}
"""Of what commands have made; such a maker is called with :data:`Made`, too."""
FILES |= OF_MADE

FILES_BY_WEIGHT = {kind: weight for kind, (weight, _) in FILES.items()}

# Options.

NUMBERS = (
    "0",
    "-1",
    "1",
    "0.5",
    "nan",
    "inf",
    "-inf",
    "1e308",
    "-1e308",
    "1e-320",
    "",
    " ",
    "1,5",
    "\u0661",
    "abc",
    "7",
    "1e3",
)
COUNTS = ("0", "-1", "1", "2", "3", "nan", "1.5", "", " ", "1e3", "abc", "\u0663")
HUGE = ("2147483648", "9223372036854775808", "99999999999999999999999")
WORDS = (
    "", " ", "\u00e9", "\u6771\u4eac", "\x1b[31mred", "a\nb", "nan", "-1", "x" * 300, "[bold]", "%s {0}",
    "../..",
    "\udcff", "all", "none", ",", "a,b", "'", "(", "\0"[:0] + "*", "1", "A",
)  # fmt: skip
PATHS = (
    "in/ala10.pdb", "in/1l2y.pdb", "in", "missing.pdb", "no/such/x.pdb", "", " ", "\u00e4 \u03bb.pdb",
    "out.pdb",
    "out.cif", "out.npz", "out.csv", "out.html", "out.dcd", "out.xtc", "out", "in/ala10.pdb/x", "/dev/null",
    "/proc/x.pdb", "x" * 300, "new\nline.pdb", "-", "out\udcff.pdb", "~", "out.pdb.gz", ".", "in/list.csv",
    "in/text.txt", "in/[1].pdb", "*.pdb", "in/*.pdb",
)  # fmt: skip
STRINGS = {
    "hinges": ("phi psi", "phi psi chi omega", "phi psi chi rotors", "angles", "phi phi", "chi", "PHI",
    "phi,psi"),
    "move": ("resid 5:20", "sidechain", "all", "resid 2:4", "name CA", "interface", "protein and", "not all"),
    "forcefield": ("amber14", "amber99sb", "amber99sbildn", "amber19", "in/text.txt", "amber14,amber99sb",
    "in"),
    "solvent": ("vacuum", "obc2", "gbn2", "OBC2", "water"),
    "engine": ("auto", "native", "openmm", "gpu"),
    "cutoff": ("auto", "none", "1", "0.1", "0", "-1", "inf", "nan", "1e308", "2 nm"),
    "model": ("1", "2", "all", "1-5,8", "0", "-1", "1-", "5-1", "9" * 30),
    "chains": ("A", "B", "A,B", "a", "A,A", "A,"),
    "altloc": ("A", "B", "AB"),
    "keep": ("near", "none", "all", "water", "ions", "ligands", "HOH,ZN", "near,none"),
    "disulfide": ("A:3-A:40", "A:1-A:2", "A:1-A:1", "none", "A:1:SG-A:2:SG", "A:1"),
    "method": ("cartesian", "hybrid", "lbfgs", "newton", "kcm", "openmm", "kcm-metric", "md", "annealing",
    "LBFGS"),
    "methods": ("lbfgs", "kcm,lbfgs", "cartesian", "relax", "lbfgs,lbfgs", "relax,lbfgs", "lbfgs,"),
    "restrain": ("1000 100 0", "1000", "0", "-1", "nan", "1e308", "1,2", "10 x"),
    "thermostat": ("langevin", "nose-hoover", "rescale", "hmc", "none"),
    "integrator": ("leapfrog", "lobatto", "midpoint", "rk4", "dormand-prince"),
    "loops": ("open", "closed"),
    "trajectory": ("dcd", "xtc", "pdb"),
    "between": ("A:1:N-A:10:C", "A:1-A:10", "resid 1 - resid 10", "A:1-A:1", "A:1:N", "B:1-B:2"),
    "hinge_springs": ("omega 40 0.5", "phi 1 0", "phi", "phi nan 1", "phi -1 -1", "all 1 1"),
    "preset": ("predicted", "crystal", "design"),
    "protocol": ("alphafold", ""),
    "exclude": ("resid 5:20", "all", "none", "name"),
    "align": ("name CA", "all", "name CB", "backbone", "name"),
    "measure": ("name CA", "all", "backbone", "resid 1:3"),
    "sequence": ("AAA", "ACDEFG", "a", "AXA", "A A", "A" * 40, "AA-A", ">x", "G"),
    "rows": ("nothing",), "only": ("nothing",), "scheduler": ("nonsense", "tcp://127.0.0.1:1", ""),
}  # fmt: skip
WORK = {
    "n_steps", "max_evaluations", "max_iterations", "max_outer_iterations", "starts", "repeats", "workers",
    "jobs",
    "trajectory_length", "evaluations", "threads",
}  # fmt: skip
"""Options that cost time or processes, which huge values are allowed to."""
BOUNDS = {
    "minimise": {"max_evaluations": "3", "threads": "1", "output": "out.pdb"},
    "relax": {"max_iterations": "3", "threads": "1", "workers": "1", "output": "out.pdb"},
    "compare": {"methods": "lbfgs", "repeats": "1", "max_evaluations": "3", "threads": "1"},
    "batch": {"dry_run": None, "workers": "1"},
    "simulate": {"n_steps": "5", "threads": "1"},
    "info": {"threads": "1"},
    "build": {"output": "out.pdb"},
    "bench": {"rows": "nothing", "only": "nothing"},
}
"""Options and their values, where they were not drawn: what keeps a run short."""
OPTIONS = {
    "minimise": 5, "relax": 4, "simulate": 4, "validate": 4, "rmsd": 3, "info": 4, "build": 2, "batch": 4,
    "compare": 0.5, "bench": 1, "scene": 1,
}  # fmt: skip
"""Command: weight."""
ARGUMENTS = {
    "rmsd": ("in/ala10.pdb", "in/1l2y.pdb"), "build": ("AAA",), "bench": ("nonsense",),
    "scene": ("nonsense",),
}  # fmt: skip


@cache
def parameters(command: str) -> tuple[object, ...]:
    return tuple(typer.main.get_command(app).commands[command].params)


def options(command: str, seed: int) -> Case:
    """A random command line."""
    rng = Rng(f"{command} {seed}")
    every = [each for each in parameters(command) if each.name != "help"]
    own = [each for each in every if each.param_type_name == "option"]
    drawn = rng.sample(own, min(rng.choice((1, 1, 2, 3, 5)), len(own)))
    words, outputs = [command], []
    argument = list(ARGUMENTS.get(command, ("in/ala10.pdb",)))
    if rng.random() < 0.15:
        # A study or scene that is known would run for minutes.
        text = (
            STRINGS.get("sequence", ())
            if command == "build"
            else ()
            if command in ("bench", "scene")
            else PATHS
        )
        argument[-1] = rng.choice((*text, *WORDS[:8]))
    if command != "bench":
        argument = argument * rng.choice((1, 1, 1, 1, 1, 1, 1, 1, 2)) if rng.random() > 0.03 else []
    words += argument
    for each in drawn * (2 if rng.random() < 0.05 else 1):
        flag = rng.choice((*each.opts, *each.secondary_opts))
        words.append(flag)
        if not each.is_flag and rng.random() > 0.02:
            words.append(given(each, rng))
            outputs.append(words[-1])
    names = {each.name for each in drawn}
    for name, bound in BOUNDS.get(command, {}).items():
        if name not in names or name == "dry_run":
            flag = next(each for each in every if each.name == name).opts[-1]
            words += [flag] if bound is None else [flag, bound]
    if rng.random() < 0.03:
        words.insert(
            rng.randrange(len(words) + 1), rng.choice(("--nonsense", "-x", "--", "-", "--json=1", "--help"))
        )
    files = beside() | {
        "in/list.csv": MANIFEST.encode(), "in/text.txt": b"some text\n",
        "in/[1].pdb": beside()["in/ala10.pdb"],
    }  # fmt: skip
    return Case(f"options of {command}", seed, tuple(words), files, (), tuple(outputs))


def given(parameter: object, rng: Rng) -> str:
    """A value for an option."""
    name, kind = parameter.name, parameter.bare_type
    if name in STRINGS and rng.random() < 0.7:
        return rng.choice(STRINGS[name])
    if kind in (int, float) and rng.random() < 0.4:
        return rng.choice(("1", "2", "3"))
    if kind is int:
        return rng.choice(COUNTS if name in WORK else COUNTS + HUGE)
    if kind is float:
        return rng.choice(NUMBERS)
    return rng.choice(PATHS if kind is Path else WORDS)
