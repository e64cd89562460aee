"""Kinds of file that people bring, each made by a short recipe, with what is expected of it.

What becomes of a file is measured in fate.py against what it means, by places in space, so that no name need
be believed. Kinds that need ../shared are left out where that folder is not.
"""

import bz2
import gzip
import lzma
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import gemmi
import numpy as np
from recipes import (
    ACETATE,
    BENZAMIDINE,
    CHLOROPHENOL,
    COMPLEXES,
    D_NAMES,
    GLYCEROL,
    MODIFIED,
    MORE,
    PAIRS,
    PHOSPHATE,
    SAMPLES,
    SHARED,
    SULPHATE,
    Build,
    Write,
    _body,
    acetylated,
    adduct,
    after,
    as_bare_pdb,
    as_cif,
    as_pdb,
    before_atoms,
    before_end,
    beyond,
    chain_named,
    charmm_names,
    chelated,
    cif_with,
    cif_without,
    edited,
    every_atom,
    four_letters,
    gromacs_names,
    histidines,
    hydrated,
    in_chain,
    lines_without,
    linked,
    mirrored,
    new_atom,
    new_residue,
    of_shared,
    old_hydrogens,
    places,
    pushed,
    put,
    pyroglutamate,
    read_file,
    records,
    renamed,
    residue,
    rotation,
    sample,
    shifted_numbers,
    then,
    trp,
    unstated,
    with_chain,
    with_hydrogen,
    with_ion,
    with_modified,
    with_molecule,
    without_atoms,
    without_residues,
)


@dataclass(frozen=True)
class Kind:
    """One kind of file.

    Parameters
    ----------
    name, family : str
    build : callable
        Makes what the file means.
    write : callable
        Makes the file from it.
    suffix : str
    refused : str
        Word of the one line that must refuse it; empty if it must be taken.
    links : int
        Bonds to molecules beside the protein, or between side chains, but for disulfides and metals; below 0
        for any number.
    keeps : bool
        Whether every heavy atom stays; if not, those lost must be named.
    needs : str
        File of ../shared that it is made from.
    options : mapping
        Of ``pc.load``.
    is_made : bool
        Whether a recipe made it; if not, it is a real file as it stands.
    """

    name: str
    family: str
    build: Build
    write: Write
    suffix: str = ".pdb"
    refused: str = ""
    links: int = 0
    keeps: bool = True
    needs: str = ""
    options: Mapping[str, Any] = field(default_factory=dict)
    is_made: bool = True

    @property
    def is_here(self) -> bool:
        """Whether what it is made from is there."""
        return not self.needs or (SHARED / self.needs).exists()

    def make(self, folder: Path) -> tuple[Path, gemmi.Structure]:
        """Write the file into a folder; return its path, and what it means."""
        meant = self.build()
        content = self.write(meant)
        path = folder / f"{self.name}{self.suffix}"
        path.write_bytes(content.encode("utf-8") if isinstance(content, str) else content)
        return path, meant


KINDS: list[Kind] = []


def add(
    family: str, name: str, build: Build, write: Write = as_pdb, suffix: str = ".pdb", **more: object
) -> None:
    KINDS.append(Kind(name, family, build, write, suffix, **more))  # type: ignore[arg-type]


def of(name: str, hydrogens: bool = False, waters: bool = False) -> Build:
    return lambda: sample(name, hydrogens, waters)


# fmt: off
# Packing and text.
F = "PDB text"
add(F, "plain", trp)
add(F, "with-hydrogens", of("1l2y", True))
add(F, "gzip", trp, lambda s: gzip.compress(as_pdb(s).encode()), ".pdb.gz")
add(F, "bzip2", trp, lambda s: bz2.compress(as_pdb(s).encode()), ".pdb.bz2")
add(F, "xz", trp, lambda s: lzma.compress(as_pdb(s).encode()), ".pdb.xz")
add(F, "packed-under-a-plain-name", trp, lambda s: gzip.compress(as_pdb(s).encode()))
add(F, "crlf", trp, then(as_pdb, lambda t: t.replace("\n", "\r\n")))
add(F, "cr-alone", trp, then(as_pdb, lambda t: t.replace("\n", "\r")))
add(F, "byte-order-mark", trp, then(as_pdb, lambda t: "\ufeff" + t))
add(F, "ent-suffix", trp, suffix=".ent")
add(F, "no-element-columns", of("1ubq"), then(as_bare_pdb, records(lambda line: line[:66])))
add(F, "no-element-columns-hydrogens", of("1vii", True), then(as_bare_pdb, records(lambda line: line[:66])))
add(F, "coordinates-alone", trp, then(as_bare_pdb, records(lambda line: line[:54])))
add(F, "entry-name-in-the-last-columns", trp, then(as_bare_pdb,
    records(lambda line: f"{line[:66]:<72}1L2Y{line[6:11].strip():>4}")))
add(F, "lower-case", edited(trp, chain_named("a")), then(as_bare_pdb, str.lower))
add(F, "hybrid-36-serials", trp, then(as_bare_pdb,
    records(lambda line: f"{line[:6]}A{line[7:11].strip():0>4}{line[11:]}")))
add(F, "hybrid-36-numbers", edited(of("1ubq"), shifted_numbers(9960)))
add(F, "serials-as-stars", trp, then(as_bare_pdb, put(7, "*****")))
add(F, "serials-of-six-digits", trp, then(as_bare_pdb,
    records(lambda line: f"ATOM  {100000 + int(line[6:11])}{line[12:]}")))
add(F, "no-chain-id", edited(trp, chain_named("")), then(as_bare_pdb, put(22, " ")))
add(F, "segids", edited(trp, chain_named("")), then(as_bare_pdb, put(22, " "),
    records(lambda line: f"{line[:72]:<72}PROA{line[76:]}")))
add(F, "digit-as-chain-id", edited(trp, chain_named("1")), then(as_bare_pdb, put(22, "1")))
add(F, "lower-case-chain-id", edited(trp, chain_named("a")), then(as_bare_pdb, put(22, "a")))
add(F, "two-letter-chain-id-in-columns-21-22", edited(trp, chain_named("AA")), then(as_bare_pdb, put(21,
    "AA")))
add(F, "models", of("1vii"), then(as_bare_pdb,
    lambda t: "".join(f"MODEL     {k:4}\n{_body(t)}ENDMDL\n" for k in (1, 2)) + "END\n"))
add(F, "models-without-endmdl", of("1vii"), then(as_bare_pdb,
    lambda t: "".join(f"MODEL     {k:4}\n{_body(t)}" for k in (1, 2)) + "END\n"))
add(F, "model-0", trp, then(as_bare_pdb, lambda t: f"MODEL        0\n{_body(t)}ENDMDL\nEND\n"))
add(F, "end-after-each-model", trp, then(as_bare_pdb, lambda t: f"{t}{t}"))
add(F, "no-ter", of("3i40"), then(as_pdb, lines_without("TER")))
add(F, "no-end", trp, then(as_bare_pdb, lines_without("END")))
add(F, "ter-after-each-residue", trp, then(as_bare_pdb,
    records(lambda line: f"TER\n{line}" if line[12:16] == " N  " else line)))
add(F, "ter-without-fields", of("3i40"), then(as_pdb, lambda t: re.sub(r"(?m)^TER.*$", "TER", t)))
add(F, "blank-lines", trp, then(as_bare_pdb, lambda t: t.replace("TER", "\n\nTER")))
add(F, "trailing-blanks", trp, then(as_bare_pdb, lambda t: re.sub(r"(?m)$", " " * 20, t)))
add(F, "remarks-not-ascii", trp, then(as_pdb,
    before_atoms("REMARK   1 PR\u00c9PAR\u00c9 PAR \u6771\u4eac \u03b1-helix 3\u00c5")))
add(F, "anisou", trp, then(as_bare_pdb,
    records(lambda line: f"{line}\nANISOU{line[6:27]}    1000   1000   1000      0      0{line[63:]}")))
add(F, "master-and-conect", trp, then(as_bare_pdb, before_end("CONECT    1    2",
    "CONECT    2    1    3    5", "MASTER        0    0    0    0    0    0    0    6  154    1    2    0")))
add(F, "hetatm-for-all", trp, then(as_bare_pdb, records(lambda line: f"HETATM{line[6:]}")))
add(F, "zero-occupancies", edited(trp, every_atom(lambda r, a: setattr(a, "occ", 0.0))))
add(F, "negative-b-factors", edited(trp, every_atom(lambda r, a: setattr(a, "b_iso", -3.0))))
add(F, "b-factors-of-0-to-1", edited(trp, every_atom(lambda r, a: setattr(a, "b_iso", 0.87))))
add(F, "far-from-the-origin", edited(trp, every_atom(lambda r, a: setattr(a, "pos",
    gemmi.Position(a.pos.x + 900, a.pos.y - 700, a.pos.z)))))
add(F, "html-instead", trp,
    lambda s: "<!DOCTYPE html>\n<html><head><title>404 Not Found</title></head></html>\n", refused="no atoms")
add(F, "empty", trp, lambda s: "", refused="no atoms")
add(F, "cut-within-a-record", trp, then(as_pdb, lambda t: t[: t.index("ATOM") + 81 * 60 + 40]),
    refused="cut short")
add(F, "cut-after-a-record", trp, then(as_pdb,
    lambda t: "SEQRES   1 A   20  ASN LEU TYR ILE GLN TRP\n" + t[: t.index("ATOM") + 81 * 60]),
    refused="cut short")
add(F, "stars-for-coordinates", trp, then(as_bare_pdb,
    records(lambda line: f"{line[:30]}********{line[38:]}" if line[12:16] == " CZ " else line)),
    refused="not a number")
add(F, "nan-for-coordinates", trp, then(as_bare_pdb,
    records(lambda line: f"{line[:30]}     nan{line[38:]}" if line[12:16] == " CZ " else line)),
    refused="not a number")
add(F, "separated-by-blanks", trp, then(as_bare_pdb, records(lambda line: " ".join(line.split()))),
    refused="line")
add(F, "binary", trp, lambda s: b"\x00\x01\x02MMTF" + bytes(range(200)), refused="binary")
add(F, "sequence-alone", trp, lambda s: ">1L2Y\nNLYIQWLKDGGPSSGRPPPS\n", ".fasta", refused="no atoms")

# Numbers, locations, repetitions.
F = "Ids"
add(F, "negative-numbers", edited(trp, shifted_numbers(-5)))
add(F, "number-0", edited(trp, shifted_numbers(-1)))


def _with_codes(structure: gemmi.Structure) -> None:
    for r, (number, code) in zip(structure[0][0], [(1, " "), (1, "A"), (1, "B"), *((k, " ") for k in range(2,
        60))], strict=False):
        r.seqid = gemmi.SeqId(number, code)


def _codes_backwards(structure: gemmi.Structure) -> None:
    for r, (number, code) in zip(structure[0][0], [(1, "B"), (1, "A"), (1, " "), *((k, " ") for k in range(2,
        60))], strict=False):
        r.seqid = gemmi.SeqId(number, code)


def _renumber(numbers: Iterable[int]):
    def change(structure: gemmi.Structure) -> None:
        for r, n in zip(structure[0][0], numbers, strict=False):
            r.seqid = gemmi.SeqId(n, " ")

    return change


add(F, "insertion-codes", edited(trp, _with_codes))
add(F, "insertion-codes-backwards", edited(trp, _codes_backwards))
add(F, "numbers-with-a-gap-but-bonded", edited(trp, _renumber([*range(1, 11), *range(101, 111)])))
add(F, "numbers-downwards", edited(trp, _renumber(range(40, 0, -1))))
add(F, "one-number-for-all", edited(trp, _renumber([1] * 20)), refused="is there 4 times")
add(F, "ions-that-share-a-number", with_ion(with_ion(trp, "NA", "NA", "Na", near=3.0, turn=1), "NA",
    "NA", "Na", near=3.0, turn=2), as_bare_pdb)
add(F, "ligands-that-share-a-number", with_molecule(with_molecule(trp, "SO4", SULPHATE, turn=1), "SO4",
    SULPHATE, turn=2), as_bare_pdb)
add(F, "ligands-that-share-a-number-in-mmcif", with_molecule(with_molecule(trp, "SO4", SULPHATE, turn=1),
    "SO4", SULPHATE, turn=2), as_cif, ".cif")
add(F, "chains-that-share-an-id", edited(of("3i40"), unstated), then(as_bare_pdb, put(22, "A")))
add(F, "chains-without-ids", edited(of("3i40"), unstated, chain_named("", "A")), then(as_bare_pdb, put(22,
    " ")))
add(F, "models-without-records", edited(of("1vii"), chain_named("A")), then(as_bare_pdb,
    lambda t: _body(t) * 2 + "END\n"), refused="lies upon")
add(F, "chains-that-share-an-id-and-numbers-apart", edited(of("3i40"), lambda s: [setattr(r, "seqid",
    gemmi.SeqId(r.seqid.num + 100, " ")) for r in s[0]["B"]], chain_named("A", "A")), as_bare_pdb)


def _with_alternates(first: str, second: str, shift: float = 0.6):
    def change(structure: gemmi.Structure) -> None:
        r = residue(structure, 8)
        for a in [a.clone() for a in r if a.name not in ("N", "CA", "C", "O", "CB")]:
            r[a.name][0].altloc, a.altloc = first, second
            r[a.name][0].occ, a.occ = 0.4, 0.6
            a.pos = gemmi.Position(a.pos.x, a.pos.y + shift, a.pos.z)
            r.add_atom(a)

    return change


add(F, "altlocs", edited(trp, _with_alternates("A", "B")))
add(F, "altlocs-of-digits", edited(trp, _with_alternates("1", "2")))
add(F, "altloc-blank-and-a", edited(trp, _with_alternates("\0", "A")))
add(F, "altloc-b-alone", edited(trp, every_atom(lambda r, a: setattr(a, "altloc", "B"))))
add(F, "altlocs-in-mmcif", edited(trp, _with_alternates("A", "B")), as_cif, ".cif")
add(F, "atoms-twice", trp, then(as_bare_pdb,
    records(lambda line: f"{line}\n{line}" if line[22:26] == "   8" else line)))
add(F, "point-mutations-in-one-place", of("1ejg"), lambda s: (SAMPLES / "1ejg.pdb").read_text())

# mmCIF.
F = "mmCIF text"
add(F, "cif", trp, as_cif, ".cif")
add(F, "cif-of-the-archive", of("1ubq.cif"), lambda s: (SAMPLES / "1ubq.cif").read_text(), ".cif")
add(F, "cif-gzip", trp, lambda s: gzip.compress(as_cif(s).encode()), ".cif.gz")
add(F, "cif-under-a-pdb-name", trp, as_cif, ".pdb")
add(F, "pdb-under-a-cif-name", trp, as_pdb, ".cif")
add(F, "cif-crlf", trp, then(as_cif, lambda t: t.replace("\n", "\r\n")), ".cif")
add(F, "cif-byte-order-mark", trp, then(as_cif, lambda t: "\ufeff" + t), ".cif")
add(F, "cif-with-comments-first", trp, then(as_cif, lambda t: "# by hand\n\n# twice\n" + t), ".cif")
add(F, "cif-atoms-alone", of("3i40"), then(as_cif, lambda t: "data_x\n" + t[t.index("loop_\n_atom_site.") :]),
    ".cif")
add(F, "cif-without-occupancy-and-b", trp, then(as_cif, cif_without("_atom_site.occupancy",
    "_atom_site.B_iso_or_equiv")), ".cif")
add(F, "cif-without-elements", trp, then(as_cif, cif_without("_atom_site.type_symbol")), ".cif",
    refused="type_symbol")
for _tag in ("id", "label_alt_id", "label_asym_id"):
    add(F, f"cif-without-{_tag.replace('_', '-')}", trp, then(as_cif, cif_without(f"_atom_site.{_tag}")),
        ".cif")
add(F, "cif-without-auth-ids", of("3i40"), then(as_cif, lines_without("XXXX"), cif_without("_struct_conn.",
    "_struct_conf.", "_struct_sheet_range."), cif_without("_atom_site.auth_asym_id"),
    cif_without("_atom_site.auth_seq_id"), lambda t: t.replace("Axp", "A").replace("Bxp", "B")), ".cif")
add(F, "cif-without-label-ids", of("3i40"), then(as_cif, cif_without("_atom_site.label_seq_id",
    "_atom_site.label_entity_id")), ".cif")
add(F, "cif-without-entities", trp, then(as_cif, cif_without("_entity.", "_entity_poly.", "_entity_poly_seq.",
    "_struct_asym.")), ".cif")
add(F, "cif-several-blocks", trp, then(as_cif, lambda t: "data_first\n_entry.id first\n\n" + t), ".cif")
add(F, "cif-text-fields", trp, then(as_cif, lambda t: t.replace("\nloop_\n_atom_site.",
    "\n_struct.title\n;a title\nof two lines\n;\n#\nloop_\n_atom_site.",
    1) if "_struct.title" not in t else t), ".cif")
add(F, "cif-upper-case-keywords", trp, then(as_cif, lambda t: t.replace("loop_", "LOOP_").replace("data_",
    "DATA_", 1)), ".cif")
add(F, "cif-truncated", of("1ubq.cif"), lambda s: (SAMPLES / "1ubq.cif").read_text()[:60000].rsplit("\n",
    1)[0], ".cif", refused="cut short")
add(F, "cif-row-cut", trp, then(as_cif, lambda t: t[: t.index("ATOM") + 3000]), ".cif",
    refused="cannot be read")
add(F, "cif-without-coordinates", trp, then(as_cif, cif_without("_atom_site.")), ".cif", refused="no atoms")
add(F, "binary-cif", trp, lambda s: b"\x83\xa7encoder\xa3x\x00\xa8version\xa50.3.0" + bytes(300), ".bcif",
    refused="binary")
add(F, "pdbml", trp,
    lambda s: "<?xml version='1.0'?>\n<PDBx:datablock datablockName='1L2Y'>\n</PDBx:datablock>\n", ".xml",
    refused="no atoms")
add(F, "mmjson", trp, lambda s: '{"data_1L2Y": {"atom_site": {"Cartn_x": [1.0]}}}\n', ".json",
    refused="cannot be read")
add(F, "cif-chains-of-two-letters", edited(of("3i40"), unstated, lambda s: [setattr(c, "name",
    c.name * 2) for c in s[0]]), as_cif, ".cif")
add(F, "cif-chains-of-four-letters", edited(of("3i40"), unstated, lambda s: [setattr(c, "name",
    f"{c.name}-2x") for c in s[0]]), as_cif, ".cif")
add(F, "cif-large-numbers", edited(trp, shifted_numbers(12340)), as_cif, ".cif")

# Names and habits of programs.
F = "Programs"
for _his in ("HSD", "HSE", "HSP"):
    add(F, f"charmm-{_his.lower()}", edited(of("1ubq"), charmm_names(_his)))
add(F, "charmm-hydrogens-segids-no-elements", edited(of("1vii", True), chain_named(""), charmm_names()),
    then(as_bare_pdb, put(22, " "), records(lambda line: f"{line[:66]:<72}PROA")))
add(F, "charmm-hydrogens-trp-cage", edited(of("1l2y", True), charmm_names()), as_bare_pdb)
add(F, "gromacs", edited(of("1vii", True), gromacs_names), as_bare_pdb)
add(F, "gromacs-lysh-hisb", of("3i40"), then(as_bare_pdb, four_letters({"LYS": "LYSH", "HIS": "HISB"})))
add(F, "gromos-terminus", edited(of("1ubq"), every_atom(lambda r, a: setattr(a, "name", {"O": "O1",
    "OXT": "O2"}.get(a.name, a.name)) if r.seqid.num == 76 else None)))
add(F, "amber-states", edited(of("1ubq"), renamed({"HIS": "HID", "ASP": "ASH", "GLU": "GLH", "LYS": "LYN"})))
add(F, "amber-cyx", edited(of("4pti"), unstated, renamed({"CYS": "CYX"})), as_bare_pdb)
add(F, "amber-cym", edited(with_modified("CYS"), renamed({"CYS": "CYM"})))
add(F, "amber-terminal-names", trp, then(as_bare_pdb,
    records(lambda line: f"{line[:17]}{_TERMINAL.get(line[22:26].strip(), line[17:21])}{line[21:]}")))
_TERMINAL = {"1": "NASN", "20": "CSER"}
add(F, "amber-no-chain-no-elements", edited(of("1vii", True), chain_named("")), then(as_bare_pdb, put(22,
    " "), records(lambda line: line[:54] + "  1.00  0.00")))
add(F, "pdb-version-2-hydrogens", of("1vii", True), then(as_bare_pdb, old_hydrogens))
add(F, "pdb-version-2-hydrogens-no-elements", of("1vii", True), then(as_bare_pdb, old_hydrogens,
    records(lambda line: line[:66])))
add(F, "rosetta", of("1vii", True), then(as_bare_pdb, old_hydrogens, before_atoms("HEADER    ROSETTA"),
    after("# All scores below are weighted scores, not raw scores.", "#BEGIN_POSE_ENERGIES_TABLE model.pdb",
    "label fa_atr fa_rep total", "pose -1.0 2.0 1.0", "#END_POSE_ENERGIES_TABLE model.pdb")))
add(F, "openmm", of("1vii", True), then(as_bare_pdb,
    before_atoms("REMARK   1 CREATED WITH OPENMM 8.1, 2024-01-01")))
add(F, "pymol", trp, then(as_bare_pdb, records(lambda line: f"{line[:72]:<76}{line[76:78]}"),
    before_end(*(f"CONECT{k:5}{k + 1:5}" for k in range(1, 9)))))
add(F, "pymol-pseudoatom", with_ion(trp, "PSD", "PS1", "X", near=3.4), keeps=False)
add(F, "phenix", of("1vii", True), then(as_pdb,
    before_atoms("CRYST1    1.000    1.000    1.000  90.00  90.00  90.00 P 1")))
add(F, "maestro-caps-and-charges", edited(acetylated(trp), renamed({"NME": "NMA"})), then(as_bare_pdb,
    records(lambda line: f"{line[:78]}1+" if line[12:16] == " NZ " else line)))
add(F, "modeller", trp, then(as_bare_pdb, before_atoms("EXPDTA    THEORETICAL MODEL, MODELLER 10.4",
    "REMARK   6 MODELLER OBJECTIVE FUNCTION:       123.4567")))
add(F, "swiss-model", trp, then(as_bare_pdb, before_atoms("TITLE     SWISS-MODEL SERVER",
    "REMARK   3  GMQE    0.85")))
add(F, "mdanalysis", edited(trp, chain_named("X")), then(as_bare_pdb, put(22, "X"),
    records(lambda line: f"{line[:72]:<72}SYST{line[76:]}"),
    before_atoms("TITLE     MDANALYSIS FRAME 0: Created by PDBWriter",
    "CRYST1    1.000    1.000    1.000  90.00  90.00  90.00 P 1           1")))
add(F, "biopython", trp, then(as_bare_pdb, lambda t: t.replace("TER   ", "TER   ").rstrip() + "   \n"))
add(F, "foldx-scwrl-no-hydrogens-short-lines", trp, then(as_bare_pdb, records(lambda line: line[:60])))
add(F, "xplor", edited(of("1vii", True), chain_named(""), charmm_names()), then(as_bare_pdb,
    records(lambda line: f"{line[:21]} {line[22:66]:<50}A   ")))
add(F, "haddock", of("3i40"), then(as_pdb, lines_without("SSBOND"),
    records(lambda line: f"{line[:72]}{line[21]}   {line[76:]}")))

# Predictors.
F = "Predictors"
PLDDT = edited(trp, every_atom(lambda r, a: setattr(a, "b_iso", 91.5)))
add(F, "alphafold-2", PLDDT, then(as_bare_pdb, lambda t: f"PARENT N/A\nMODEL     1\n{_body(t)}ENDMDL\nEND\n"))
add(F, "colabfold", PLDDT, then(as_bare_pdb, lambda t: f"MODEL     1\n{_body(t)}ENDMDL\nEND\n"))
add(F, "esmfold", edited(PLDDT, without_atoms(lambda r, a: a.name == "OXT")), then(as_bare_pdb,
    before_atoms("PARENT N/A")))
add(F, "openfold-modelcif", PLDDT, then(as_cif, cif_with("_ma_qa_metric.", ["id", "name", "type", "mode"],
    [["1", "pLDDT", "pLDDT", "global"]]), cif_with("_ma_qa_metric_local.", ["ordinal_id", "model_id",
    "label_asym_id", "label_seq_id", "metric_id", "metric_value"], [["1", "1", "A", "1", "1", "91.50"]])),
    ".cif")
add(F, "alphafold-3", with_molecule(PLDDT, "LIG_B", GLYCEROL, chain="B", number=1), then(as_cif,
    cif_with("_pdbx_data_usage.", ["id", "type", "details"], [["1", "license", "NON-COMMERCIAL USE ONLY"]])),
    ".cif")
add(F, "boltz", with_molecule(PLDDT, "LIG1", CHLOROPHENOL, chain="B", number=1), as_cif, ".cif")
add(F, "chai", with_molecule(PLDDT, "LIG2", [(f"{n}_1", e, x) for n, e, x in GLYCEROL], chain="B", number=1),
    as_cif, ".cif")
add(F, "chai-two-ligands", with_molecule(with_molecule(PLDDT, "LIG3", [(f"{n}_1", e, x) for n, e,
    x in GLYCEROL], chain="C", number=1, turn=1), "LIG4", [(f"{n}_1", e, x) for n, e, x in GLYCEROL],
    chain="D", number=1, turn=2), as_cif, ".cif")
add(F, "protenix-five-letter-ligand", with_molecule(PLDDT, "A1AA6", BENZAMIDINE, chain="B", number=1), as_cif,
    ".cif")
add(F, "rosettafold", PLDDT, then(as_bare_pdb, lines_without("TER", "END"),
    records(lambda line: f"{line[:60]}  0.92")))
add(F, "rosettafold-all-atom-ligand", with_molecule(PLDDT, "LG1", BENZAMIDINE, chain="B", number=1),
    as_bare_pdb)
add(F, "rfdiffusion-backbone-of-glycines", edited(trp, without_atoms(lambda r, a: a.name not in ("N", "CA",
    "C", "O")), renamed(dict.fromkeys(PAIRS, "GLY") | {"ILE": "GLY", "VAL": "GLY", "THR": "GLY",
    "ALA": "GLY"})), as_bare_pdb)
add(F, "backbone-with-names", edited(trp, without_atoms(lambda r, a: a.name not in ("N", "CA", "C", "O"))),
    as_bare_pdb)
add(F, "backbone-without-oxygens", edited(trp, without_atoms(lambda r, a: a.name not in ("N", "CA", "C"))),
    as_bare_pdb)

# Termini and caps.
F = "Termini and caps"
add(F, "ace-nme", acetylated(trp))
add(F, "ace-nh2", acetylated(trp, "NH2"))
add(F, "ace-nma", edited(acetylated(trp), renamed({"NME": "NMA"})))
add(F, "no-oxt", edited(trp, without_atoms(lambda r, a: a.name == "OXT")))
add(F, "oxt-within-a-chain", edited(trp, lambda s: residue(s, 10).add_atom(new_atom("OXT", "O",
    beyond(residue(s, 10)["C"][0].pos.tolist(), residue(s, 10)["CA"][0].pos.tolist(), residue(s,
    10)["O"][0].pos.tolist(), r=1.25)))), keeps=False)
add(F, "pyroglutamate", pyroglutamate, keeps=False)
add(F, "neutral-n-terminus", edited(of("1l2y", True), without_atoms(lambda r, a: a.name == "H3")))


def _caps_in_the_residue(structure: gemmi.Structure) -> None:
    """CHARMM's ACE and CT3 patches: their atoms are in the first and last residues."""
    chain = structure[0][0]
    for old, new, table in ((0, 1, {"CH3": "CAY", "C": "CY", "O": "OY"}), (-1, -2, {"N": "NT", "C": "CAT"})):
        for a in chain[old]:
            moved = a.clone()
            moved.name = table[a.name]
            chain[new].add_atom(moved)
    del chain[-1]
    del chain[0]


add(F, "charmm-caps-in-their-residues", edited(acetylated(trp), _caps_in_the_residue), refused="CAY")

# Protonation.
F = "Protonation"


def _exchanged(structure: gemmi.Structure) -> None:
    """Amide hydrogens, each with deuterium as another location."""
    for r in structure[0][0]:
        for h in [a for a in r if a.name == "H"]:
            d = h.clone()
            d.name, d.element = "D", gemmi.Element("D")
            h.altloc, h.occ, d.altloc, d.occ = "A", 0.4, "B", 0.6
            r.add_atom(d)


for _name, _which in (("delta", "D"), ("epsilon", "E"), ("both", "DE")):
    add(F, f"histidine-{_name}-by-hydrogens", edited(of("1ubq"), histidines(_which)))
add(F, "aspartic-acid-by-hydrogen", edited(trp, with_hydrogen(9, "HD2", "CB", "CG", "OD2")))
add(F, "glutamic-acid-by-hydrogen", edited(of("1vii"), with_hydrogen(45, "HE2", "CG", "CD", "OE2")))
add(F, "neutral-lysine-by-hydrogens", edited(of("1l2y", True), without_atoms(lambda r,
    a: r.seqid.num == 8 and a.name == "HZ3")))
add(F, "deuterium", edited(of("1l2y", True), every_atom(lambda r, a: (setattr(a, "element",
    gemmi.Element("D")), setattr(a, "name", "D" + a.name[1:])) if a.name in ("H", "HZ1", "HZ2",
    "HZ3") else None)))
add(F, "deuterium-beside-hydrogen", edited(of("1l2y", True), _exchanged))
add(F, "hydrogens-of-some-residues", edited(of("1l2y", True), without_atoms(lambda r,
    a: r.seqid.num > 10 and a.is_hydrogen())))
add(F, "polar-hydrogens-alone", edited(of("1l2y", True), without_atoms(lambda r,
    a: a.is_hydrogen() and a.name not in ("H", "HE1", "HZ1", "HZ2", "HZ3", "H1", "H2", "H3", "HH"))))

# Modified residues.
F = "Modified residues"
_SAME = ("CYS", "MSE", "HYP", "DAL", "UNK")
for _name in MODIFIED:
    if _name not in ("CYS", "UNK", "DAL"):
        add(F, _name.lower(), with_modified(_name), keeps=_name in _SAME,
            refused="unknown amino acid" if _name in ("NVA", "SEC") else "")
add(F, "mse-with-charges-in-mmcif", with_modified("MSE"), as_cif, ".cif")
add(F, "mse-unstated-as-atom", edited(with_modified("MSE"), lambda s: setattr(residue(s, 53), "het_flag",
    "A")), as_bare_pdb)
add(F, "sep-with-modres", with_modified("SEP"), then(as_pdb,
    before_atoms("MODRES 1L2Y SEP A   13  SER  PHOSPHOSERINE", "HET    SEP  A  13      10",
    "HETNAM     SEP PHOSPHOSERINE")), keeps=False)
add(F, "unknown-residue", with_modified("UNK"), refused="UNK")
add(F, "unknown-name", edited(trp, lambda s: setattr(residue(s, 7), "name", "XQZ")), refused="XQZ")
add(F, "n-methyl-glutamine-in-mmcif", with_modified("MEQ"), as_cif, ".cif", keeps=False)

# D residues.
F = "D residues"
add(F, "d-alanine", with_modified("DAL"))
add(F, "d-name-of-an-l-residue", edited(trp, lambda s: setattr(residue(s, 2), "name", "DLE")))
add(F, "mirror-image", edited(trp, mirrored, renamed(D_NAMES)))
add(F, "mirror-image-under-l-names", edited(trp, mirrored))
add(F, "mirror-image-in-mmcif", edited(trp, mirrored, renamed(D_NAMES)), as_cif, ".cif")


def _racemic() -> gemmi.Structure:
    out, other = trp(), edited(trp, mirrored, renamed(D_NAMES))()
    away = places(out)[:, 0].max() - places(other)[:, 0].min() + 4.0
    every_atom(lambda r, a: setattr(a, "pos", gemmi.Position(round(a.pos.x + away, 3), a.pos.y,
        a.pos.z)))(other)
    chain = other[0][0]
    chain.name = "B"
    out[0].add_chain(chain)
    return out


add(F, "racemic", _racemic)


def _flip_hand(structure: gemmi.Structure) -> None:
    """C-beta and hydrogen of residue 9 exchanged."""
    r = residue(structure, 9)
    x = {a.name: np.array(a.pos.tolist()) for a in r}
    normal = np.cross(x["N"] - x["CA"], x["C"] - x["CA"])
    normal /= np.linalg.norm(normal)
    for a in r:
        if a.name not in ("N", "CA", "C", "O"):
            p = np.array(a.pos.tolist())
            a.pos = gemmi.Position(*np.round(p - 2 * ((p - x["CA"]) @ normal) * normal, 3).tolist())


add(F, "a-wrong-hand", edited(trp, _flip_hand))

# Disulfides and cross-links.


def _moved(number: int, name: str, by: tuple[float, float, float]):
    def change(structure: gemmi.Structure) -> None:
        a = residue(structure, number)[name][0]
        a.pos = gemmi.Position(*np.round(np.array(a.pos.tolist()) + by, 3).tolist())

    return change


F = "Disulfides"
add(F, "disulfides-stated", of("4pti"))
add(F, "disulfides-unstated", edited(of("4pti"), unstated))
add(F, "disulfides-in-mmcif", of("4pti"), as_cif, ".cif")
add(F, "disulfides-stated-wrongly", edited(of("4pti"), unstated, linked(("A", 5, "CYS", "SG"), ("A", 14,
    "CYS", "SG"), "Disulf")))
add(F, "disulfide-to-another-copy", edited(of("4pti"), unstated), then(as_pdb,
    before_atoms("SSBOND   1 CYS A    5    CYS A    5                          1555   2655  2.04")))
add(F, "disulfides-between-chains", of("3i40"))
add(F, "disulfide-stretched", edited(of("4pti"), unstated, _moved(14, "SG", (-0.5, -0.3, 0.0))))
add(F, "lactam", of_shared("structures/2n0n_lactam.pdb"), lambda s: (MORE / "2n0n_lactam.pdb").read_text(),
    needs="structures/2n0n_lactam.pdb", refused="PH8", is_made=False)

# Ions.
F = "Ions"
for _name, _atom, _element in (
    ("NA", "NA", "Na"), ("CL", "CL", "Cl"), ("K", "K", "K"), ("SOD", "SOD", "Na"), ("CLA", "CLA", "Cl"),
        ("POT", "POT", "K"), ("CAL", "CAL", "Ca"),
    ("CES", "CES", "Cs"), ("Na+", "Na+", "Na"), ("Cl-", "Cl-", "Cl"), ("ZN2", "ZN", "Zn"), ("IOD", "I", "I"),
        ("CIO", "CIO", "Cs"),
):  # fmt: skip
    if _name != "CIO":
        add(F, f"ion-{_name.lower()}".replace("+", "-plus").replace("cl-", "cl-minus"), with_ion(of("1ubq"),
            _name, _atom, _element, near=3.0))
add(F, "ion-charges-in-pdb", with_ion(of("1ubq"), "MG", "MG", "Mg", 2, near=3.0))
add(F, "ion-charges-in-mmcif", with_ion(of("1ubq"), "CL", "CL", "Cl", -1, near=3.0), as_cif, ".cif")
add(F, "magnesium-in-water", hydrated(of("1ubq"), "MG", "Mg", 2.07))
add(F, "calcium-in-water", hydrated(of("1ubq"), "CA", "Ca", 2.4), keeps=False)
add(F, "zinc-in-water-mmcif", hydrated(of("1ubq"), "ZN", "Zn", 2.08), as_cif, ".cif")
add(F, "calcium-at-a-carboxylate", chelated("1ubq", 18, ("OE1", "OE2"), "CA", "Ca", 2.4))
add(F, "zinc-at-a-carboxylate", chelated("1l2y", 9, ("OD1", "OD2"), "ZN", "Zn", 2.1))
add(F, "ion-on-a-backbone-oxygen", edited(of("1ubq"), lambda s: with_chain(s, "I", new_residue("NA", 1,
    [new_atom("NA", "Na", beyond(residue(s, 76)["O"][0].pos.tolist(), residue(s, 76)["C"][0].pos.tolist(),
    r=2.4))]))))

# Waters.
F = "Waters"
add(F, "waters", of("1ubq", waters=True))
for _name in ("WAT", "SOL", "TIP", "DOD", "H2O"):
    add(F, f"water-{_name.lower()}", edited(of("1ubq", waters=True), renamed({"HOH": _name})), as_bare_pdb)
for _name in ("TIP3", "TP3M", "SPCE"):
    add(F, f"water-{_name.lower()}", edited(of("1ubq", waters=True), renamed({}, {"HOH": {"O": "OH2"}})),
        then(as_bare_pdb, four_letters({"HOH": _name})))
add(F, "water-tip3-no-chain", edited(of("1ubq", waters=True), chain_named("", ""), renamed({},
    {"HOH": {"O": "OH2"}})), then(as_bare_pdb, four_letters({"HOH": "TIP3"})))
add(F, "waters-kept", of("4pti", waters=True), options={"keep": "all"})

# Ligands.
F = "Ligands"
add(F, "sulphate", with_molecule(trp, "SO4", SULPHATE))
add(F, "phosphate-with-charges", with_molecule(trp, "PO4", PHOSPHATE, charges={"O2": -1, "O3": -1, "O4": -1}))
add(F, "acetate", with_molecule(trp, "ACT", ACETATE))
add(F, "glycerol-in-mmcif", with_molecule(trp, "GOL", GLYCEROL), as_cif, ".cif")
add(F, "benzamidine", with_molecule(trp, "BEN", BENZAMIDINE))
add(F, "ligand-charge-in-pdb", with_molecule(trp, "BEN", BENZAMIDINE, charges={"N1": 1}))
add(F, "ligand-charge-in-mmcif", with_molecule(trp, "BEN", BENZAMIDINE, charges={"N1": 1}), as_cif, ".cif")
for _name in ("LIG", "UNL", "UNK", "MOL", "001", "1", "DRG", "INH", "X"):
    add(F, f"ligand-named-{_name.lower()}", with_molecule(trp, _name, CHLOROPHENOL))
add(F, "ligand-of-five-letters", with_molecule(trp, "A1AA6", BENZAMIDINE), as_cif, ".cif")
add(F, "ligand-with-a-chain-id-of-two-letters", with_molecule(trp, "LIG", BENZAMIDINE, chain="7L"),
    as_bare_pdb)
add(F, "ligand-of-four-letters", with_molecule(trp, "LIG7", BENZAMIDINE), as_cif, ".cif")
add(F, "ligand-of-lower-case", with_molecule(trp, "lig", BENZAMIDINE), as_cif, ".cif")
add(F, "ligands-whose-names-begin-alike", with_molecule(with_molecule(trp, "LIG3", BENZAMIDINE, turn=1),
    "LIG4", GLYCEROL, chain="M", turn=2), as_cif, ".cif")
add(F, "ligand-quoted-names", with_molecule(trp, "SUG", [(f"{n}'", e, x) for n, e, x in GLYCEROL]), as_cif,
    ".cif")
add(F, "ligand-double-quoted-names", with_molecule(trp, "SUG", [(f'{n}"', e, x) for n, e, x in GLYCEROL]),
    as_cif, ".cif")
add(F, "ligand-long-atom-names", with_molecule(trp, "LIG", [(f"{e}{10 + k}_1", e, x) for k, (_, e,
    x) in enumerate(BENZAMIDINE)]), as_cif, ".cif")
add(F, "ligand-atoms-that-share-a-name", with_molecule(trp, "LIG", [(e, e, x) for _, e, x in BENZAMIDINE]))
add(F, "ligand-atoms-in-atom-records", with_molecule(trp, "BEN", BENZAMIDINE), then(as_bare_pdb,
    records(lambda line: f"ATOM  {line[6:]}")))
add(F, "ligand-in-the-chain-of-the-protein", with_molecule(trp, "BEN", BENZAMIDINE, chain="A"))
add(F, "ligand-numbered-as-a-residue", with_molecule(trp, "BEN", BENZAMIDINE, number=5))
add(F, "ligand-without-elements", with_molecule(trp, "BEN", BENZAMIDINE), then(as_bare_pdb,
    records(lambda line: line[:66])))
add(F, "chlorine-without-elements", with_molecule(trp, "CPH", CHLOROPHENOL), then(as_bare_pdb,
    records(lambda line: line[:66])))
add(F, "ligand-with-conect", with_molecule(trp, "BEN", BENZAMIDINE), then(as_bare_pdb,
    before_end("CONECT  157  158  162  163", "CONECT  158  157  159")))
add(F, "ligand-with-chem-comp-bond", with_molecule(trp, "BEN", BENZAMIDINE), then(as_cif,
    cif_with("_chem_comp_bond.", ["comp_id", "atom_id_1", "atom_id_2", "value_order"], [["BEN", "C1", "C2",
    "doub"], ["BEN", "C2", "C3", "sing"]])), ".cif")
add(F, "ligand-far-away", with_molecule(trp, "BEN", BENZAMIDINE, near=9.0), keeps=False)


def _two_places(structure: gemmi.Structure) -> None:
    """The ligand in two alternate locations."""
    r = structure[0]["L"][0]
    for a in [a.clone() for a in r]:
        r[a.name][0].altloc, r[a.name][0].occ = "A", 0.6
        a.altloc, a.occ, a.pos = "B", 0.4, gemmi.Position(a.pos.x, a.pos.y + 0.5, a.pos.z)
        r.add_atom(a)


GLYCINE = [("N", "N", (-1.2, 0.8, 0)), ("CA", "C", (0, 0, 0)), ("C", "C", (1.3, 0.8, 0)), ("O", "O", (1.3,
    2.0, 0.2)),
           ("OXT", "O", (2.3, 0.1, 0))]
add(F, "ligand-altlocs", edited(with_molecule(trp, "BEN", BENZAMIDINE), _two_places))
add(F, "free-amino-acid", with_molecule(trp, "GLY", GLYCINE, number=1))
for _name, _needs in (
    ("astex-1HQ2_PH2", ""), ("astex-1OQ5_CEL", ""), ("astex-1P62_GEO", ""), ("astex-1T46_STI", ""),
    ("astex-1TOW_CRZ", ""), ("astex-1V48_HA1", ""), ("astex-1YGC_905", ""), ("astex-1IA1_TQ3", ""),
    ("astex-1KZK_JE2", ""), ("astex-1R55_097", ""), ("astex-1S19_MC9", ""), ("astex-1S3V_TQD", ""),
    ("astex-1SJ0_E4D", ""), ("astex-1T40_ID5", ""), ("astex-1Z95_198", ""), ("astex-2BSM_BSM", ""),
):  # fmt: skip

    def _joined(entry: str = _name.removeprefix("astex-")) -> gemmi.Structure:
        out = read_file(COMPLEXES / "astex" / f"{entry}_protein.pdb").clone()
        text = (COMPLEXES / "ligands" / f"{entry}.sdf").read_text().splitlines()
        n = int(text[3][:3])
        atoms, count = [], {}
        for line in text[4 : 4 + n]:
            element = line[31:34].strip()
            count[element] = count.get(element, 0) + 1
            at = [float(line[k : k + 10]) for k in (0, 10, 20)]
            atoms.append(new_atom(f"{element.upper()}{count[element]}", element, at))
        for line in text:
            if line.startswith("M  CHG"):
                words = [int(word) for word in line.split()[3:]]
                for k, charge in zip(words[::2], words[1::2], strict=True):
                    atoms[k - 1].charge = charge
        return with_chain(out, "L", new_residue(entry.split("_")[1], 900, atoms))

    add("Complexes", _name.lower(), _joined,
        needs=f"complexes/astex/{_name.removeprefix('astex-')}_protein.pdb", links=-1, keeps=False)

# Bonds to the protein, and atoms that merely lie near.


def _beside(number: int, name: str, away: tuple[float, float, float]):
    """A chloride away from an atom."""

    def change(structure: gemmi.Structure) -> None:
        at = np.array(residue(structure, number)[name][0].pos.tolist()) + away
        with_chain(structure, "I", new_residue("CL", 1, [new_atom("CL", "Cl", at)]))

    return change


F = "Covalent and clashing"
add(F, "covalent-stated", adduct(True), links=1)
add(F, "covalent-unstated", adduct(False), links=1)
add(F, "covalent-in-mmcif", adduct(True), as_cif, ".cif", links=1)
add(F, "stated-but-far", edited(adduct(False, 3.6), linked(("A", 13, "CYS", "SG"), ("L", 1, "LIG", "C1"))))
for _atom, _number, _distance in (("NZ", 8, 1.45), ("NH1", 16, 1.35), ("OG", 13, 1.55), ("CB", 9, 1.5), ("OH",
    3, 1.4), ("OD1", 9, 1.3), ("NZ", 8, 0.5), ("CA", 10, 1.2)):
    add(F, f"sulphate-{_distance}-from-{_atom.lower()}", pushed(_atom, _number, _distance))
for _atom, _number, _distance in (("CB", 14, 1.5), ("NE2", 5, 1.45)):
    add(F, f"glycerol-{_distance}-from-{_atom.lower()}", pushed(_atom, _number, _distance,
        tuple(GLYCEROL[k] for k in (0, 1, 2, 3, 4, 5)), "GOL"))
add(F, "two-molecules-in-one-place", with_molecule(with_molecule(trp, "BEN", BENZAMIDINE), "GOL", GLYCEROL,
    chain="M", near=1.2))
add(F, "ion-in-a-side-chain", edited(trp, _beside(8, "CE", (1.0, 0.9, 0.9))))

# Incomplete chains.
F = "Incomplete"
add(F, "side-chains-cut", edited(of("1ubq"), without_atoms(lambda r, a: r.name in ("LYS", "GLU",
    "ARG") and a.name not in ("N", "CA", "C", "O", "CB"))))
add(F, "side-chain-atom-missing", edited(trp, without_atoms(lambda r,
    a: r.name == "TRP" and a.name == "CZ3")))
add(F, "backbone-atom-missing", edited(trp, without_atoms(lambda r, a: r.seqid.num == 10 and a.name == "C")),
    keeps=False)
add(F, "chain-break", edited(of("1ubq"), without_residues(*range(30, 36))))
add(F, "chain-break-without-a-gap-in-numbers", edited(of("1ubq"), without_residues(*range(30, 36)),
    _renumber(range(1, 71))))
add(F, "torn-peptide", edited(trp, every_atom(lambda r, a: setattr(a, "pos", gemmi.Position(a.pos.x + 1.2,
    a.pos.y, a.pos.z)) if r.seqid.num > 10 else None)))
add(F, "c-alphas", edited(of("1ubq"), without_atoms(lambda r, a: a.name != "CA")), refused="C-alpha")
add(F, "c-alphas-of-one-chain", edited(of("3i40"), unstated, in_chain("B", lambda r, a: a.name != "CA")),
    refused="C-alpha")
add(F, "one-residue", edited(trp, without_residues(*range(2, 21))), refused="no protein")
add(F, "two-residues", edited(trp, without_residues(*range(3, 21))))
add(F, "residue-alone", edited(of("1ubq"), without_residues(*range(30, 40), *range(41, 50))))
add(F, "alanine-for-all", edited(trp, without_atoms(lambda r, a: a.name not in ("N", "CA", "C", "O", "CB",
    "OXT")), renamed({n: "ALA" for n in PAIRS if n != "GLY"} | {"ILE": "ALA"})))
add(F, "no-side-chain-oxygens", edited(trp, without_atoms(lambda r, a: a.name in ("OD1", "OG"))))

# Geometry.
F = "Geometry"


def _shaken(angstrom: float, seed: int = 3):
    def change(structure: gemmi.Structure) -> None:
        random = np.random.default_rng(seed)
        every_atom(lambda r, a: setattr(a, "pos",
            gemmi.Position(*(np.array(a.pos.tolist()) + random.normal(scale=angstrom,
            size=3)).round(3).tolist())))(structure)

    return change


def _omega(number: int, degrees: float):
    """Turn all that precedes a residue's nitrogen about the peptide bond, to an omega."""

    def change(structure: gemmi.Structure) -> None:
        chain = structure[0][0]
        i = next(k for k, r in enumerate(chain) if r.seqid.num == number)
        ca, c, n, ca2 = (chain[k][name][0].pos for k, name in ((i - 1, "CA"), (i - 1, "C"), (i, "N"), (i,
            "CA")))
        now = np.degrees(gemmi.calculate_dihedral(ca, c, n, ca2))
        axis = np.array((n - c).tolist())
        axis /= np.linalg.norm(axis)
        half = np.radians(now - degrees) / 2
        turn = rotation(np.array([np.cos(half), *(np.sin(half) * axis)]))
        centre = np.array(c.tolist())
        for k in range(i):
            for a in chain[k]:
                if k == i - 1 and a.name == "C":
                    continue
                at = centre + turn @ (np.array(a.pos.tolist()) - centre)
                a.pos = gemmi.Position(*at.round(3).tolist())

    return change


def _second_chain(away: float):
    """The first chain again, some angstrom away."""

    def change(structure: gemmi.Structure) -> None:
        other = structure[0][0].clone()
        other.name = "B"
        for r in other:
            for a in r:
                a.pos = gemmi.Position(round(a.pos.x + away, 3), a.pos.y, a.pos.z)
        structure[0].add_chain(other)

    return change


add(F, "noise-0.1", edited(of("1ubq"), _shaken(0.1)))
add(F, "noise-0.3", edited(trp, _shaken(0.3)))
for _degrees in (0.0, 40.0, -80.0, 100.0, -120.0):
    add(F, f"omega-{_degrees:g}", edited(trp, _omega(4, _degrees)))
add(F, "omega-before-proline-10", edited(trp, _omega(12, 10.0)))
add(F, "two-chains-overlapping", edited(trp, _second_chain(7.0)))
add(F, "one-chain-upon-another", edited(trp, _second_chain(0.0)), refused="lies upon")
add(F, "atoms-in-one-place", edited(trp, lambda s: setattr(residue(s, 8)["NZ"][0], "pos", residue(s,
    8)["CE"][0].pos)),
    refused="coincide")

# Glycans, nucleic acids, cofactors: from entries of the PDB and predictions.
M = "complexes/models/"


def real(family: str, path: str, name: str = "", **more: object) -> None:
    source = SHARED / path
    add(family, name or Path(path).name.replace(".", "-"), of_shared(path), lambda s: source.read_text(),
        Path(path).suffix, needs=path, is_made=False, **{"links": -1, "keeps": False, **more})


F = "Glycans"
FC = {"needs": f"{M}3ave.pdb"}
_sugars = of_shared(f"{M}3ave.pdb", "A,C", lambda r: not r.is_water())
add(F, "glycan-stated", _sugars, links=1, **FC)
add(F, "glycan-unstated", edited(_sugars, unstated), links=1, **FC)
add(F, "glycan-in-mmcif", _sugars, as_cif, ".cif", links=1, **FC)


def _as_nln(structure: gemmi.Structure) -> None:
    residue(structure, 297, "A").name = "NLN"


add(F, "glycan-nln", edited(_sugars, unstated, _as_nln), links=1, **FC)
add(F, "glycan-glycam", edited(_sugars, unstated, _as_nln, lambda s: [setattr(r, "name", {"NAG": "4YB",
    "BMA": "VMB", "MAN": "2MA", "FUC": "0fA"}.get(r.name, r.name)) for r in s[0]["C"]]), as_bare_pdb, links=1,
    **FC)
add(F, "glycan-without-its-root", edited(_sugars, unstated, lambda s: s[0]["C"].__delitem__(0)), **FC)

F = "Nucleic acids"
real(F, f"{M}1bna.pdb", "dna-alone", refused="no protein")
real(F, f"{M}1ysa.pdb")
real(F, f"{M}clash_dna.pdb")
YSA = {"needs": f"{M}1ysa.pdb"}
_ysa = of_shared(f"{M}1ysa.pdb", "", lambda r: not r.is_water())


def _strands(structure: gemmi.Structure) -> list[gemmi.Chain]:
    return [c for c in structure[0] if c[0].name in ("DA", "DC", "DG", "DT")]


def _strand_apart(structure: gemmi.Structure) -> None:
    """A strand whose second half is 1.5 angstrom away."""
    for r in list(_strands(structure)[0])[8:]:
        for a in r:
            a.pos = gemmi.Position(round(a.pos.x + 1.5, 3), a.pos.y, a.pos.z)


def _amber_ends(structure: gemmi.Structure) -> None:
    for strand in _strands(structure):
        strand[0].name, strand[-1].name = f"{strand[0].name}5", f"{strand[-1].name}3"


def _first_gone(structure: gemmi.Structure) -> None:
    del _strands(structure)[0][0]


add(F, "dna-in-mmcif", _ysa, as_cif, ".cif", **YSA)
add(F, "dna-amber-names", edited(_ysa, _amber_ends), as_bare_pdb, **YSA)
add(F, "dna-charmm-names", edited(_ysa, renamed({"DA": "ADE", "DG": "GUA", "DC": "CYT", "DT": "THY"},
    {"*": {"OP1": "O1P", "OP2": "O2P"}, "DT": {"C7": "C5M"}})), as_bare_pdb, **YSA)
add(F, "dna-stars-for-primes", edited(_ysa, every_atom(lambda r, a: setattr(a, "name", a.name.replace("'",
    "*")))), as_bare_pdb, **YSA)
add(F, "dna-old-names", edited(_ysa, renamed({"DA": "A", "DG": "G", "DC": "C", "DT": "T"})), as_bare_pdb,
    **YSA)
add(F, "dna-base-cut", edited(_ysa, without_atoms(
    lambda r, a: r.seqid.num == 6 and r.name[:1] == "D" and a.name in ("N9", "C8", "N7", "C5"))), **YSA)
add(F, "dna-broken", edited(_ysa, _strand_apart), **YSA)
add(F, "dna-five-prime-phosphate", edited(_ysa, _first_gone), keeps=False, **YSA)
real(F, f"{M}2r5z.pdb")
real(F, f"{M}5ugo.cif")
real(F, f"{M}4gxy.cif", "rna-alone", refused="no protein")
F = "Cofactors"
for _path in ("1a0i.cif", "5h73.cif", "3ave.pdb", "boltz1_6bj9_model_0.cif", "chai1_6bj9_model_0.cif",
    "clash_ligand.cif", "charges.cif"):
    real(F, f"{M}{_path}")

REAL = tuple(sorted(p.name for p in MORE.glob("*.*") if p.suffix in (".pdb",
    ".cif"))) if MORE.is_dir() else ()
for _path in REAL:
    if _path not in ("2n0n_lactam.pdb",):
        real("Entries and models", f"structures/{_path}",
            refused="C-alpha" if _path == "ubiquitin_ca_only.pdb" else "")
for _path in ("1hel.pdb", "1l2y.pdb", "1ubq.pdb", "1vii.pdb", "3i40.pdb", "4pti.pdb", "ala10.pdb"):
    add("Samples", f"sample-{_path.replace('.', '-')}", lambda p=_path: read_file(SAMPLES / p).clone(),
        lambda s,
        p=_path: (SAMPLES / p).read_text(), is_made=False)
# fmt: on
