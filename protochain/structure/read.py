"""A PDB or mmCIF file -> the protein in it, one conformation, chains split where they break.

gemmi does the parsing. What is left out or changed is said in ``repairs``; what cannot be used is
refused in one line.
"""

from collections import Counter
from dataclasses import dataclass, field
from math import isfinite
from pathlib import Path

import gemmi
import numpy as np

from protochain import residues
from protochain.errors import StructureError

PEPTIDE_BREAK = 2.0
"""Angstrom: C and N further apart than this are not bonded (a peptide bond is 1.33)."""

_COORDINATE_COLUMNS = 54
_RECORDS = ("ATOM", "HETATM", "ANISOU", "SIGATM", "SIGUIJ")


@dataclass
class Draft:
    """A file's protein on its way to becoming a Structure.

    Parameters
    ----------
    name, source : str
        Short name, and how messages name the file.
    model : gemmi.Model
        One gemmi chain for each unbroken chain, named by its index.
    chain_ids : list of str
        The file's own id of each unbroken chain.
    """

    name: str
    source: str
    model: gemmi.Model = field(default_factory=lambda: gemmi.Model(1))
    chain_ids: list[str] = field(default_factory=list)
    repairs: list[str] = field(default_factory=list)
    left_out: Counter[str] = field(default_factory=Counter)

    def add_chain(self, chain_id: str, members: list[gemmi.Residue]) -> None:
        """Append an unbroken chain of copies of the residues."""
        chain = gemmi.Chain(str(len(self.chain_ids)))
        for residue in members:
            chain.add_residue(residue)
        self.model.add_chain(chain)
        self.chain_ids.append(chain_id)


def describe(chain_id: str, residue: gemmi.Residue) -> str:
    """``residue 17 GLU of chain A``, with the insertion code if there is one."""
    return residues.describe(str(residue.seqid).strip(), residue.name, chain_id)


def read(path: str | Path) -> Draft:
    """Read the protein of the first model of a PDB or mmCIF file.

    Parameters
    ----------
    path : path-like

    Returns
    -------
    Draft

    Raises
    ------
    StructureError
        If the file cannot be read, is cut short, holds no protein, or holds residues that cannot be used.
    """
    path = Path(path)
    draft = Draft(path.stem, str(path))
    try:
        text = path.read_bytes().decode("utf-8", errors="replace")
    except OSError as error:
        raise StructureError(f"{path}: cannot be read ({error.strerror}); check the name") from None
    structure = _parse(text, path)
    if len(structure) == 0 or structure[0].count_atom_sites() == 0:
        raise StructureError(f"{path}: no atoms found; give a PDB or mmCIF file with coordinates")
    if len(structure) > 1:
        draft.repairs.append(f"model {structure[0].num} used, {len(structure) - 1} other models left out")
        draft.left_out["models"] = len(structure) - 1
    for chain in structure[0]:
        chain.name = chain.name.strip()
        protein = _protein_residues(draft, chain)
        _check_backbone(draft, chain.name, protein)
        _add_unbroken(draft, chain.name, protein)
    if not draft.chain_ids:
        found = ", ".join(f"{count} {kind}" for kind, count in draft.left_out.items())
        raise StructureError(f"{path}: no protein found (only {found}); give a file with amino acids")
    last = draft.model[-1][-1]
    if "\nEND" not in text and not _is_cif(text, path) and not last.find_atom("OXT", "*"):
        draft.repairs.append(
            f"the file stops at {describe(draft.chain_ids[-1], last)} without an END line or a terminal "
            "oxygen: if it was cut short, the rest is not here"
        )
    _say_what_was_left_out(draft)
    return draft


def _is_cif(text: str, path: Path) -> bool:
    return path.suffix.lower() in (".cif", ".mmcif") or text.lstrip().startswith("data_")


def _parse(text: str, path: Path) -> gemmi.Structure:
    try:
        if _is_cif(text, path):
            _refuse_cut_cif(text, path)
            document = gemmi.cif.read_string(text)
            return gemmi.make_structure_from_block(document[0])
        _refuse_cut_pdb(text, path)
        _refuse_odd_coordinates(text, path)
        return gemmi.read_pdb_string(text)
    except StructureError:
        raise
    except (RuntimeError, ValueError, IndexError) as error:
        reason = " ".join(str(error).split())
        raise StructureError(f"{path}: cannot be read: {reason}; mend or download the file again") from None


def _refuse_cut_cif(text: str, path: Path) -> None:
    """Archive files end every category with '#': one whose last line is a row was cut."""
    lines = text.rstrip().splitlines() or [""]
    if lines[-1].strip() != "#" and any(line.strip() == "#" for line in lines):
        raise StructureError(f"{path}: line {len(lines)}: the file is cut short; download it again")


def _refuse_cut_pdb(text: str, path: Path) -> None:
    """Refuse a file that ends within an atom record, or within the atoms of a file that has a header."""
    lines = text.rstrip("\r\n").splitlines() or [""]
    last, before = lines[-1], lines[-2] if len(lines) > 1 else ""
    in_record_name = bool(last) and any(record.startswith(last) for record in _RECORDS)
    if not last.startswith(_RECORDS) and not in_record_name:
        return
    shorter = not text.endswith("\n") and before.startswith(_RECORDS) and len(last) < len(before)
    has_header = any(line.startswith(("HEADER", "SEQRES")) for line in lines)
    if len(last) < _COORDINATE_COLUMNS or shorter or has_header:
        raise StructureError(
            f"{path}: line {len(lines)}: the file is cut short; download it again, "
            "or add a line END if this is all"
        )


def _refuse_odd_coordinates(text: str, path: Path) -> None:
    """Refuse what is not a number: gemmi reads stars as 0."""
    for number, line in enumerate(text.splitlines(), 1):
        if line.startswith(("ATOM", "HETATM")):
            for axis, start in zip("xyz", (30, 38, 46), strict=True):
                try:
                    value = float(line[start : start + 8])
                except ValueError:
                    value = np.nan
                if not np.isfinite(value):
                    given = line[start : start + 8].strip()
                    raise StructureError(
                        f"{path}: line {number}: {axis} is {given!r}, not a number; "
                        f"mend columns {start + 1}-{start + 8}"
                    )


def _protein_residues(draft: Draft, chain: gemmi.Chain) -> list[gemmi.Residue]:
    """Return the chain's amino acids and caps, each in one conformation and under its standard name."""
    kept = []
    for group in _same_place(chain):
        residue = _likeliest(draft, chain.name, group)
        name = residues.PARENT.get(residue.name, residue.name)
        if name in residues.STANDARD or name in residues.CAPS:
            kept.append(_standardised(draft, chain.name, residue, name))
        elif {"N", "CA", "C"} <= {atom.name for atom in residue}:
            raise StructureError(
                f"{draft.source}: {describe(chain.name, residue)} is not one of the 20 standard amino acids; "
                "replace it by its parent or remove it"
            )
        else:
            info = gemmi.find_tabulated_residue(residue.name)
            draft.left_out["waters" if info.is_water() else residue.name] += 1
    return kept


def _same_place(chain: gemmi.Chain) -> list[list[gemmi.Residue]]:
    """Group the residues that share a number: alternatives for one place (microheterogeneity)."""
    groups: list[list[gemmi.Residue]] = []
    for residue in chain:
        if groups and groups[-1][0].seqid == residue.seqid and residue[0].has_altloc():
            groups[-1].append(residue)
        else:
            groups.append([residue])
    return groups


def _likeliest(draft: Draft, chain_id: str, group: list[gemmi.Residue]) -> gemmi.Residue:
    """Copy of the residue and alternate location of highest occupancy (the first of equals)."""
    weights: dict[tuple[int, str], list[float]] = {}
    for i, residue in enumerate(group):
        for atom in residue:
            if atom.has_altloc():
                weights.setdefault((i, atom.altloc), []).append(atom.occ)
    best, altloc = max(weights, key=lambda place: float(np.mean(weights[place])), default=(0, ""))
    chosen = group[best].clone()
    # An atom that only another location has is still part of the residue; of two with one name, the first.
    ranked = sorted(range(len(chosen)), key=lambda i: chosen[i].altloc not in (altloc, "\0"))
    kept: dict[str, int] = {}
    for i in ranked:
        kept.setdefault(chosen[i].name, i)
    dropped = sorted(set(ranked) - set(kept.values()))
    where = describe(chain_id, chosen)
    others = sorted({f"{group[i].name} {a}" for i, a in weights} - {f"{chosen.name} {altloc}"})
    if others:
        occupancy = np.mean(weights[best, altloc])
        draft.repairs.append(
            f"{where}: alternate location {altloc} kept (occupancy {occupancy:.2f}), "
            f"{', '.join(others)} left out"
        )
        draft.left_out["alternate locations"] += len(others)
    elif dropped:
        names = ", ".join(sorted({chosen[i].name for i in dropped}))
        draft.repairs.append(f"{where}: {names} given more than once: the first kept")
        draft.left_out["repeated atoms"] += len(dropped)
    for i in reversed(dropped):
        del chosen[i]
    for atom in chosen:
        atom.altloc = "\0"
    return chosen


def _standardised(draft: Draft, chain_id: str, residue: gemmi.Residue, name: str) -> gemmi.Residue:
    if residue.name == "MSE":
        draft.repairs.append(f"{describe(chain_id, residue)}: selenomethionine taken as MET")
        for atom in residue:
            if atom.element == gemmi.Element("Se"):
                atom.name, atom.element = "SD", gemmi.Element("S")
    elif residue.name != name:
        draft.repairs.append(f"{describe(chain_id, residue)}: taken as {name}, its protonation chosen anew")
    residue.name = name
    heavy_hydrogens = [i for i, atom in enumerate(residue) if atom.element == gemmi.Element("D")]
    for i in reversed(heavy_hydrogens):
        del residue[i]
    draft.left_out["deuterium atoms"] += len(heavy_hydrogens)
    return residue


def _check_backbone(draft: Draft, chain_id: str, protein: list[gemmi.Residue]) -> None:
    amino = [residue for residue in protein if residue.name in residues.STANDARD]
    if amino and all([atom.name for atom in residue] == ["CA"] for residue in amino):
        raise StructureError(
            f"{draft.source}: chain {chain_id or '(blank)'} holds only C-alpha atoms; "
            "rebuild the other atoms first"
        )
    for residue in protein:
        for atom in residue:
            if not all(map(isfinite, atom.pos.tolist())):
                raise StructureError(
                    f"{draft.source}: {describe(chain_id, residue)}: the position of atom {atom.name} "
                    "is not a number; mend it"
                )
    for residue in amino:
        present = {atom.name for atom in residue}
        missing = [name for name in residues.BACKBONE if name not in present]
        if missing:
            raise StructureError(
                f"{draft.source}: {describe(chain_id, residue)}: atom {missing[0]} missing; "
                "rebuild the backbone or remove the residue"
            )


def _add_unbroken(draft: Draft, chain_id: str, protein: list[gemmi.Residue]) -> None:
    """Split where consecutive residues are not bonded: a bond drawn across a gap would tear the chain."""
    run: list[gemmi.Residue] = []
    for residue in protein:
        if run:
            end, start = run[-1].find_atom("C", "*"), residue.find_atom("N", "*")
            gap = end.pos.dist(start.pos) if end and start else PEPTIDE_BREAK
            if gap >= PEPTIDE_BREAK:
                draft.repairs.append(
                    f"chain {chain_id or '(blank)'} is broken between {str(run[-1].seqid).strip()} and "
                    f"{str(residue.seqid).strip()} ({gap:.1f} angstrom): "
                    "taken as two chains with real termini"
                )
                draft.add_chain(chain_id, run)
                run = []
        run.append(residue)
    if run:
        draft.add_chain(chain_id, run)


def _say_what_was_left_out(draft: Draft) -> None:
    said_already = ("models", "alternate locations", "repeated atoms")
    draft.left_out = +draft.left_out
    for kind, count in draft.left_out.items():
        if kind not in said_already:
            draft.repairs.append(f"{count} {kind} left out")
