"""Rotamers of side chains: the usual dihedrals of each residue, and how often each combination occurs.

Names and frequencies (per cent) are those of the penultimate rotamer library (Lovell, Word, Richardson,
Richardson, Proteins 40:389, 2000), Table I. A name gives each dihedral a letter, p (62 degrees), t (180) or
m (-65), or a number of degrees where the dihedral is not near those.
"""

import re
from functools import cache

import numpy as np

from protochain.core.arrays import Floats, read_only

_DEGREES = {"p": 62.0, "t": 180.0, "m": -65.0}

_LIBRARY = {
    "ARG": "ptp85 .5 ptp180 1 ptt85 2 ptt180 2 ptt-85 2 ptm180 1 ptm-85 1 tpp85 1 tpp180 1 tpt85 2 tpt180 2"
    " ttp85 4 ttp180 3 ttp-105 1 ttt85 2 ttt180 4 ttt-85 3 ttm105 1 ttm180 1 ttm-85 3 mtp85 2 mtp180 5"
    " mtp-105 1 mtt85 4 mtt180 9 mtt-85 6 mtm105 2 mtm180 5 mtm-85 6 mmt85 1 mmt180 2 mmt-85 2 mmm180 1"
    " mmm-85 2",
    "ASN": "p-10 7 p30 9 t-20 12 t30 15 m-20 39 m-80 8 m120 4",
    "ASP": "p-10 10 p30 9 t0 21 t65 6 m-15 51",
    "CYS": "p 23 t 26 m 50",
    "GLN": "pt20 4 pm0 2 tp-100 2 tp60 9 tt0 16 mp0 3 mt-25 35 mm-40 15 mm100 3",
    "GLU": "pt-20 5 pm0 2 tp10 6 tt0 24 tm-25 1 mp0 6 mt-10 33 mm-40 13",
    "HIS": "p-75 9 p80 4 t-165 5 t-80 11 t60 16 m-70 29 m165 7 m80 13",
    "ILE": "p100 1 p170 13 tp 2 t165 8 m100 1 m170 60 mm 15",
    "LEU": "p80 1 tp 29 t145 2 mp 2 mt 59",
    "LYS": "ptpt 1 pttp 1 pttt 2 pttm 1 ptmt .5 tptp 1 tptt 3 tptm 1 ttpp 1 ttpt 2 tttp 4 tttt 13 tttm 3"
    " ttmt 2 ttmm .5 mptt .5 mtpp 1 mtpt 3 mttp 3 mttt 20 mttm 5 mtmt 3 mtmm 1 mmtp 1 mmtt 6 mmtm 1 mmmt 1",
    "MET": "ptp 2 ptm 3 tpp 5 tpt 2 ttp 5 ttt 3 ttm 7 mtp 17 mtt 8 mtm 11 mm103 3 mmt 2 mmm 19",
    "PHE": "p90 13 t80 33 m-85 44 m-30 9",
    "SER": "p 48 t 22 m 29",
    "THR": "p 49 t 7 m 43",
    "TRP": "p-90 11 p90 6 t-105 16 t90 18 m-90 5 m-5 8 m95 32",
    "TYR": "p90 13 t80 34 m-85 43 m-30 9",
    "VAL": "p 6 t 73 m 20",
}


@cache
def rotamers(residue: str) -> tuple[Floats, Floats]:
    """Dihedrals and frequencies of the rotamers of a residue.

    Parameters
    ----------
    residue : str
        Name; of ALA, GLY and PRO there are none.

    Returns
    -------
    (n, n_chi) float, rad
        chi1, chi2, ... as :data:`protochain.structure.residues.CHI` defines them, of the L-amino acid.
    (n,) float
        Frequencies, whose sum is 1.

    Notes
    -----
    Source: Lovell, Word, Richardson, Richardson, Proteins 40:389 (2000).
    """
    words = _LIBRARY.get(residue, "").split()
    chi = [[_DEGREES.get(c) or float(c) for c in re.findall(r"[ptm]|-?\d+", name)] for name in words[::2]]
    frequency = np.array([float(word) for word in words[1::2]])
    return read_only(np.deg2rad(chi)), read_only(frequency / frequency.sum())
