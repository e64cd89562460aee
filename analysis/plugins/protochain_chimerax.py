"""ChimeraX script: ``open protochain_chimerax.py``, then ``protochain relax #1``.

The relaxed model becomes a model of its own. It needs the command ``protochain``, from an environment of its
own if need be: the variable PROTOCHAIN names it.
"""

import json
import os
import shlex
import subprocess
from pathlib import Path
from tempfile import TemporaryDirectory

from chimerax.atomic import AtomicStructureArg
from chimerax.core.commands import CmdDesc, StringArg, register, run
from chimerax.core.errors import UserError


def relax(session, structure, options=""):
    """Relax a structure by ``protochain relax``; return the relaxed one."""
    with TemporaryDirectory() as folder:
        model, relaxed = (Path(folder) / each for each in ("model.pdb", "relaxed.pdb"))
        run(session, f'save "{model}" format pdb models #{structure.id_string}', log=False)
        program = os.environ.get("PROTOCHAIN", "protochain")
        try:
            call = [*shlex.split(program), "relax", str(model), "-o", str(relaxed), "--json"]
            call += shlex.split(options)
            done = subprocess.run(call, capture_output=True, encoding="utf-8", errors="replace")
        except (OSError, ValueError) as error:
            why = getattr(error, "strerror", None) or error
            raise UserError(f"{program}: {why}; set PROTOCHAIN to the command protochain") from None
        try:
            record = json.loads(done.stdout) if done.returncode in (0, 3) and relaxed.exists() else None
        except ValueError:
            record = None
        if not isinstance(record, dict):
            lines = done.stderr.strip().splitlines()
            how = f"signal {-done.returncode}" if done.returncode < 0 else f"status {done.returncode}"
            raise UserError(lines[-1] if lines else f"{program}: ended by {how} without a result")
        name = "".join(each for each in structure.name if each.isalnum() or each in " ._-#:")
        (opened,) = run(session, f'open "{relaxed}" format pdb name "{name} relaxed"', log=False)
    opened.position = structure.position
    session.logger.info(record["message"])
    for key in ("violations", "overlaps", "twisted_peptides", "inverted_stereocentres"):
        found = f"{record[f'{key}_start']} before, {record[f'{key}_end']} after"
        session.logger.info(f"{key.replace('_', ' ')}: {found}")
    return opened


register(
    "protochain relax",
    CmdDesc(
        required=[("structure", AtomicStructureArg)],
        keyword=[("options", StringArg)],
        synopsis="relax a model, the fold kept",
    ),
    relax,
    logger=session.logger,  # noqa: F821  # what ChimeraX gives a script
)
