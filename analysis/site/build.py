"""Build the site in a folder, from a copy of the pages: ``python analysis/site/build.py DIR``."""

import shutil
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

ROOT = Path(__file__).resolve().parents[2]
COPIED = "*.md", "pyproject.toml", "LICENSE", "CITATION.cff", "analysis", "structures"


def build(folder: Path) -> int:
    """Copy what pages are made of, and let Sphinx make them; a warning is an error. Return the status."""
    with TemporaryDirectory() as made:
        source = Path(made) / "protochain"
        source.mkdir()
        for each in (path for pattern in COPIED for path in ROOT.glob(pattern)):
            if each.is_dir():
                shutil.copytree(
                    each, source / each.name, ignore=shutil.ignore_patterns("__pycache__", "reference")
                )
            else:
                shutil.copy(each, source / each.name)
        command = [sys.executable, "-m", "sphinx", "-q", "-W", "-c", "analysis/site", ".", str(folder)]
        return subprocess.run(command, cwd=source).returncode


if __name__ == "__main__":
    if len(sys.argv) != 2:
        raise SystemExit(__doc__)
    raise SystemExit(build(Path(sys.argv[1]).resolve()))
