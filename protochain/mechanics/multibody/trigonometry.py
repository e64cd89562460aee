"""Cosines and sines of many angles at once, in a form without branches that the compiler vectorises."""

import numpy as np

from protochain.core.arrays import Floats
from protochain.mechanics.multibody.algebra import kernel

_HALF_PI = (1.5707963267341256, 6.077100506303966e-11, 2.0222662487959506e-21)
"""Value of pi/2 in parts of 33 bits: products with whole numbers below 2^20 are exact (Cody, Waite, 1980)."""
_LARGEST = 1e6
"""Largest angle, rad, whose reduction loses no digits. Beyond it the library's functions are used."""
_SINE = (
    -1.66666666666666324348e-1, 8.33333333332248946124e-3, -1.98412698298579493134e-4,
    2.75573137070700676789e-6, -2.50507602534068634195e-8, 1.58969099521155010221e-10,
)  # fmt: skip
_COSINE = (
    4.16666666666666019037e-2, -1.38888888888741095749e-3, 2.48015872894767294178e-5,
    -2.75573143513906633035e-7, 2.08757232129817482790e-9, -1.13596475577881948265e-11,
)  # fmt: skip
"""Minimax polynomials on [-pi/4, pi/4] of fdlibm's k_sin.c and k_cos.c (Sun Microsystems, 1993)."""


@kernel
def cosines_and_sines(angle: Floats, cosine: Floats, sine: Floats) -> None:
    """Write cos and sin of each angle, to an error of one unit in the last place or so."""
    # Counted rather than left early: a branch would prevent the compiler from vectorising the loop.
    beyond = 0
    for i in range(len(angle)):
        x = angle[i]
        quarter = np.floor(x * (2.0 / np.pi) + 0.5)
        y = ((x - quarter * _HALF_PI[0]) - quarter * _HALF_PI[1]) - quarter * _HALF_PI[2]
        z = y * y
        s, c = _SINE, _COSINE
        small_sine = y + y * z * (s[0] + z * (s[1] + z * (s[2] + z * (s[3] + z * (s[4] + z * s[5])))))
        tail = c[0] + z * (c[1] + z * (c[2] + z * (c[3] + z * (c[4] + z * c[5]))))
        small_cosine = 1.0 - 0.5 * z + z * z * tail
        # Quarter turns: odd ones swap sine and cosine, two of them change signs.
        half = np.floor(0.5 * quarter)
        parity = quarter - 2.0 * half
        sign = 1.0 - 2.0 * (half - 2.0 * np.floor(0.5 * half))
        cosine[i] = sign * ((1.0 - parity) * small_cosine - parity * small_sine)
        sine[i] = sign * ((1.0 - parity) * small_sine + parity * small_cosine)
        beyond += not abs(x) < _LARGEST
    if beyond:
        for i in range(len(angle)):
            cosine[i], sine[i] = np.cos(angle[i]), np.sin(angle[i])
