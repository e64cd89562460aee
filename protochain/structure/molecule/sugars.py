"""Sugars: their names in the PDB archive, their configuration, and their codes in GLYCAM-06j.

Kirschner et al., J. Comput. Chem. 29:622 (2008). A code has the substituted oxygens, the sugar and its
anomer: 4YB is beta-D-N-acetylglucosamine whose O4 bears another.
"""

from collections.abc import Iterable

_FISCHER = {
    "G": "RLRR", "M": "LLRR", "L": "RLLR", "N": "RRRR", "K": "RRLR", "Q": "RLRR", "H": "LLRR", "F": "RLLR",
    "Y": "RLRR", "W": "LLRR", "V": "RLLR", "Z": "RLRR", "O": "RLLR", "U": "LRLR", "X": "RLR", "A": "LRR",
    "R": "RRR", "D": "LLR",
}  # fmt: skip
"""Sides of the oxygens, or nitrogens, at C2, C3 ... in the Fischer projection of D-sugars, by GLYCAM's
letters: glucose, mannose, galactose, allose, gulose, their 6-deoxy sugars, N-acetylamines and uronic acids,
xylose, arabinose, ribose, lyxose."""
_SIALIC = ("SA", "SB", "GL")
"""N-acetylneuraminic acid of both anomers, and the alpha one of N-glycolylneuraminic acid: D-galacto from C4
to C7, D-glycero at C8."""
SUGARS = {
    "GLC": "GA", "BGC": "GB", "MAN": "MA", "BMA": "MB", "GLA": "LA", "GAL": "LB", "AFD": "NA", "ALL": "NB",
    "GL0": "KB", "GUP": "kA", "NDG": "YA", "NAG": "YB", "BM3": "WA", "BM7": "WB", "A2G": "VA", "NGA": "VB",
    "G6D": "QA", "YYK": "QB", "XXR": "HA", "RAM": "hA", "RM4": "hB", "FCA": "FA", "FCB": "FB", "FUC": "fA",
    "FUL": "fB", "GCU": "ZA", "BDP": "ZB", "ADA": "OA", "GTR": "OB", "IDR": "uA", "XYS": "XA", "XYP": "XB",
    "64K": "AA", "SEJ": "AB", "ARA": "aA", "ARB": "aB", "RIP": "RB", "LDY": "DA", "SIA": "SA", "SLB": "SB",
    "NGC": "GL",
}  # fmt: skip
"""Pyranoses by their names in the PDB archive, with GLYCAM's letters: the sugar, of lower case if it is L,
and its anomer."""
_SUBSTITUTED = {
    "": "0", "23": "Z", "24": "Y", "26": "X", "34": "W", "36": "V", "46": "U", "234": "T", "236": "S",
    "246": "R", "346": "Q", "2346": "P", "4789": "A", "789": "B", "489": "C", "479": "D", "478": "E",
    "89": "F", "79": "G", "78": "H", "49": "I", "48": "J", "47": "K",
}  # fmt: skip
"""First letter of a code by the numbers of substituted oxygens. A single oxygen has its number."""
GLYCOSYLATED = {"ASN": "NLN", "SER": "OLS", "THR": "OLT"}
"""Residues of the protein that may bear sugars, and their GLYCAM names with sugars."""
_AMIDES = {"C7": "C2N", "O7": "O2N", "C8": "CME"}, {"C10": "C5N", "O10": "O5N", "C11": "CME", "O11": "OHG"}


def anomeric_carbon(sugar: str) -> str:
    """Atom of a sugar whose bond to another residue makes the link: C2 of sialic acids."""
    return "C2" if SUGARS[sugar] in _SIALIC else "C1"


def letters_of(code: str) -> str:
    """Letters of a code: ``YB`` of ``4YB``, and of ``4YB-ROH`` with a hydroxyl at its anomeric carbon."""
    return code[1:3]


def last_of_ring(code: str) -> int:
    """Number of the last carbon in the ring of a sugar by its code."""
    return 6 if letters_of(code) in _SIALIC else 5


def sugar_centres(code: str) -> dict[str, tuple[str, str, str]]:
    """Chiral atoms of a sugar by its letters, as ``YB``, each with three neighbours of positive volume."""
    # In a Fischer projection the atoms before and after a centre point away from the viewer. The ring oxygen
    # is before the anomeric carbon, and the oxygen of the link is to the right in alpha-D-sugars.
    is_sialic, is_d = code in _SIALIC, code[0].isupper()
    first, sides = (4, "RLLRR") if is_sialic else (2, _FISCHER[code[0].upper()])
    amine = "C5" if is_sialic else "C2" if code[0] in "YWV" else ""
    is_alpha = code[1] in "AL"
    centres = {"C2": ("O6", "C3", "C1") if is_alpha else ("C3", "O6", "C1")}
    if not is_sialic:
        centres = {"C1": ("O5", "C2", "H1") if is_alpha == is_d else ("C2", "O5", "H1")}
    for k, side in enumerate(sides, first):
        ends = (f"C{k + 1}", f"C{k - 1}") if (side == "R") == is_d else (f"C{k - 1}", f"C{k + 1}")
        centres[f"C{k}"] = (*ends, f"{'N' if amine == f'C{k}' else 'O'}{k}")
    return centres


def glycam_code(letters: str, substituted: Iterable[str]) -> str:
    """Code of a sugar with these substituted oxygens, as ``O4``."""
    where = "".join(sorted(name[1:] for name in substituted))
    return _SUBSTITUTED.get(where, where) + letters


def other_anomer(letters: str) -> str:
    """Letters of the other anomer. N-glycolylneuraminic acid has only one in GLYCAM."""
    return letters[0] + {"A": "B", "B": "A"}.get(letters[1], "?")


def glycam_names(sugar: str) -> dict[str, str]:
    """GLYCAM names of the atoms of a sugar with other names in the PDB archive."""
    code = SUGARS[sugar]
    methyl = {"C6": "C6M"} if code == "hB" else {}
    return _AMIDES[1] if code in _SIALIC else _AMIDES[0] if code[0] in "YWV" else methyl
