"""Expected records: what short commands and Python calls give, and what has changed since they were written.

    python tests/records.py [NAME...]

It runs the records of ``tests/records/table.txt`` of these names or groups, without any all of them, prints
each difference from ``tests/records/expected/`` as a line of old and new, and writes the new.
"""

import csv
import gc
import io
import json
import os
import re
import shlex
import signal
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import chdir, redirect_stderr, redirect_stdout
from dataclasses import dataclass, fields, is_dataclass
from enum import Enum
from pathlib import Path
from typing import Any
from unittest import mock

import gemmi
import numpy as np
import openmm
import pandas as pd
from fixtures.schemas import results
from fixtures.tolerances import RECORDED, RECORDED_LENGTH
from matplotlib.figure import Figure

import bench.scenes
import protochain as pc
from protochain.energies.openmm_engine import OpenMMEnergy

HERE = Path(__file__).parent / "records"
STRUCTURES, TABLE, EXPECTED = HERE.parents[1] / "structures", HERE / "table.txt", HERE / "expected"
Cells = dict[str, str]
"""Column: words of its value, with blanks between."""

ATOM = r"(?m)^ATOM  "
MADE = {
    "inserted.pdb": ("5awl.pdb", ATOM + r"(.{16})   6 ", r"ATOM  \1   5A"),
    "gap.pdb": ("5awl.pdb", ATOM + r".{16}   5 .*\n", ""),
    "side.pdb": ("5awl.pdb", ATOM + r".{6} (C[DEZ].|OH ) TYR.*\n", ""),
    "alpha.pdb": ("5awl.pdb", ATOM + r".{6} (?!CA ).*\n", ""),
    "nan.pdb": ("5awl.pdb", r"(?m)^(ATOM     10.{19}).{8}", r"\1     nan"),
    "unknown.pdb": ("5awl.pdb", r"(?m)^(ATOM.{13})GLY", r"\1XYZ"),
    "broken.pdb": ("ala10.pdb", r"(?m)^(ATOM .{8}CB  ALA A   5    ).{24}", r"\1  10.000   0.500   1.000"),
    "models.pdb": ("ala10.pdb", r"(?s)^(.+)END\s+$", r"MODEL        1\n\1ENDMDL\nMODEL        2\n\1ENDMDL\n"),
    "empty.pdb": ("5awl.pdb", r"(?s).*", ""),
}
"""Name of a file: the sample it is made of, what is replaced in it, and by what."""

LEFT_OUT = re.compile(
    r"seconds|timings|_per_day|^(input|output|file|report|path|structure_file|protochain|python|versions|made|threads|"
    r"device|command|engine_reason|message|judge|frame|title|detail|source|first|what|added|"
    r"(ligand_)?strain_end_kj_mol|ratio|slope\w*|exponent|key|error_of|system_sha256)$"
)
"""Names of what differs by machine, or is a sentence. (Strain at the end is where a minimisation stops.)"""
SENTENCES = {"repairs", "overlaps", "findings", "lost_atoms", "far_molecules", "confidences", "wrong"}
"""Names of lists of sentences, which are counted."""


@dataclass(frozen=True)
class Record:
    """A line of the table: its group and name, and its commands, or after ``>>>`` an expression of Python."""

    group: str
    name: str
    what: str


PARTS = {
    "structures": ("prepared", "searched", "written", "refused"),
    "minimised": ("torsions", "atoms", "relaxed"),
    "measured": ("energies", "simulated", "judged", "printed", "scenes"),
}
"""Groups that each file of tests compares: three files, for processes side by side."""


def table() -> list[Record]:
    """All records."""
    group, found = "", []
    for line in TABLE.read_text(encoding="utf-8").splitlines():
        if line.startswith("["):
            group = line.strip("[]")
        elif line and not line.startswith("#"):
            name, what = line.split(maxsplit=1)
            found.append(Record(group, name, what))
    assert len(found) == len({each.name for each in found}), "two records of one name"
    return found


# ---- Running -----------------------------------------------------------------------------------------------

_THERE = (("there", "True"),)
"""What is recorded of a picture, page or checkpoint, and of the third and further of many files."""


def _by_reference(energy: OpenMMEnergy, system: openmm.System, integrator: Any = None) -> openmm.Context:
    """Context in double precision, since sums of the CPU platform change from run to run."""
    platform = openmm.Platform.getPlatform("Reference")
    return openmm.Context(system, integrator or openmm.VerletIntegrator(0.001), platform)


@mock.patch.object(OpenMMEnergy, "make_context", _by_reference)
def run(record: Record) -> Cells:
    """What a record gives, in a new folder that has the samples and what is made of them."""
    with tempfile.TemporaryDirectory() as folder, chdir(folder):
        for path in STRUCTURES.iterdir():
            Path(path.name).symlink_to(path)
        for name, (sample, pattern, text) in MADE.items():
            Path(name).write_text(re.sub(pattern, text, (STRUCTURES / sample).read_text()))
        given, drawn = {*Path().iterdir()}, list[Cells]()

        def drawing(figure: Figure, *to: Any, **options: Any) -> None:
            if (cells := dict(_figure(figure))) not in drawn:  # A page has it, too.
                drawn.append(cells)
            saved(figure, *to, **options)

        saved, found = Figure.savefig, Cells()
        with mock.patch.object(Figure, "savefig", drawing):
            if record.what.startswith(">>>"):
                found |= _cells("", _evaluated(record.what[3:].strip()))
            else:
                for command in record.what.split(" && "):
                    found |= _command(shlex.split(command), record.group == "printed")
        if record.group == "printed":
            return found
        found |= {f"figure_{k}:{name}": cell for k, its in enumerate(drawn) for name, cell in its.items()}
        made = sorted(path for path in Path().rglob("[!.]*") if path.is_file() and path not in given)
        # A search stores a piece every five seconds, more of them on a slow machine.
        made = [path for path in made if path.parts[1:2] != ("pieces",)]
        of_a_kind: Counter[tuple[Path, str]] = Counter()
        for path in made:
            of_a_kind[path.parent, path.suffix] += 1
            few = of_a_kind[path.parent, path.suffix] <= 2
            found |= {
                f"{str(path).replace('/', ':')}:{column}": value
                for column, value in (_file(path) if few else _THERE)
            }
        return found


def _evaluated(text: str) -> Any:
    try:
        return eval(text, {"pc": pc, "np": np, "bench": bench})
    except pc.ProtochainError as error:
        return _name_of(error)


def _name_of(error: BaseException) -> dict[str, str]:
    """Names of an exception and of its fault: its words may change."""
    fault = getattr(error, "fault", None)
    return {"error": type(error).__name__} | ({"fault": fault.name} if fault else {})


def _command(words: list[str], lines: bool = False) -> Cells:
    """Exit status of a command, the error that ended it, and what it prints with --json, or its lines."""
    from protochain import cli

    seen: dict[str, str] = {}

    def noting(**settings: Any) -> Any:
        try:
            return app(**settings)
        except Exception as error:
            seen.update(_name_of(error))
            raise

    app, status, printed = cli.app, 0, io.TextIOWrapper(io.BytesIO(), "utf-8", write_through=True)
    before = signal.getsignal(signal.SIGTERM), gc.get_threshold()
    patches = mock.patch.multiple(cli, app=noting), mock.patch.object(sys, "argv", ["protochain", *words])
    said, width = io.StringIO(), mock.patch.dict(os.environ, {"COLUMNS": "120"})
    with patches[0], patches[1], width, redirect_stdout(printed), redirect_stderr(said):
        try:
            cli.main()
        except SystemExit as end:
            status = end.code
    signal.signal(signal.SIGTERM, before[0])
    gc.set_threshold(*before[1])
    text = printed.buffer.getvalue().decode()
    told = json.loads(text) if "--json" in words and text else {}
    if told and status == 0:
        results(words, told)
    shown = dict(_lines(said.getvalue() + text) if lines else _cells("json:", told))
    return dict(_cells("", {"status": status, **seen})) | shown


def _lines(text: str) -> Iterator[tuple[str, str]]:
    """The lines printed, but for times, and lines that only a slow machine prints."""
    text = re.sub("compiling kernels .*\n|.* % accepted, .*\n", "", text)
    text = re.sub(r"(seconds )?[\d.]+(?(1)| (s|ns/day)\b)", "# s", text.replace(f"{Path.cwd()}/", ""))
    timed = r" +[\d.]+$" if "time s\n" in text else "$"
    for k, line in enumerate(re.sub(timed, "", each) for each in text.splitlines()):
        if line.strip() and not LEFT_OUT.search(line.split(":")[0]):
            yield f"line_{k:02}", " ".join(line.split())


# ---- What is recorded of a value ---------------------------------------------------------------------------


def _cells(at: str, value: Any) -> Iterator[tuple[str, str]]:
    """Columns of a value, whose name begins with ``at``, and their words."""
    name = at.rstrip(":").rsplit(":", 1)[-1]
    if LEFT_OUT.search(name):
        return
    if isinstance(value, Enum):
        value = value.name
    if value is None or isinstance(value, str | bool | int | float | np.generic):
        yield at.rstrip(":") or "value", _word(name, value)
    elif isinstance(value, pd.DataFrame):
        yield from _rows(at, value)
    elif isinstance(value, pc.Structure):
        yield from _structure(at, value)
    elif hasattr(value, "record"):
        record = value.record
        yield from _cells(at, record() if callable(record) else record)
    elif isinstance(value, Mapping):
        for key, each in value.items():
            yield from _cells(f"{at}{key}:", each)
    elif is_dataclass(value):
        yield from _cells(at, {field.name: getattr(value, field.name) for field in fields(value)})
    elif isinstance(value, np.ndarray) and not 0 < value.size < 7:
        flat = np.asarray(value, dtype=float).ravel()
        some = [*value.shape, *flat[:3], *flat[-1:], flat.sum(), np.linalg.norm(flat)]
        yield at + "shape_some_sum_norm", " ".join(_word(name, each) for each in some)
    elif len(value) and all(isinstance(each, Mapping) for each in value):
        yield from _rows(at, pd.DataFrame(list(value)))
    elif name in SENTENCES:
        yield f"{at}count", str(len(value))
    elif all(each is None or isinstance(each, str | bool | int | float | np.generic) for each in value):
        words = " ".join(_word(name, each) for each in value).split()
        if any(" of " in str(each) for each in value):  # Places, of which only names and numbers count.
            words = [word for word in words if re.search("[A-Z0-9]", word)]
        yield at.rstrip(":") or "value", " ".join(words)
    else:
        for k, each in enumerate(value):
            yield from _cells(f"{at}{k}:", each)


def _word(name: str, value: Any) -> str:
    """A value as text: lengths to 1e-6 angstrom, other numbers to ten digits."""
    if isinstance(value, float | np.floating):
        return format(round(float(value), 6) + 0.0 if "angstrom" in name else float(value), ".10g")
    return str(value)


def _counted(counts: Mapping[str, int]) -> str:
    return " ".join(f"{each} x{n}" for each, n in sorted(counts.items()))


def _rows(at: str, rows: pd.DataFrame) -> Iterator[tuple[str, str]]:
    """Of a table the number of rows, and of each column the first, last and sum, or of words their counts."""
    if "quantity" in rows:
        rows = rows[~rows["quantity"].str.contains("seconds")]
    yield f"{at}rows", str(len(rows))
    for column in rows.columns if len(rows) else ():
        name, values = str(column), rows[column]
        # Errors of scenes are round-off, in part of singular systems; their checks have values and verdicts.
        if LEFT_OUT.search(name) or name in SENTENCES or name == "error":
            continue
        if pd.api.types.is_numeric_dtype(values) and values.dtype != bool:
            some = values if len(rows) < 3 else [*values.iloc[[0, -1]], float(values.sum())]
            yield at + name, " ".join(_word(name, each) for each in some)
        elif values.map(lambda each: each is None or isinstance(each, str | bool | float | np.bool_)).all():
            counts = Counter(str(each) for each in values)
            yield at + name, _counted(counts) if len(counts) <= 6 else f"different {len(counts)}"


def _structure(at: str, structure: "pc.Structure") -> Iterator[tuple[str, str]]:
    """Size, residues, repairs and atoms of a prepared structure."""
    of = zip(structure.residue_chain, structure.residue_number, structure.residue_insertion_code, strict=True)
    place = [f"{chain}:{number}{code}".strip() for chain, number, code in of]
    labels = [
        f"{place[k]}:{structure.residue_name[k]}:{atom}"
        for k, atom in zip(structure.atom_residue, structure.atom_name, strict=True)
    ]
    yield from _cells(at, {
        "n_chains": structure.n_chains, "n_residues": structure.n_residues, "n_bonds": len(structure.bonds),
        "n_ties": len(structure.ties), "n_obstacle": int(structure.obstacle.sum()),
        "formal_charge": int(np.sum(structure.formal_charge)), "n_mobile": int(structure.mobile.sum()),
        "left_out": dict(structure.left_out), "residues": list(map(str, structure.residue_name)),
        "kinds_of_repairs": dict(Counter(each.kind.name for each in structure.repairs)),
        "ligands": [len(each.atoms) for each in structure.ligands],
    })  # fmt: skip
    yield from _atoms(at, labels, 10.0 * structure.positions)


def _atoms(at: str, labels: Sequence[object], x: Any) -> Iterator[tuple[str, str]]:
    """Number of atoms, where they are on the whole, and every tenth; in larger structures fewer."""
    x = np.asarray(x, dtype=float).reshape(-1, 3)
    yield f"{at}n_atoms", str(len(x))
    if len(x):
        centre = x.mean(axis=0)
        radius = np.sqrt(((x - centre) ** 2).sum(axis=1).mean())
        yield f"{at}centre_radius_angstrom", " ".join(_word("angstrom", each) for each in (*centre, radius))
    for k in range(0, len(x), max(10, len(x) // 12)):
        place = " ".join(_word("angstrom", each) for each in x[k])
        yield f"{at}atom_{k}_angstrom", f"{labels[k]} {place}"


def _file(path: Path) -> Iterator[tuple[str, str]]:
    """What is recorded of a file that was written; of a picture, page or checkpoint only that it is there."""
    suffix = path.suffix
    if suffix in (".pdb", ".cif"):
        yield from _of_structure_file(path)
    elif suffix == ".csv":
        yield from _rows("", pd.read_csv(path))
    elif suffix in (".dcd", ".xtc"):
        yield from _of_frames(path)
    elif suffix == ".sdf":
        lines = path.read_text().splitlines()
        atoms = [line.split() for line in lines if re.match(r"( +-?\d+\.\d{4}){3} [A-Z]", line)]
        yield "records", str(lines.count("$$$$"))
        yield from _atoms("", [words[3] for words in atoms], [[float(w) for w in a[:3]] for a in atoms])
    else:
        yield from _THERE


def _of_structure_file(path: Path) -> Iterator[tuple[str, str]]:
    if path.suffix == ".pdb":
        records = Counter(line[:6].strip() for line in path.read_text().splitlines())
    else:
        block = gemmi.cif.read(str(path)).sole_block()
        categories = block.get_mmcif_category_names()
        records = Counter({each: len(block.find_mmcif_category(each)) for each in categories})
    del records["REMARK"]
    yield "records", _counted(records)
    read = gemmi.read_structure(str(path))
    every = [each for model in read for each in model.all()]
    yield "elements", _counted(Counter(each.atom.element.name for each in every))
    labels = [
        f"{a.chain.name}:{a.residue.seqid}:{a.residue.name}:{a.atom.name} {a.atom.occ:g} {a.atom.b_iso:g}"
        for a in every
    ]
    yield from _atoms("", labels, [a.atom.pos.tolist() for a in every])


def _of_frames(path: Path) -> Iterator[tuple[str, str]]:
    from MDAnalysis.lib.formats.libdcd import DCDFile
    from MDAnalysis.lib.formats.libmdaxdr import XTCFile

    opened = DCDFile if path.suffix == ".dcd" else XTCFile
    with opened(str(path)) as file:
        frames = [file.read() for _ in range(len(file))]
    yield "n_frames", str(len(frames))
    for k in (len(frames) // 4, len(frames) - 1):
        x = frames[k].xyz if path.suffix == ".dcd" else 10.0 * frames[k].x
        yield from _atoms(f"frame_{k}:", range(len(x)), x)


def _figure(figure: Figure) -> Iterator[tuple[str, str]]:
    """Labels, legend and curves of a figure's axes; of an axis of seconds only that it is there."""
    for k, ax in enumerate(figure.axes):
        about = {"title": ax.get_title(), "x": ax.get_xlabel(), "y": ax.get_ylabel()}
        is_timed = re.search(r"second|\bs$|, s\b", f"{about['x']}\n{about['y']}", re.M)
        if is_timed:
            about["title"] = "..." if about["title"] else ""
        keys = [text.get_text() for text in ax.legend_.texts] if ax.legend_ else []
        yield f"{k}:labels", " | ".join([*about.values(), *keys]).replace("\n", " ")
        if not is_timed:
            for m, line in enumerate(ax.lines[:9]):
                x, y = (np.array(each, dtype=float) for each in line.get_data(orig=False))
                some = len(x), *x[:1], np.nansum(x), np.nansum(y)
                yield f"{k}:curve_{m}", " ".join(_word("", each) for each in some)
        parts = [len(each.get_offsets()) for each in ax.collections], len(ax.patches), len(ax.images)
        yield f"{k}:points_bars_images", " ".join(map(str, (*parts[0], *parts[1:])))
        sides = sum(side.get_visible() for side in ax.spines.values())
        yield f"{k}:frame", f"{sides} sides {ax.get_xscale()} {ax.get_yscale()}"
    yield "inches", " ".join(map(str, figure.get_size_inches()))


# ---- Comparing and writing ---------------------------------------------------------------------------------


def same(column: str, old: str, new: str) -> bool:
    """Whether the words of two cells are equal: numbers within tolerance, counts and all else exactly."""
    before, after = old.split(), new.split()
    return len(before) == len(after) and all(map(lambda a, b: _same(column, a, b), before, after))


def _same(column: str, old: str, new: str) -> bool:
    if old == new or (old.isdigit() and new.isdigit()):  # Counts are exact.
        return old == new
    try:
        a, b = float(old), float(new)
    except ValueError:
        return False
    if column.startswith("line_"):
        return bool(abs(a - b) < 1.5 * 10.0 ** -len(old.partition(".")[2]))
    return bool(abs(a - b) <= _tolerance(column.rsplit(":", 1)[-1], a))


def _tolerance(name: str, value: float) -> float:
    if name.endswith("_angstrom"):
        return RECORDED_LENGTH
    return RECORDED * max(1.0, abs(value))


def changes(old: Mapping[str, str], new: Mapping[str, str]) -> list[tuple[str, str, str]]:
    """Columns that differ, with the old and the new; "-" where there is none."""
    return [
        (column, old.get(column, "-"), new.get(column, "-"))
        for column in dict.fromkeys([*old, *new])
        if not (column in old and column in new and same(column, old[column], new[column]))
    ]


def shown(name: str, found: list[tuple[str, str, str]]) -> str:
    """Changes as a table."""
    rows = [("record", "column", "old", "new"), *((name, *each) for each in found)]
    widths = [max(len(row[k]) for row in rows) for k in range(3)]
    return "\n".join("  ".join([*map(str.ljust, row[:3], widths), row[3]]) for row in rows)


def expected(group: str) -> dict[str, Cells]:
    """Records of a group as written: each a column of its table, with an empty cell for what it has not."""
    path = EXPECTED / f"{group}.csv"
    if not path.exists():
        return {}
    with path.open(newline="", encoding="utf-8") as file:
        _, *names = next(lines := csv.reader(file))
        found: dict[str, Cells] = {name: {} for name in names}
        for column, *cells in lines:
            for name, cell in zip(names, cells, strict=True):
                if cell:
                    found[name][column] = "" if cell == "." else cell
    return found


def write(group: str, found: Mapping[str, Cells]) -> None:
    EXPECTED.mkdir(exist_ok=True)
    columns = dict.fromkeys(column for cells in found.values() for column in cells)
    with (EXPECTED / f"{group}.csv").open("w", newline="", encoding="utf-8") as file:
        lines = csv.writer(file, lineterminator="\n")
        lines.writerow(["column", *found])
        for column in columns:
            lines.writerow(
                [column, *(c.get(column, None) if c.get(column) != "" else "." for c in found.values())]
            )


def main(wanted: list[str]) -> None:
    records = table()
    chosen = [each for each in records if not wanted or {each.name, each.group} & set(wanted)]
    unknown = set(wanted) - {each.name for each in chosen} - {each.group for each in chosen}
    if unknown:
        sys.exit(f"no record or group {', '.join(sorted(unknown))}")
    for group in dict.fromkeys(each.group for each in chosen):
        old, new = expected(group), {each.name: run(each) for each in chosen if each.group == group}
        for name, cells in new.items():
            if found := changes(old.get(name, {}), cells):
                print(shown(name, found), flush=True)
        names = [each.name for each in records if each.group == group]
        write(group, {name: new.get(name, old.get(name, {})) for name in names})


if __name__ == "__main__":
    main(sys.argv[1:])
