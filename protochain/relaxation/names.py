"""Names of relaxed files."""

from pathlib import Path

from protochain.structure.formats.files import split_name, suffix_of

_UNRELAXED, _RELAXED = "unrelaxed", "relaxed"


def relaxed_stem(stem: str) -> str:
    """Name a result after its input.

    As in ColabFold and AlphaFold, ``x_unrelaxed_rank_001_y`` becomes ``x_relaxed_rank_001_y``. All other
    names end in ``.relaxed``.
    """
    if _UNRELAXED in stem:
        return _RELAXED.join(stem.rsplit(_UNRELAXED, 1))
    return f"{stem}.{_RELAXED}"


def relaxed_name(source: Path) -> str:
    """Name of a result, in the format of its input."""
    stem = "stdin" if str(source) == "-" else split_name(source)[0]
    return f"{relaxed_stem(stem)}{suffix_of(source)}"
