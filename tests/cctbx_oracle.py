"""ramalyze, cbetadev and omegalyze of cctbx on files, as JSON: by itself, as it bears no OpenMM beside it.

python tests/cctbx_oracle.py FILE...
"""

import json
import sys

from iotbx import pdb
from mmtbx.validation.cbetadev import cbetadev
from mmtbx.validation.omegalyze import omegalyze
from mmtbx.validation.ramalyze import ramalyze


def measured(path):
    """Kind of measure, chain, residue (number and insertion code), alternate location and values."""
    hierarchy = pdb.input(path).construct_hierarchy()
    for model in hierarchy.models()[1:]:
        hierarchy.remove_model(model)
    hierarchy.atoms().reset_i_seq()
    for kind, results in (
        (
            "rama",
            ((r, r.phi, r.psi, r.res_type, r.rama_type, r.score / 100) for r in ramalyze(hierarchy).results),
        ),
        ("cbeta", ((r, r.deviation) for r in cbetadev(hierarchy).results)),
        ("omega", ((r, r.omega, r.omega_type) for r in omegalyze(hierarchy).results)),
    ):
        for r, *values in results:
            yield kind, r.chain_id.strip(), r.resseq.strip() + r.icode.strip(), r.altloc.strip(), values


if __name__ == "__main__":
    print(json.dumps({path: list(measured(path)) for path in sys.argv[1:]}))
