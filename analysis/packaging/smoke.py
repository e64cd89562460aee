"""Install a wheel into an empty environment, and relax a model there, far from the repository.

``python analysis/packaging/smoke.py WHEEL [--python PYTHON] [--uv UV]`` needs nothing but Python. It tells
the seconds from wheel to first relaxed model, and fails unless what is printed fits its schema.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path
from time import perf_counter

SEQUENCE = "NLYIQWLKDGGPSSGRPPPS"
"""Trp-cage, 20 residues: extended, so that its model has to be built first."""
VALIDATE = "import json, jsonschema, sys; jsonschema.validate(*map(json.load, map(open, sys.argv[1:])))"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("wheel", type=Path)
    parser.add_argument("--python", default=sys.executable, help="interpreter of the environment")
    parser.add_argument("--uv", type=Path, help="uv, to install with in place of pip")
    given = parser.parse_args()
    wheel = given.wheel.resolve(strict=True)
    with tempfile.TemporaryDirectory() as name:
        there = Path(name)
        # Nothing of the surroundings: no kernels compiled before, no other protochain.
        clean = {"PATH": os.environ["PATH"], "HOME": name, "MPLBACKEND": "Agg"}
        clean |= {key: value for key, value in os.environ.items() if key.startswith(("PIP_", "UV_", "SSL_"))}

        def call(*words: str | Path) -> str:
            done = subprocess.run([*map(str, words)], cwd=there, env=clean, capture_output=True, text=True)
            if done.returncode:
                raise SystemExit(f"{words}: status {done.returncode}\n{done.stdout}\n{done.stderr}")
            return done.stdout

        began = perf_counter()
        call(given.python, "-m", "venv", there / "env")
        python, protochain = (there / "env" / "bin" / each for each in ("python", "protochain"))
        own = [python, "-m", "pip", "install"]
        pip = [given.uv.absolute(), "pip", "install", "--python", python] if given.uv else own
        call(*pip, "-q", wheel)
        installed = perf_counter()
        call(protochain, "build", SEQUENCE, "-o", "model.pdb")
        built = perf_counter()
        found = call(protochain, "relax", "model.pdb", "--report", "page.html", "--json")
        relaxed = again = perf_counter()
        spent = resource.getrusage(resource.RUSAGE_CHILDREN)
        call(protochain, "relax", "model.pdb", "--json", "--force")
        again = perf_counter() - again
        (there / "found.json").write_text(found)
        (there / "schema.json").write_text(call(protochain, "schema", "relax"))
        call(*pip, "-q", "jsonschema")
        call(python, "-c", VALIDATE, "found.json", "schema.json")
        where = call(python, "-c", "import protochain; print(protochain.__file__)").strip()
        if not where.startswith(name):
            raise SystemExit(f"{where}: is not of the wheel")
        page = (there / "page.html").read_text(encoding="utf-8")
        if "http-equiv" not in page or (there / "model.relaxed.pdb").stat().st_size == 0:
            raise SystemExit("the page or the model is empty")
        record = json.loads(found)
        seconds = {
            "install": installed - began, "build": built - installed, "first relax": relaxed - built,
            "from wheel to relaxed model": relaxed - began, "relax again": again,
        }  # fmt: skip
        print(f"{call(python, '--version').strip()}, {wheel.name}: {record['status']}")
        print(f"processor seconds of it {spent.ru_utime + spent.ru_stime:.1f}, load {os.getloadavg()[0]:.1f}")
        print(f"seconds: {', '.join(f'{of} {its:.1f}' for of, its in seconds.items())}")


if __name__ == "__main__":
    main()
