"""Write protochain/core/kernels.txt anew: the kernels that helpers compile on a fresh installation.

    python tests/kernels.py

It runs `protochain relax` and `protochain minimise` of a sample with an empty cache, each in a process
without helpers, and lists what they compile for calls from Python. A kernel comes before those that the run
needs earlier.
"""

import os
import subprocess
import sys
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parent.parent
LIST = ROOT / "protochain" / "core" / "kernels.txt"
HEAD = """\
# Kernels of `protochain relax` and `minimise` by default, in the order in which helpers compile them: module,
# name, types of arguments as protochain.core.compile_helpers.type_of reads them. Written by tests/kernels.py.
"""
RUN = """
import sys
sys.path.append({tests!r})
from kernels import entry_of
from protochain.core import compilation
from protochain.cli import main

entries = []
compile_it = compilation._compile

def compiled(kernel, store, by_numba, inner, types):
    if not compilation._COMPILING:
        entries.append(entry_of(kernel, tuple(types)))
    return compile_it(kernel, store, by_numba, inner, types)

compilation._compile = compiled
sys.argv = ["protochain", *{arguments}]
try:
    main()
except SystemExit as end:
    assert not end.code, end
for entry in entries:
    print("KERNEL", entry)
"""


def text_of(kind: Any) -> str:
    """Inverse of ``compile_helpers.type_of``; a KeyError for types that it does not know."""
    from numba import types

    if isinstance(kind, types.BaseTuple):
        inside: Any = kind
        return f"({','.join(map(text_of, inside))})"
    if not isinstance(kind, types.Array):
        return {types.float64: "f", types.int64: "i", types.boolean: "b", types.none: "n"}[kind]
    gaps, locked = "s" * (kind.layout == "A"), "r" * (not kind.mutable)
    return f"{text_of(kind.dtype)}{kind.ndim}{locked}{gaps}"


def entry_of(kernel: Any, types: tuple[Any, ...]) -> str:
    """Line of the list; a KeyError for types that it cannot hold."""
    return " ".join([kernel.py_func.__module__, kernel.py_func.__qualname__, *map(text_of, types)])


def loaded() -> list[str]:
    """Lines of kernels with a cache that this process has loaded or compiled, as in the list."""
    found = []
    for name, module in sorted(sys.modules.items()):
        for kernel in vars(module).values() if name.startswith("protochain.") else ():
            if getattr(getattr(kernel, "py_func", None), "__module__", "") == name:
                for types, code in kernel.overloads.items():
                    # Others are called by kernels only.
                    with suppress(KeyError):
                        found += [] if code.library.is_inner else [entry_of(kernel, types)]
    return found


def compiled(command: str, folder: Path) -> list[str]:
    """Lines of the kernels that a command compiles, in the order in which it begins them."""
    arguments = [command, str(ROOT / "structures" / "1l2y.pdb"), "-o", str(folder / f"{command}.pdb")]
    arguments += ["--threads", "1"]
    surroundings = os.environ | {"NUMBA_CACHE_DIR": str(folder / command), "PROTOCHAIN_HELPER": "0"}
    program = RUN.format(arguments=arguments, tests=str(Path(__file__).parent))
    run = subprocess.run(
        [sys.executable, "-c", program], env=surroundings, stdout=subprocess.PIPE, text=True, check=True
    )
    return [line.removeprefix("KERNEL ") for line in run.stdout.splitlines() if line.startswith("KERNEL ")]


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        found = [entry for each in ("relax", "minimise") for entry in reversed(compiled(each, Path(folder)))]
    LIST.write_text(HEAD + "".join(f"{entry}\n" for entry in dict.fromkeys(found)))


if __name__ == "__main__":
    main()
