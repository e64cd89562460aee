"""Build the site in a folder, from a copy of the pages: ``python analysis/site/build.py DIR``."""

import shutil
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

ROOT = Path(__file__).resolve().parents[2]
LINKED = "protochain", "structures", "tests"


def build(folder: Path) -> int:
    """Copy what pages are made of, and let Sphinx make them; a warning is an error. Return the status."""
    with TemporaryDirectory() as made:
        source = Path(made) / "protochain"
        left_out = shutil.ignore_patterns("__pycache__", "reference")
        shutil.copytree(ROOT / "analysis", source / "analysis", ignore=left_out)
        for each in (path for path in ROOT.iterdir() if path.is_file()):
            shutil.copy(each, source)
        for name in LINKED:
            (source / name).symlink_to(ROOT / name)
        command = [sys.executable, "-m", "sphinx", "-q", "-W", "-c", "analysis/site", ".", str(folder)]
        return subprocess.run(command, cwd=source).returncode


if __name__ == "__main__":
    if len(sys.argv) != 2:
        raise SystemExit(__doc__)
    raise SystemExit(build(Path(sys.argv[1]).resolve()))
