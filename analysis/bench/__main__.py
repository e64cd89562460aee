"""``python analysis/bench [NAME] [IN...] [-o DIR]``: studies of proteins, scenes of mechanisms.

Cases are right, refused or wrong. Exit status 1 if one is wrong, 2 for bad input.
``python analysis/bench all`` makes every table of the pages anew; its options are those of benchmarks/all.py.
``python analysis/bench quick`` measures the claims of README on samples, in five minutes.
"""

import argparse
import importlib
import sys
from collections.abc import Sequence
from inspect import signature
from pathlib import Path
from typing import Any

if __name__ == "__main__":
    # The package itself, instead of its folder.
    sys.path[0] = str(Path(__file__).resolve().parents[1])

from bench import cases, scenes, studies
from protochain.core.checks import words
from protochain.core.errors import ProtochainError
from protochain.core.storage import check_writable

OPTIONS: dict[str, tuple[Any, str]] = {
    "rows": (words, "of stability: rows of its grid, with commas between"),
    "only": (words, "of precision: kinds of curves, with commas between"),
    "threads": (int, "of stability: also computed on so many [default: 2]"),
    "minutes": (float, "of kcm, lowest: start no run after so many; call again to go on [default: 60, 20]"),
    "jobs": (int, "of kcm: processes [default: 1]"),
    "starts": (int, "of kcm: perturbed starts of each kind [default: 1]; of lowest: seeds [default: 1]"),
    "evaluations": (int, "of kcm: most of a run [default: 128000]"),
    "figure": (Path, "of kcm: also its figure for a paper; FILE.svg, .pdf or .png"),
}
"""Options that are keywords of some studies: how each is read, and its help."""


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command."""
    own = argparse.ArgumentParser(prog="python analysis/bench", description=__doc__)
    own.add_argument(
        "name", nargs="?", metavar="NAME", help="a study or scene, or all tables; none lists them"
    )
    own.add_argument("inputs", nargs="*", type=Path, metavar="IN", help="structures for a study")
    own.add_argument("-o", "--output", type=Path, default=Path("bench"), metavar="DIR")
    own.add_argument("--quick", action="store_true", help="small cases: seconds, or minutes of a study")
    for option, (read, help_text) in OPTIONS.items():
        own.add_argument(f"--{option}", type=read, help=help_text)
    return own


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a study or scene, or every benchmark, or list them; return the exit status."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    if given[:1] in (["all"], ["quick"]):
        sys.path.insert(1, str(Path(__file__).resolve().parents[1] / "benchmarks"))
        return int(importlib.import_module(given[0]).main(given[1:]))
    asked = parser().parse_intermixed_args(given)
    own = {option: value for option in OPTIONS if (value := getattr(asked, option)) is not None}
    try:
        wrong = run(asked.name, asked.inputs, asked.output, asked.quick, **own)
    except ProtochainError as error:
        print(f"bench: {error}", file=sys.stderr)
        return 2
    for each in wrong:
        print(f"bench: {each}", file=sys.stderr)
    return int(bool(wrong))


def run(name: str | None, inputs: Sequence[Path], output: Path, quick: bool, **own: Any) -> list[str]:
    """Run a study or scene; return a line if it is wrong."""
    known = {**studies.STUDIES, **scenes.SCENES}
    if name is None:
        print("\n".join(f"{each:<{max(map(len, known))}}  {line}" for each, line in known.items()))
        return []
    if name not in known:
        raise ProtochainError(f"there is no study or scene {name!r}; choose from {', '.join(known)}")
    check_writable(output / "any.csv")
    for source in inputs:
        if output.resolve() in source.resolve().parents:
            raise ProtochainError(f"{source}: is inside the output folder; give another with -o")
    if name in studies.STUDIES:
        return _study(name, inputs, output, {"quick": quick, **own})
    if own or inputs:
        raise ProtochainError(f"{name}: a scene takes no files, and of the options only -o and --quick")
    return _scene(name, output, quick)


def _study(name: str, inputs: Sequence[Path], folder: Path, own: dict[str, Any]) -> list[str]:
    module = studies.study(name)
    known = signature(module.run).parameters
    if other := next((option for option in own if option not in known and own[option]), None):
        raise ProtochainError(f"{other}: study {name!r} has no such option")
    wrong = 0
    for table in module.run(folder, inputs, **{option: own[option] for option in own if option in known}):
        if len(table):
            print(table.to_string(index=False), end="\n\n", flush=True)
        wrong += int((table["verdict"] == "wrong").sum()) if "verdict" in table else 0
    print(f"written: tables and plots in {folder}")
    return [f"study {name}: wrong: {wrong}; the tables in {folder} show which"] if wrong else []


def _scene(name: str, folder: Path, quick: bool) -> list[str]:
    found = scenes.run(name, quick)
    made = cases.write(found, folder)
    print(f"{found.name}: {found.title}")
    tables = found.frames()
    print(f"{len(found.extremes)} extremes; those that are wrong are listed below")
    tables["extremes"] = tables["extremes"].query("outcome == 'wrong'")
    for key in ("checks", "work", "extremes", "left_out"):
        if len(table := tables[key]):
            print(f"\n{key.replace('_', ' ')}\n{table.to_string(index=False, float_format='{:.3g}'.format)}")
    print(f"\nmade by {made['versions']}, commit {made['commit']}, on {made['machine']}, 1 thread")
    print(f"written: tables and work.png in {folder}", flush=True)
    wrong = "; ".join(found.wrong)
    return [f"scene {name}: wrong: {wrong}; the tables in {folder} show how"] if wrong else []


if __name__ == "__main__":
    sys.exit(main())
