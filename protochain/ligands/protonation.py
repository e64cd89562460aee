"""Charges of acids and bases at a pH: the most populated state of each site.

Sites and their pKa are dimorphite-dl's [1]_, corrected by ``RULES``. The pKa of phenols and thiophenols
follow from the substituents by Hammett's equation [2]_. The pKa of other aromatic hydroxyls, and of nitrogens
that lose a proton, are means of classes with deviations of three units. These sites lose the proton only if
the pH is above by one deviation. If the net charge at pH 7 is known, the pH is shifted until the sites agree.

.. [1] Ropp, Kaminsky, Yablonski, Durrant, J. Cheminform. 11:14 (2019).
.. [2] Perrin, Dempsey, Serjeant, pKa Prediction for Organic Acids and Bases (1981).
"""

import csv
from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from protochain.core.arrays import Value, read_only
from protochain.core.errors import StructureError
from protochain.core.optional_libraries import library
from protochain.core.units import ANGSTROM_PER_NM
from protochain.ligands.molecule import Molecule, from_rdkit, quietly, to_rdkit


@dataclass(frozen=True)
class Charged(Value):
    """An atom whose formal charge was changed."""

    atom: str
    before: int
    after: int


@dataclass(frozen=True)
class Rule(Value):
    """A site whose pKa dimorphite-dl lacks, or has from too wide a class."""

    # -1: the pattern has the proton, which is lost above the pKa. 1: one without, which is gained below it.
    gain: int
    # Its first atom is the site. Rules are applied in their order, each until it matches no more, so that a
    # pattern may say how neighbours are charged.
    smarts: str
    pka: float
    source: str


_NITRO = "[N+](=O)[O-]"
_PICRYL = f"[c;$(c1c({_NITRO})cc({_NITRO})cc1{_NITRO})]"
_X = "[F,Cl,Br,I]"
_PLAIN = "[c;!$(c-[!#6;!#1]);!$(c-C=[O,N,S]);!$(c-C#N)]"
"""An aromatic carbon with nothing that draws electrons."""
RULES = (
    Rule(-1, "[OX2H,SX2H]-[PX4;!$(P-[O-,S-])]", 2.0, "phosphates, phosphonates, thiophosphates, first: [1]"),
    # Of imides and methylenes alone it is 7.7 and 8.4; in sites they hold magnesium, as ATP, and have -4.
    Rule(-1, "[OX2H,SX2H]-[PX4;$(P-[O-,S-])]-[O,N,C,S]-P", 6.5, "ATP, last: [2]; its analogues: [3]"),
    Rule(-1, "[OX2H,SX2H]-[PX4;$(P-[O-,S-])]-[#7]~C(~[#7])~[#7]", 4.5, "creatine phosphate: [7]"),
    Rule(-1, "[OX2H,SX2H]-[PX4;$(P-[O-,S-]);!$(P(-[O-,S-])-[O-,S-]);$(P=S),$(P-[SX2H,S-])]", 5.4,
         "thiophosphates, second: [1], [8]"),
    Rule(-1, "[OX2H]-[PX4;$(P-[O-])]-[CX4]-[F,Cl,Br]", 5.7, "halomethylphosphonates, second: [9]"),
    Rule(-1, "[OX2H]-[PX4;$(P-[O-])]-[CX4]-[NX4+;!H0]", 5.6, "aminomethylphosphonates, glyphosate: [10]"),
    Rule(-1, "[OX2H]-[PX4;$(P-[O-])]-[CX4]-[CX4]-[NX4+;!H0]", 6.3, "aminoethylphosphonates: [10]"),
    Rule(-1, "[OX2H]-[PX4;$(P-[O-])]-[CX4H2]-[OX2]-C", 6.8, "alkoxymethylphosphonates, adefovir: [5]"),
    Rule(-1, "[OX2H]-[PX4;!H0;$(P-[O-])]", 6.6, "phosphorous acid, second: [1]"),
    Rule(1, "[O-]-P(=O)(-[O-])-[CX4;!$(C-[F,Cl,Br])]-P(=O)(-[O-])-[O-]", 10.7, "bisphosphonates, last: [19]"),
    Rule(1, "[O-]-P(=O)(-[O-])-[CX4;$(C-[F,Cl,Br])]-P(=O)(-[O-])-[O-]", 8.3, "clodronate, last: [10]"),
    Rule(1, "[O-]-P(=O)(-[O-])-[CX4H2]-P(=O)(-[OX2H])-[O-]", 7.3, "methylenediphosphonate, third: [10]"),
    Rule(1, "[O-]-P(=O)(-[O-])-O-P(=O)(-[O-])-[O-]", 9.4, "diphosphate, last: [1]"),
    Rule(1, "[O-]-P(=O)(-[O-])-O-P(=O)(-[O-])-O-P(=O)(-[O-])-[O-]", 9.2, "triphosphate, last: [1]"),
    Rule(-1, "[OX2H]-S(=O)=O", -2.0, "sulphuric and sulphonic acids: [1]"),
    Rule(-1, "[SX2H]-S(=O)=O", 1.6, "thiosulphate, second: [1]"),
    Rule(-1, "[OX2H]-S(=O)(=S)", 1.6, "thiosulphate: [1]"),
    Rule(1, "[O-]-[SX3](=O)-[O-]", 7.2, "hydrogensulphite: [1]"),
    Rule(-1, "[OX2H]-[Se,As;!$(*-[O-])]=O", 2.5, "selenious, selenic, arsenic acids, first: [1]"),
    Rule(-1, "[OX2H]-[As](-[#6])(-[#6])=O", 6.3, "cacodylic acid: [1]"),
    Rule(-1, "[OX2H]-[Se](=O)(=O)", 1.7, "selenic acid: [1]"),
    Rule(-1, "[OX2H]-[As;$(*-[O-]);!$(*(-[O-])-[O-])](=O)", 6.9, "arsenic acid, second: [1]"),
    Rule(-1, "[SX2H]-C#N", -1.8, "thiocyanic acid: [1]"),
    Rule(-1, "[NX2H]=C=S", -1.8, "thiocyanic acid: [1]"),
    Rule(1, "[O-]-C(=O)-[O-]", 10.3, "hydrogencarbonate: [1]"),
    Rule(-1, "[NX4+;!H0]-[CX3](-[NX4+])=[CX3]-[N+](=O)[O-]", -2.0, "nitroethenediamines, second: [5]"),
    Rule(-1, "[NX4+;!H0]-[CX3]=[CX3]-[N+](=O)[O-]", 2.7, "nitroethenediamines, ranitidine: [5]"),
    Rule(-1, "[NX4+;!H0]-[CX3]=[CX3]-C#N", 1.0, "cyanoenamines: [4]"),
    Rule(-1, "[N+;!H0]=C-[NX3]-[$(C#N),$(S(=O)=O)]", 0.4, "cyano- and sulphonylguanidines: [5]"),
    Rule(-1, "[N+;!H0;$(*-C#N),$(*-S(=O)=O)]=C", 0.4, "cyano- and sulphonylguanidines: [5]"),
    Rule(-1, "[N+;!H0]=C(-[NX3])-[NX3]-c1:n:c:c:s1", 6.8, "guanidinothiazoles, famotidine: [5]"),
    Rule(-1, "[N+;!H0]=C1-[NX3]-C(=O)-[CX4]-[NX3]1", 4.8, "glycocyamidines, creatinine: [7]"),
    Rule(-1, "[N+;!H0]1=C(-[NX3])-[NX3]-[CX4]-C1=O", 4.8, "glycocyamidines, creatinine: [7]"),
    Rule(-1, "[N+;!H0]1=C(-[NX3])-[NX3]-C(=O)-[CX4]1", 4.8, "glycocyamidines, creatinine: [7]"),
    Rule(1, "[NX3;H2;+0]-[NX3;+0;!$(N-[!#1;!#7;!$([CX4])])]", 8.0, "hydrazine and alkylhydrazines: [4]"),
    Rule(1, "[nX2+0]1:c(-[NX3H2]):[nX2]:c(-[NX3H2]):[c;!$(c(:c):n)]:c1", 7.2, "diaminopyrimidines: [5]"),
    Rule(1, "[NX2H;+0]=c1:n(-[#6]):c:n:c:c1", 8.8, "1-methyladenines: [11]"),
    Rule(1, "[NX2H;+0]=c1:n(-[#6]):c(=O):n:c:c1", 8.7, "3-methylcytosines: [11]"),
    Rule(-1, "[NX4+;!H0]-[CX3]=[CX3]-[CX3]=O", 1.0, "vinylogous amides, dihydropyridine of NADH: [4]"),
    Rule(-1, "[NX4+;!H0]1-C-C-[NX4+;!H0]-C-C1", 5.4, "piperazine, second: [4]"),
    Rule(-1, "[NX4+;!H0]-[CX4]-[CX4]-[NX4+;!H0]", 6.8, "1,2-diamines, second: [4]"),
    Rule(-1, "[NX4+;!H0]-[OX2]", 6.0, "hydroxylamines: [4]"),
    Rule(-1, "[NX4+;!H0]-P", 3.0, "phosphoramidates: [4]"),
    Rule(-1, "[N+;!H0]=C-[NX3]-C=[N+;!H0]", 2.8, "biguanides, second: [5]"),
    Rule(-1, "[N+;!H0]=[CX3;!$(C(-N)-N)]-[NX3]-C=O", 2.0, "imidazolinones, GFP's chromophore: [6]"),
    Rule(1, f"[nX2+0]1{_PLAIN}{_PLAIN}c(-[NX3+0;!$(N-[C,S]=[O,S])]){_PLAIN}{_PLAIN}1", 9.1,
         "4-aminopyridines and -quinolines: [4]"),
    Rule(-1, "[NX3H](-S(=O)=O)-[c;r5;$(c:n:[o,n])]", 5.7, "sulphonamides of isoxazole, thiadiazole: [5]"),
    Rule(-1, "[NX3H](-S(=O)=O)-c(:n:[cH]):n:[cH]", 6.5, "sulphadiazine: [5]"),
    Rule(-1, "[NX3H](-S(=O)=O)-[c;$(c1:n:c:n:c(-O):c1),$(c1:n:c:n:c:c1-O),$(c:n:c:c-O)]", 6.0,
         "sulphonamides of alkoxypyrimidines: [5]"),
    Rule(-1, "[NX3H](-S(=O)=O)-[c;$(c1:n:n:c(-[F,Cl,Br]):c:c1),$(c1:n:c2:c(:n:c1):c:c:c:c:2)]", 5.9,
         "sulphonamides of halopyridazines and quinoxaline: [5]"),
    Rule(-1, "[NX3H](-S(=O)=O)-S(=O)=O", 1.5, "disulphonimides: [12]"),
    Rule(-1, "[NX3H](-c)-N=C(-C#N)-C#N", 6.0, "dicyanohydrazones, FCCP: [12]"),
    Rule(-1, f"[NX3H](-{_PICRYL})-{_PICRYL}", 2.7, "dipicrylamine: [4]"),
    Rule(-1, "[OX2H]-c1c[c,n]c(=O)oc1", 5.0, "4-hydroxypyrones: [12]"),
    Rule(-1, "[OX2H]-c1cc(=O)oc(-,:[#6])c1", 5.0, "4-hydroxypyrones: [12]"),
    Rule(-1, "[OX2H]-c1c(-[#6,#7,#1])c(=O)oc2ccccc12", 5.0, "4-hydroxycoumarins, warfarin: [5]"),
    Rule(-1, "[OX2H]-c1[cH]c(=O)oc2ccccc12", 4.1, "4-hydroxycoumarin: [12]"),
    Rule(-1, "[OX2H]-[CX3]=[CX3](-C#N)-C=O", 5.2, "cyanoenols, teriflunomide: [5]"),
    Rule(-1, "[OX2H]-[CX3]=[CX3](-[CX3]=O)-[CX3]=O", 3.5, "enols of triacylmethanes: [12]"),
    Rule(-1, "[CX4;!H0](-[CX3](=O)-[#6])(-[CX3](=O)-[#6])-[CX3](=O)-[#6]", 3.5, "triacylmethanes: [12]"),
    Rule(-1, "[CX4;!H0](-C#N)(-[CX3](=O)-[#6])-[CX3](=O)-[#6,#7]", 5.2, "cyanoketones, teriflunomide: [5]"),
    Rule(-1, "[CX4;!H0]1-C(=O)-[C,N,O]-[C,N,O]-C1=O", 4.5, "tetronic acid, phenylbutazone: [12]"),
    Rule(-1, "[CX4;!H0]1-C(=O)-c:c-C1=O", 7.2, "1,3-indandiones: [12]"),
    Rule(-1, "[CX4;!H0](-c)1-C(=O)-c:c-C1=O", 4.1, "2-aryl-1,3-indandiones, phenindione: [5]"),
    Rule(-1, "[CX4;!H0]1-C(=O)-[#6,#7,#8]~[#6]~[#6,#7,#8]-C1=O", 5.0,
         "cyclic diones, dimedone 5.2, barbituric 4.0, Meldrum's acid 5.0: [12]"),
    Rule(-1, "[CX4;!H0](-[CX3](=O)-[#6])-[CX3](=O)-[#6]", 8.9, "acetylacetones: [12]"),
    Rule(1, "[O-]-[C;R;!$(C-C=O)]=[C;R;!$(C(-C=O)-C=O)]-[C;R](=O)-c", 7.7, "tetracyclines, C12: [5]"),
    Rule(-1, "[OX2H]-[#6;r4]~[#6;r4]~[#6;r4]=O", 3.4, "squaric acid: [12]"),
    Rule(-1, "[OX2H]-N=C(-C=O)-C=O", 4.6, "isonitroso diketones, violuric acid: [12]"),
    Rule(-1, "[OX2H]-N(-C=O)-C=O", 6.1, "N-hydroxyimides: [12]"),
    Rule(-1, "[OX2H]-n1nn[#6][#6]1", 4.6, "N-hydroxybenzotriazoles: [12]"),
    Rule(-1, "[OX2H]-n:c=S", 4.7, "N-hydroxypyridinethiones: [4]"),
    Rule(-1, "[OX2H]-n1c(=O)ccc[cH]1", 5.8, "N-hydroxypyridones: [4]"),
    Rule(-1, "[OX2H]-c1:n:o:c:c1", 4.9, "3-hydroxyisoxazoles, muscimol, AMPA: [13]"),
    Rule(-1, "[nH]1:o:c:c:c1=O", 4.9, "3-hydroxyisoxazoles, muscimol, AMPA: [13]"),
    Rule(-1, "[OX2H]-c1:n:s:c:c1", 6.1, "3-hydroxyisothiazoles: [13]"),
    Rule(-1, "[nH]1:s:c:c:c1=O", 6.1, "3-hydroxyisothiazoles: [13]"),
    Rule(-1, "[OX2H]-c1:n:[o,s,n]:n:c1", 5.0, "3-hydroxyfurazans and -thiadiazoles: [13]"),
    Rule(-1, "[nH]1:c(=[O,S]):[o,s]:n:c1", 6.1, "oxadiazolones, azilsartan: [14]"),
    Rule(-1, "[nH]1:[o,s]:c(=[O,S]):n:c1", 6.1, "oxadiazolones, azilsartan: [14]"),
    Rule(-1, "[nH]1:n:c:[o,s]:c1=S", 5.0, "oxadiazolethiones: [4]"),
    Rule(-1, "[SX2H]-c1:n:n:n:n1", 3.9, "mercaptotetrazoles: [4]"),
    Rule(-1, "[nH]1:n:n:n:c1=S", 3.9, "mercaptotetrazoles: [4]"),
    Rule(-1, "[SX2H]-c1:n:n:c:[o,s]1", 5.0, "oxadiazolethiones: [4]"),
    Rule(-1, "[OX2H]-c1:n:n:c:n:c1=O", 4.1, "hydroxytriazinones, ceftriaxone: [5]"),
    Rule(-1, "[nH]1:n:c:n:c(=O):c1=O", 4.1, "hydroxytriazinones, ceftriaxone: [5]"),
    Rule(-1, "[nH]1c(=O)ccc(=O)[nH]1", 5.6, "maleic hydrazides: [4]"),
    Rule(-1, "[OX2H]-c1ccc(=O)[nH]n1", 5.6, "maleic hydrazides: [4]"),
    Rule(-1, "[nH]1c(=O)[nH]c(=O)[nH]c1=O", 6.9, "cyanuric acid: [4]"),
    Rule(-1, f"[nH]1c(=O)[nH]cc({_NITRO})c1=O", 5.5, "5-nitrouracils: [4]"),
    Rule(-1, f"[nH;$(n1nc({_NITRO})nc1),$(n1ncnc1{_NITRO}),$(n1cnc({_NITRO})n1),$(n1nnc({_NITRO})c1)]", 6.0,
         "nitrotriazoles: [15]"),
    Rule(1, f"[n-]1nc({_NITRO})cc1", 9.8, "nitropyrazoles: [15]"),
    Rule(1, f"[n-]1ncc({_NITRO})c1", 9.6, "nitropyrazoles: [15]"),
    Rule(-1, f"[nH]1[c,n]c({_NITRO})c({_NITRO})[c,n]1", 3.0, "dinitroazoles: [15]"),
    Rule(-1, f"[nH]1[c,n][c,n]c({_NITRO})c1{_NITRO}", 3.0, "dinitroazoles: [15]"),
    Rule(-1, f"[nH]1nc({_NITRO})cc1{_NITRO}", 3.1, "dinitroazoles: [15]"),
    Rule(-1, f"[nH]1[n,c]nc2c({_X})c({_X})c({_X})c({_X})c12", 4.8, "tetrahalobenzotriazoles: [16]"),
    Rule(-1, f"[nH]1n[nX2]c2c({_X})c({_X})c({_X})c({_X})c12", 4.8, "tetrahalobenzotriazoles: [16]"),
    Rule(-1, f"[nH]1c(C(F)(F)F)nc2cc({_X})c({_X})cc12", 5.5, "dihalotrifluoromethylbenzimidazoles: [15]"),
    Rule(-1, "[NX3H]1-C(=O)-S-[#6]-C1=[O,S]", 6.4, "thiazolidinediones, pioglitazone: [5]"),
    Rule(-1, "[NX3H]1-C(=S)-S-[#6]-C1=O", 5.2, "rhodanines: [4]"),
    Rule(-1, "[NX3H]1-C(=O)-O-[#6]-C1=O", 6.0, "oxazolidinediones: [5]"),
    Rule(1, "[N-]1-C(=[O,S])-[#7]-C(=O)-[CX4;H0;!$(C-c)]-C1=O", 7.8, "barbiturates, barbital: [5]"),
    Rule(1, "[N-]1-C(=[O,S])-[#7]-C(=O)-[CX4;H0;$(C-c)]-C1=O", 7.4, "barbiturates, phenobarbital: [5]"),
    Rule(1, "[N-]1-C(=O)-[#7]-[CX4;!$(C(-c)-c)]-C1=O", 9.1, "hydantoins: [5]"),
    Rule(1, "[N-]1-C(=O)-[#7]-[CX4;$(C(-c)-c)]-C1=O", 8.3, "diarylhydantoins, phenytoin: [5]"),
    Rule(-1, "[OX2H]-c1ccc2c(c1)[#8][#6][#6]c2-,=[#6]", 6.4, "fluoresceins: [18]"),
    Rule(-1, "[OX2H]-c1ccc2c(c1)[O,o]~[#6]~[#6]~[#6]2-c1ccccc1", 6.4, "fluoresceins: [18]"),
    Rule(-1, f"[OX2H]-c1ccc(cc1)-[N,C]=C1C=C({_X})C(=O)C({_X})=C1", 5.9, "dichloroindophenol: [17]"),
    Rule(-1, "[OX2H]-C=C(-C(=O)-N)-N-S(=O)=O", 4.2, "oxicams: [5]"),
    Rule(-1, "[nH]1c(=O)[nH]c(=O)c2[nH]c(=O)[nH]c12", 5.4, "uric acid, N3: [7]"),
    Rule(1, "[N-;$(N(-C=O)-[#7])]", 12.0, "hydrazides: [4]"),
    Rule(1, "[N-;$(N(-C=O)-[OX2])]", 9.0, "hydroxamic acids: [4]"),
)  # fmt: skip
"""Corrections of dimorphite-dl.

[1] Perrin, Ionisation Constants of Inorganic Acids and Bases (1982). [2] Alberty, Goldberg, Biochemistry
31:10610 (1992). [3] Yount, Babcock, Ballantyne, Ojala, Biochemistry 10:2484 (1971). [4] Perrin, Dissociation
Constants of Organic Bases (1965); Albert, Serjeant, The Determination of Ionization Constants (1984).
[5] Prankerd, Profiles Drug Subst. 33:1 (2007). [6] Bell, He, Wachter, Tonge, Biochemistry 39:4423 (2000).
[7] Dawson et al. (1986), as of ``net_charges``. [8] Jaffe, Cohn, Biochemistry 17:652 (1978). [9] Blackburn,
Kent, J. Chem. Soc. Perkin 1:913 (1986). [10] Martell, Smith, Critical Stability Constants (1974-1989).
[11] Macon, Wolfenden, Biochemistry 7:3453 (1968). [12] Serjeant, Dempsey, Ionisation Constants of Organic
Acids (1979). [13] Brauner-Osborne et al., J. Med. Chem. 43:2609 (2000). [14] Kohara et al., J. Med. Chem.
39:5228 (1996). [15] Catalan, Abboud, Elguero, Adv. Heterocycl. Chem. 41:187 (1987). [16] Wasik et al., J.
Phys. Chem. B 116:7259 (2012). [17] Bishop, Indicators (1972). [18] Sjoback, Nygren, Kubista, Spectrochim.
Acta A 51:L7 (1995): 6.43. [19] Meloun, Ferencikova, Netolicka, Pekarek, J. Chem. Eng. Data 56:3848 (2011):
10.74 of ibandronate. The abstracts of [18] and [19] were read. Values of [8] to [17] could not be verified.
"""
_SIGMA = (
    (f"c-{_NITRO}", 1.24, 0.71, 1.25),
    ("c-N=O", 1.2, 0.62, 1.6),
    ("c-C#N", 1.32, 0.59, 0.88),
    ("c-[CH]=O", 0.70, 0.42, 1.03),
    ("c-C(=O)-[NX3]-c", 1.13, 0.28, 0.61),
    ("c-C(=O)-[#7]", 0.70, 0.28, 0.61),
    ("c-C(=O)-[O-]", -1.56, 0.0, 0.24),
    ("c-C(=O)-[OX2]", 0.02, 0.37, 0.71),
    ("c-,:[#6]=O", -0.06, 0.33, 0.84),
    ("c-[CX4](F)(F)F", 0.43, 0.43, 0.56),
    ("c-S(=O)(=O)-[O-]", 0.4, 0.38, 0.39),
    ("c-S(=O)=O", 0.94, 0.64, 0.94),
    ("c-[$([#6]=[#6]-[$([#6]=O),$(C#N),$([N+]=O)])]", 0.6, 0.2, 0.7),
    ("c:[c;!$(c1ccccc1)]:c:c=O", 0.3, 0.2, 0.7),
    ("c-[N,C]=C1C=CC(=O)C=C1", 0.5, 0.2, 0.8),
    ("c-N=N", 0.3, 0.32, 0.70),
    ("c-F", 0.54, 0.34, 0.06),
    ("c-Cl", 0.68, 0.37, 0.23),
    ("c-Br", 0.70, 0.39, 0.23),
    ("c-I", 0.63, 0.35, 0.18),
    ("c-[O-,S-]", -1.5, -0.7, -0.7),
    ("c-[OX2H]", 0.22, 0.05, -0.10),
    ("c-[OX2]-[$([CX4](F)F),$(C=O)]", 0.3, 0.38, 0.35),
    ("c-[OX2]-c", 0.2, 0.25, 0.0),
    ("c-[OX2]", 0.0, 0.12, -0.12),
    ("c-[NX3]-[C,S]=O", 0.2, 0.21, 0.19),
    ("c-[NX3]", -0.1, 0.02, -0.24),
    ("c-c", 0.0, 0.06, 0.17),
    ("c-[CX4]", -0.13, -0.07, -0.17),
)  # fmt: skip
"""Constants of substituents at the carbon that a pattern begins with: ortho, meta, para to the hydroxyl.

They are of phenols, from Perrin, Dempsey, Serjeant (1981) or as (9.92 - pKa) / 2.23 of the phenol with this
substituent alone, in [12]. The first pattern that matches counts.
"""
_HAMMETT = {"O": (9.92, 2.23), "S": (6.61, 1.5)}
"""pKa without substituents, and its change by sigma: of phenols (Perrin 1981), and the line through
thiophenol and 4-nitrothiophenol of [12]."""
_UNSURE = 0.4
"""Deviations of a class of dimorphite-dl, in units of pH about one for its widest classes."""
_AT_METAL = "[$([CH]#N),$([#7+;!H0]),$([NX3;!H0]-S(=O)=O),$([SX2H]),$([OX2H]-[!$([CX4])])]"
"""Sites that lose a proton to a metal. An alcohol, as of a sugar at calcium, retains its proton."""
_KNOWN = Path(__file__).with_name("net_charges.csv")
_KNOWN_AT = 7.0
_SHIFTS = sorted((0.25 * k for k in range(-20, 21)), key=abs)
"""pH by which rules are shifted to a charge that is known."""


def at_ph(
    molecule: Molecule, ph: float, donors: Collection[str] = ()
) -> tuple[Molecule, tuple[Charged, ...]]:
    """Return a molecule in its state at a pH, and the changes. Metal donors and other hydrogens remain."""
    neutral = library("rdkit.Chem.MolStandardize.rdMolStandardize").Uncharger()
    mol, rank = _number_heavy(molecule)
    smiles = library("rdkit.Chem").MolToSmiles(quietly(neutral.uncharge, mol))
    charge = net_charges().get(skeleton(molecule))
    shift = 0.0 if charge is None else _shift(smiles, charge, rank)
    state = _state(smiles, ph + shift, rank)
    if state is None or {_number(atom) for atom in state.GetAtoms()} != set(molecule.heavy.tolist()):
        raise StructureError(f"{molecule.source}: cannot be charged for pH {ph:g}; give it as it is there")
    for atom in state.GetAtoms():
        k = _number(atom)
        if molecule.names[k] in donors:
            atom.SetFormalCharge(int(molecule.formal_charges[k]))
            ends = molecule.bonds[(molecule.bonds == k).any(axis=1)]
            atom.SetNumExplicitHs(int((molecule.elements[ends] == 1).sum()))
            atom.SetNoImplicit(True)
    return _in_state(molecule, state)


def unsure(molecule: Molecule, ph: float) -> tuple[str, ...]:
    """Names of atoms whose charge at a pH is doubtful: their wide class has this pKa, no rule covers them."""
    if skeleton(molecule) in net_charges():
        return ()
    chem, (mol, _) = library("rdkit.Chem"), _number_heavy(molecule)
    neutral = quietly(library("rdkit.Chem.MolStandardize.rdMolStandardize").Uncharger().uncharge, mol)
    states = _states(chem.MolToSmiles(neutral), ph, _UNSURE)
    charges = [{_number(a): a.GetFormalCharge() for a in state.GetAtoms()} for state in states]
    sites = {k for by_atom in charges for k, charge in by_atom.items() if charge != charges[0].get(k)}
    for smarts in (*(rule.smarts for rule in RULES), _PHENOL):
        for form in (mol, neutral, *states):
            sites -= {_number(form.GetAtomWithIdx(match[0])) for match in _matches(form, smarts)}
    return tuple(molecule.names[k] for k in sorted(sites))


def at_metal(molecule: Molecule, holding: Collection[int]) -> tuple[Molecule, tuple[Charged, ...]]:
    """Return a molecule without the protons that metals displace, and the changes. Azoles retain theirs."""
    if not holding:
        return molecule, ()
    state, rank = _number_heavy(molecule)
    _apply(state, _AT_METAL, -1, rank, holding)
    for site in [atom for atom in state.GetAtoms() if _number(atom) in holding]:
        if site.GetSymbol() == "N" and site.GetIsAromatic() and site.GetTotalNumHs():
            _move_proton(state, site, rank, holding)
    return _in_state(molecule, state)


def _move_proton(state: Any, site: Any, rank: list[int], holding: Collection[int]) -> None:
    """Move the proton of an azole's nitrogen to another of its ring without one, or else away."""
    rings = [ring for ring in state.GetRingInfo().AtomRings() if site.GetIdx() in ring]
    ring_atoms = (state.GetAtomWithIdx(k) for ring in rings for k in ring)
    free = [a for a in ring_atoms if a.GetSymbol() == "N" and a.GetDegree() == 2 and not a.GetTotalNumHs()]
    free = sorted((a for a in free if _number(a) not in holding), key=lambda a: rank[_number(a)])
    if not free:
        _change(site, -1)
        return
    site.SetNumExplicitHs(0)
    free[0].SetNumExplicitHs(1)
    state.UpdatePropertyCache(strict=False)


def _number_heavy(molecule: Molecule) -> tuple[Any, list[int]]:
    """Heavy atoms numbered by isotopes, since dimorphite-dl drops map numbers, and the rank of each atom."""
    chem, mol = library("rdkit.Chem"), to_rdkit(molecule)
    rank = list(chem.CanonicalRankAtoms(mol))
    for atom in mol.GetAtoms():
        atom.SetIsotope(atom.GetIdx() + 1 if atom.GetAtomicNum() != 1 else 0)
    return chem.RemoveAllHs(mol), rank


def _in_state(molecule: Molecule, state: Any) -> tuple[Molecule, tuple[Charged, ...]]:
    """The molecule with charges, hydrogens and orders of bonds as its numbered heavy atoms have them."""
    chem, mol = library("rdkit.Chem"), to_rdkit(molecule)
    chem.Kekulize(state)
    surplus, changed = [], []
    for as_is in state.GetAtoms():
        number = _number(as_is)
        atom = mol.GetAtomWithIdx(number)
        hydrogens = [near.GetIdx() for near in atom.GetNeighbors() if near.GetAtomicNum() == 1]
        n = as_is.GetTotalNumHs()
        surplus += hydrogens[n:]
        if as_is.GetFormalCharge() != atom.GetFormalCharge():
            changed.append(Charged(molecule.names[number], atom.GetFormalCharge(), as_is.GetFormalCharge()))
        atom.SetFormalCharge(as_is.GetFormalCharge())
        atom.SetNumExplicitHs(max(0, n - len(hydrogens)))
    if not surplus and not any(atom.GetNumExplicitHs() for atom in mol.GetAtoms()):
        return molecule, ()
    # Not by Kekulize: a ring with a hydrogen too many, as of histidinium made neutral, has no such form yet.
    for part in (*mol.GetAtoms(), *mol.GetBonds()):
        part.SetIsAromatic(False)
    for bond in state.GetBonds():
        ends = _number(bond.GetBeginAtom()), _number(bond.GetEndAtom())
        mol.GetBondBetweenAtoms(*ends).SetBondType(bond.GetBondType())
    for number in sorted(surplus, reverse=True):
        mol.RemoveAtom(number)
    chem.SanitizeMol(mol)
    return from_rdkit(mol, molecule.source), tuple(sorted(changed, key=lambda change: change.atom))


@lru_cache(maxsize=1)
def net_charges() -> Mapping[str, int]:
    """Net charges at pH 7 that the literature gives, by the skeleton of the molecule.

    Sources: ChEBI, major species at pH 7.3 (Hastings et al., Nucleic Acids Res. 44:D1214, 2016), except its
    dUTP(3-) and lysine(0). MetaCyc, at pH 7.3 (Caspi et al., Nucleic Acids Res. 48:D445, 2020). ``groups``:
    by the pKa of their groups, as of acids and phosphates elsewhere in the table. From pKa: Dawson,
    Elliott, Elliott, Jones, Data for Biochemical Research (1986). Goldberg, Kishore, Lennen, J. Phys. Chem.
    Ref. Data 31:231 (2002). Massey, Biochem. Soc. Trans. 28:283 (2000), of flavins, whose N3 has 10. Perrin
    (1965, 1982), Prankerd (2007) and Yount (1971) as for ``RULES``.
    """
    with _KNOWN.open() as lines:
        return {row["skeleton"]: int(row["charge"]) for row in csv.DictReader(lines)}


def skeleton(molecule: Molecule) -> str:
    """First block of the InChIKey: the same for an acid and its anion, tautomers and stereoisomers."""
    return str(quietly(library("rdkit.Chem").MolToInchiKey, to_rdkit(molecule)))[:14]


def with_hydrogens(molecule: Molecule, count: Mapping[int, int]) -> Molecule | None:
    """Return a molecule with these numbers of hydrogens, each a charge. None if carbons gain or lose any."""
    # Others gain or lose one, all alike: of a tautomer bonds would change.
    chem = library("rdkit.Chem")
    mol = to_rdkit(molecule)
    changes = set()
    surplus = []
    for i, n_hydrogens in count.items():
        atom = mol.GetAtomWithIdx(i)
        hydrogens = [near.GetIdx() for near in atom.GetNeighbors() if near.GetAtomicNum() == 1]
        change = n_hydrogens - len(hydrogens)
        if change:
            changes.add(change)
            if atom.GetAtomicNum() == 6:
                return None
        atom.SetFormalCharge(atom.GetFormalCharge() + change)
        atom.SetNumExplicitHs(max(change, 0))
        surplus += hydrogens[n_hydrogens:]
    if not changes:
        return molecule
    if changes not in ({1}, {-1}):
        return None
    for i in sorted(surplus, reverse=True):
        mol.RemoveAtom(i)
    try:
        quietly(chem.SanitizeMol, mol)
        mol = chem.AddHs(mol, addCoords=True)
        x = mol.GetConformer().GetPositions() / ANGSTROM_PER_NM
        # The stereo is that of the source: at these positions it may be another.
        mol.RemoveAllConformers()
        return replace(from_rdkit(mol, molecule.source), positions=read_only(x))
    except (ValueError, StructureError):
        return None


def _shift(smiles: str, charge: int, rank: list[int]) -> float:
    """Smallest shift of the pH that gives a molecule its charge at pH 7, 0 if no shift does."""
    for shift in _SHIFTS:
        state = _state(smiles, _KNOWN_AT + shift, rank)
        if state is not None and sum(atom.GetFormalCharge() for atom in state.GetAtoms()) == charge:
            return shift
    return 0.0


def _state(smiles: str, ph: float, rank: list[int]) -> Any:
    """RDKit's molecule in its most populated state, isotopes as in the SMILES. None without a state."""
    state = next(iter(_states(smiles, ph, 0.0)), None)
    if state is None:
        return None
    unlikely = [
        atom for atom in state.GetAtoms()
        if atom.GetFormalCharge() < 0
        and (atom.GetAtomicNum() == 7 or any(near.GetIsAromatic() for near in atom.GetNeighbors()))
    ]  # fmt: skip
    unsure = _states(smiles, ph, 1.0) if unlikely else []
    uncertain = {_number(a) for form in unsure for a in form.GetAtoms() if not a.GetFormalCharge()}
    for atom in unlikely:
        if _number(atom) in uncertain:
            _change(atom, 1)
    _settle_phenols(state, ph)
    for rule in RULES:
        if ph > rule.pka if rule.gain < 0 else ph < rule.pka:
            _apply(state, rule.smarts, rule.gain, rank)
    return state


_PHENOL = "[O,S;$([X2H]),$([X1-])]-c1ccccc1"


def _settle_phenols(state: Any, ph: float) -> None:
    """Let phenols and thiophenols lose the proton, the most acidic first, by Hammett's equation."""
    for site, *_ in _matches(state, _PHENOL):
        atom = state.GetAtomWithIdx(site)
        _change(atom, -atom.GetFormalCharge())
    while True:
        sigma: dict[int, tuple[float, float, float]] = {}
        for smarts, *of_places in _SIGMA:
            for carbon, *_ in _matches(state, smarts):
                sigma.setdefault(carbon, (of_places[0], of_places[1], of_places[2]))
        pka: dict[int, float] = {}
        # The ring of a match is in order, from the carbon of the hydroxyl.
        for site, _, *ring in _matches(state, _PHENOL):
            if not state.GetAtomWithIdx(site).GetFormalCharge():
                constants = [
                    sigma.get(carbon, (0.0,) * 3)[place] for carbon, place in zip(ring, _PLACES, strict=True)
                ]
                alone, slope = _HAMMETT[state.GetAtomWithIdx(site).GetSymbol()]
                pka[site] = min(alone - slope * sum(constants), pka.get(site, np.inf))
        if not pka or min(pka.values()) >= ph:
            return
        _change(state.GetAtomWithIdx(min(pka, key=lambda k: (pka[k], k))), -1)
        state.UpdatePropertyCache(strict=False)


_PLACES = (0, 1, 2, 1, 0)
"""Ortho, meta and para, around a ring of six."""


@lru_cache(maxsize=512)
def _query(smarts: str) -> Any:
    return library("rdkit.Chem").MolFromSmarts(smarts)


def _matches(state: Any, smarts: str) -> Any:
    return state.GetSubstructMatches(_query(smarts), uniquify=False)


def _apply(state: Any, smarts: str, gain: int, rank: list[int], among: Collection[int] | None = None) -> None:
    """Let sites that a pattern matches gain or lose a proton, one by one, until none is left."""
    # The first to lose is the one in most matches, as the middle one of three amines in a row, then the one
    # with more neighbours but one that draw electrons, then the one with fewer hydrogens.
    while True:
        often = Counter(match[0] for match in _matches(state, smarts))
        sites = [state.GetAtomWithIdx(k) for k in often]
        sites = [atom for atom in sites if among is None or _number(atom) in among]
        if not sites:
            return
        site = min(
            sites, key=lambda a: (-often[a.GetIdx()], -_drawing(a), a.GetTotalNumHs(), rank[_number(a)])
        )
        _change(site, gain)
        if site.GetSymbol() == "C":
            _draw_enolate(state, site)
        state.UpdatePropertyCache(strict=False)


def _draw_enolate(state: Any, site: Any) -> None:
    """Draw a carbanion next to a carbonyl group as the enolate, as parameters and charges expect."""
    orders = library("rdkit.Chem").BondType
    ends = (m for m in _matches(state, "[C-]-[CX3]=[O,S]") if m[0] == site.GetIdx())
    if (match := next(ends, None)) is None:
        # A carbanion of another kind, as cyanide.
        return
    state.GetBondBetweenAtoms(*match[:2]).SetBondType(orders.DOUBLE)
    state.GetBondBetweenAtoms(*match[1:]).SetBondType(orders.SINGLE)
    site.SetFormalCharge(0)
    state.GetAtomWithIdx(match[2]).SetFormalCharge(-1)


def _drawing(atom: Any) -> int:
    """Number of neighbours of an atom's neighbours, without saturated carbons."""
    sp3 = library("rdkit.Chem").HybridizationType.SP3
    atoms = (second for near in atom.GetNeighbors() for second in near.GetNeighbors())
    return sum(second.GetAtomicNum() != 6 or second.GetHybridization() != sp3 for second in atoms)


def _change(atom: Any, gain: int) -> None:
    atom.SetNumExplicitHs(atom.GetTotalNumHs() + gain)
    atom.SetFormalCharge(atom.GetFormalCharge() + gain)


def _number(atom: Any) -> int:
    """Number of the atom in the molecule, from its isotope."""
    return int(atom.GetIsotope()) - 1


def _states(smiles: str, ph: float, precision: float) -> list[Any]:
    """RDKit's molecule of each state. Sites whose pKa is within so many standard deviations have two."""
    return [library("rdkit.Chem").MolFromSmiles(drawn) for drawn in _state_smiles(smiles, ph, precision)]


@lru_cache(maxsize=64)
def _state_smiles(smiles: str, ph: float, precision: float) -> tuple[str, ...]:
    """SMILES of the states, by dimorphite-dl."""
    protonated = library("dimorphite_dl").protonate_smiles
    limit = 128 if precision else 1
    return tuple(protonated(smiles, ph_min=ph, ph_max=ph, precision=precision, max_variants=limit))
