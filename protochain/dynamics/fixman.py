"""The Fixman potential: what makes rigid bonds and angles sample torsions as stiff springs would."""

from protochain.arrays import Floats
from protochain.dynamics.system import Potential
from protochain.multibody import articulated
from protochain.multibody.articulated import Articulated
from protochain.multibody.operational import gradient_of_log_det


def fixman(thermal_energy: float) -> Potential:
    """Fixman's potential at kT = ``thermal_energy``, kJ/mol.

    Parameters
    ----------
    thermal_energy : float, kJ/mol

    Returns
    -------
    callable
        U = (kT/2) ln det M, added to the force field; without it torsions are sampled with a density too
        large by sqrt(det M).

    Notes
    -----
    Fixman, PNAS 71:3050 (1974); its torque by Jain, Kandel, Wagner, Larsen, Vaidehi, J. Chem. Phys.
    139:244103 (2013). O(n). Hinges that open bond angles would need -kT ln sin(angle) each besides, which is
    not added: angles hardly leave their minima.
    """

    def potential(q: Floats, factors: Articulated) -> tuple[float, Floats]:
        half = 0.5 * thermal_energy
        return half * articulated.log_det(factors), -half * gradient_of_log_det(factors)

    return potential
