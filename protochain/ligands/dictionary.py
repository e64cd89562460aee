"""One component of the Chemical Component Dictionary that biotite carries.

Biotite decodes all 49,000 components, in seconds, and uses 800 MB. This module decodes only the rows of one
component (BinaryCIF: Sehnal et al., PLoS Comput. Biol. 16:e1008247, 2020).
"""

import warnings
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from protochain.core.optional_libraries import library

_COLUMNS = {
    "chem_comp_atom": (
        "comp_id", "atom_id", "type_symbol", "charge", "pdbx_leaving_atom_flag",
        *(f"{prefix}_{axis}{ideal}" for axis in "xyz"
          for prefix, ideal in (("pdbx_model_Cartn", "_ideal"), ("model_Cartn", ""))),
    ),
    "chem_comp_bond": ("comp_id", "atom_id_1", "atom_id_2", "value_order", "pdbx_aromatic_flag"),
}  # fmt: skip
"""Columns from which biotite builds a component."""


def leaving(name: str) -> frozenset[str]:
    """Atoms of a component that leave when it is bonded to others, none for an unknown component."""
    atoms = _decode(name)
    if atoms is None or "leaving" not in atoms.get_annotation_categories():
        return frozenset()
    return frozenset(atoms.atom_name[atoms.leaving].tolist())


def heavy_atoms(name: str) -> frozenset[str]:
    """Names of the heavy atoms of a component, none for an unknown component."""
    atoms = _decode(name)
    return frozenset() if atoms is None else frozenset(atoms.atom_name[atoms.element != "H"].tolist())


def elements(name: str) -> dict[str, str]:
    """Elements of the atoms of a component by their names, empty for an unknown component."""
    atoms = _decode(name)
    return {} if atoms is None else dict(zip(atoms.atom_name.tolist(), atoms.element.tolist(), strict=True))


def charges(name: str) -> dict[str, int]:
    """Formal charges of the atoms of a component by name, none for an unknown component."""
    atoms = _decode(name)
    return {} if atoms is None else dict(zip(atoms.atom_name.tolist(), map(int, atoms.charge), strict=True))


def component(name: str) -> Any:
    """Atoms and bonds of a component, as biotite's ``residue`` returns them, with atoms that may leave."""
    if (atoms := _decode(name)) is None:  # A traceback retains the frame: it has no large array here.
        raise KeyError(name)
    return atoms


@lru_cache(maxsize=256)
def _decode(name: str) -> Any:
    """Component, or None if there is none of that name."""
    info = library("biotite.structure.info")
    file = Path(info.__file__).with_name("components.bcif")
    if not file.is_file():
        return info.residue(name)
    pdbx = library("biotite.structure.io.pdbx")
    tables = _read_rows(name, file, pdbx)
    if not tables["chem_comp_atom"].row_count:
        return None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # Ideal coordinates or, if missing, the model's.
            atoms = pdbx.get_component(pdbx.BinaryCIFBlock(tables), res_name=name)
    except ValueError:  # 62 entries have neither.
        return None
    names, flags = (tables["chem_comp_atom"][key].as_array() for key in ("atom_id", "pdbx_leaving_atom_flag"))
    leave = dict(zip(names, flags, strict=True))
    atoms.set_annotation("leaving", np.array([leave.get(atom) == "Y" for atom in atoms.atom_name]))
    return atoms


def _read_rows(name: str, file: Path, pdbx: Any) -> dict[str, Any]:
    """Categories of the dictionary with the rows of a component."""
    categories = library("msgpack").unpackb(file.read_bytes())["dataBlocks"][0]["categories"]
    tables = {table["name"].removeprefix("_"): table["columns"] for table in categories}
    selected = {}
    for table, names in _COLUMNS.items():
        columns = {column["name"]: column for column in tables[table]}
        rows = _rows_of(name, columns["comp_id"]["data"], pdbx.BinaryCIFData)
        selected[table] = pdbx.BinaryCIFCategory(
            {key: pdbx.BinaryCIFColumn(*_values(columns[key], rows, pdbx.BinaryCIFData)) for key in names}
        )
    return selected


def _rows_of(name: str, data: Any, decoder: Any) -> Any:
    """Rows whose text is a name."""
    text_index, texts = _texts(data, decoder)
    numbers = [k for k, text in enumerate(texts) if text == name]
    return np.flatnonzero(text_index == numbers[0]) if numbers else np.empty(0, dtype=np.int64)


def _values(column: Any, rows: Any, decoder: Any) -> tuple[Any, Any]:
    """Values of a column, and the mask of missing values, if there are any."""
    data, mask = column["data"], column["mask"]
    if data["encoding"][0]["kind"] == "StringArray":
        text_index, texts = _texts(data, decoder)
        values = np.array([texts[k] if k >= 0 else "" for k in text_index[rows]], dtype=str)
    else:
        values = decoder.deserialize(data).array[rows]
    return values, None if mask is None else decoder.deserialize(mask).array[rows]


def _texts(data: Any, decoder: Any) -> tuple[Any, list[str]]:
    """Number of the text of each row, and these texts."""
    spec = data["encoding"][0]
    text_index = decoder.deserialize({"data": data["data"], "encoding": spec["dataEncoding"]}).array
    ends = decoder.deserialize({"data": spec["offsets"], "encoding": spec["offsetEncoding"]}).array.tolist()
    return text_index, [spec["stringData"][a:b] for a, b in pairwise(ends)]
