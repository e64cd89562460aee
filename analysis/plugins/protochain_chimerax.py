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
        program = shlex.split(os.environ.get("PROTOCHAIN", "protochain"))
        call = [*program, "relax", str(model), "-o", str(relaxed), "--json", *shlex.split(options)]
        done = subprocess.run(call, capture_output=True, text=True)
        if done.returncode not in (0, 3):
            raise UserError(done.stderr.strip().splitlines()[-1])
        name = "".join(each for each in structure.name if each.isalnum() or each in " ._-#:")
        (opened,) = run(session, f'open "{relaxed}" format pdb name "{name} relaxed"', log=False)
    opened.position = structure.position
    record = json.loads(done.stdout)
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
