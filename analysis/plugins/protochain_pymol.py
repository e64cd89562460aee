"""PyMOL plugin: ``run protochain_pymol.py``, then ``protochain_relax OBJECT``.

The relaxed model becomes an object of its own, OBJECT_relaxed. It needs the command ``protochain``, from an
environment of its own if need be: the variable PROTOCHAIN names it.
"""

import json
import os
import shlex
import subprocess
from pathlib import Path
from tempfile import TemporaryDirectory

from pymol import CmdException, cmd


def protochain_relax(selection="all", name="", options="", quiet=0, _self=cmd):
    """
    DESCRIPTION

        Relax a model: overlaps, broken bonds, twisted peptides, inverted stereocentres; the fold kept.

    USAGE

        protochain_relax [ selection [, name [, options ]]]

    ARGUMENTS

        selection = string: what to relax {default: all}

        name = string: name of the relaxed object {default: OBJECT_relaxed}

        options = string: further options of protochain relax, as "--preset crystal"
    """  # noqa: D400  # the form that PyMOL's help has
    first = next(iter(_self.get_object_list(selection)), None)
    if first is None:
        raise CmdException(f"{selection}: selects nothing")
    with TemporaryDirectory() as folder:
        model, relaxed = (Path(folder) / each for each in ("model.pdb", "relaxed.pdb"))
        _self.save(str(model), selection, -1)
        program = os.environ.get("PROTOCHAIN", "protochain")
        try:
            call = [*shlex.split(program), "relax", str(model), "-o", str(relaxed), "--json"]
            call += shlex.split(options)
            done = subprocess.run(call, capture_output=True, encoding="utf-8", errors="replace")
        except (OSError, ValueError) as error:
            why = getattr(error, "strerror", None) or error
            raise CmdException(f"{program}: {why}; set PROTOCHAIN to the command protochain") from None
        try:
            record = json.loads(done.stdout) if done.returncode in (0, 3) and relaxed.exists() else None
        except ValueError:
            record = None
        if not isinstance(record, dict):
            lines = done.stderr.strip().splitlines()
            how = f"signal {-done.returncode}" if done.returncode < 0 else f"status {done.returncode}"
            raise CmdException(lines[-1] if lines else f"{program}: ended by {how} without a result")
        name = name or f"{first}_relaxed"
        _self.load(str(relaxed), name)
    if not int(quiet):
        print(f" protochain: {name}: {record['message']}")
        for key in ("violations", "overlaps", "twisted_peptides", "inverted_stereocentres"):
            print(f" {key.replace('_', ' ')}: {record[f'{key}_start']} before, {record[f'{key}_end']} after")
    return record


cmd.extend("protochain_relax", protochain_relax)
cmd.auto_arg[0]["protochain_relax"] = cmd.auto_arg[0]["align"]
