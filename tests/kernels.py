"""Write protochain/kernels.txt anew: the kernels that helpers compile on a fresh installation.

    python tests/kernels.py

It runs `protochain relax` and `protochain minimise` of a sample with an empty cache, each in a process
without helpers, and lists what they compile, by themselves or within other kernels, if that takes long. A
kernel comes before those that call it, and before those that the run needs earlier.
"""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parent.parent
LIST = ROOT / "protochain" / "kernels.txt"
LONG = 0.25
"""s of a processor. Shorter ones are listed only if the run calls them itself."""
HEAD = """\
# Kernels of `protochain relax` and `minimise` by default, in the order in which helpers compile them: module,
# name, types of arguments as protochain.core.compile_helpers.type_of reads them. Written by tests/kernels.py.
"""
RUN = """
import sys
from time import process_time
from protochain.core import compile_helpers, compilation
from protochain.cli import main

found, inside = [], []
compile_it = compilation._compile

def compiled(kernel, by_numba, types):
    there = tuple(types) in kernel.overloads
    mine = [None, len(inside), 0.0]
    if not there:
        found.append(mine)
    inside.append(kernel)
    began = process_time()
    try:
        return compile_it(kernel, by_numba, types)
    finally:
        inside.pop()
        mine[2] = process_time() - began
        try:
            mine[0] = compile_helpers.entry_of(kernel, tuple(types))
        except KeyError:
            pass

compilation._compile = compiled
sys.argv = ["protochain", *{arguments}]
try:
    main()
except SystemExit as end:
    assert not end.code, end
for entry, depth, seconds in found:
    if entry and (depth == 0 or seconds > {long}):
        print("KERNEL", entry)
"""


def compiled(command: str, folder: Path) -> list[str]:
    """Lines of the kernels that a command compiles, in the order in which it begins them."""
    arguments = [command, str(ROOT / "structures" / "1l2y.pdb"), "-o", str(folder / f"{command}.pdb")]
    arguments += ["--threads", "1"]
    surroundings = os.environ | {"NUMBA_CACHE_DIR": str(folder / command), "PROTOCHAIN_HELPER": "0"}
    program = RUN.format(arguments=arguments, long=LONG)
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
