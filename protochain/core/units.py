"""Units: nm, ps, amu, kJ/mol, rad and kelvin inside. Other units appear only at input and output.

In these units kJ/mol = amu nm^2/ps^2, so mechanics needs no conversion constants.
"""

ANGSTROM_PER_NM = 10.0
"""Angstroms in one nanometre."""
KJ_PER_KCAL = 4.184
"""kJ in one thermochemical kilocalorie."""
MOLAR_GAS = 8.31446261815324e-3
"""kJ/mol/K: Boltzmann's constant times Avogadro's (exact since 2019)."""
COULOMB = 138.93545764438198
"""kJ nm/mol/e^2, 1/(4 pi epsilon0), as OpenMM's NonbondedForce and GBSAOBCForce round it."""
LIGHT = 0.0299792458
"""cm/ps: speed of light (exact)."""
MOLAR_PLANCK = 0.3990312712893431
"""kJ ps/mol: Planck's constant times Avogadro's (exact since 2019)."""
