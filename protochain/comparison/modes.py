"""Normal modes of a chain, with fluctuations, overlaps, entropy, and the longest time step."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.special import xlogy

from protochain.chains.chain import Chain, pose
from protochain.core.arrays import Floats, Value, means_by
from protochain.core.checks import quantity
from protochain.core.errors import Argument, ProtochainError, refusal
from protochain.core.lazy_pandas import pd
from protochain.core.settings import document_fields
from protochain.core.units import ANGSTROM_PER_NM, LIGHT, MOLAR_GAS, MOLAR_PLANCK
from protochain.energies import Energy
from protochain.mechanics import multibody
from protochain.mechanics.multibody import HingeKind
from protochain.minimisers.solution import alpha_residues
from protochain.structure import Structure
from protochain.structure.matching import match, structure_to_measure
from protochain.structure.molecule.model import B_FACTOR
from protochain.structure.superpose import motion

FLAT = 1.0
"""kJ/mol/rad. Largest torque of a minimum, as for minimisers."""
TEMPERATURE = 300.0
"""K."""
FRAMES = 20
"""Frames of one swing of a mode."""
_STILL = 1e-9  # nm. Joint change of all C-alphas that is only rounding.
_B = 8.0 * np.pi**2 / 3.0  # B factor for a mean square displacement of 1.


@document_fields
@dataclass(frozen=True, eq=False)
class NormalModes(Value):
    """Small motions of a chain about a point, each with one frequency.

    Examples
    --------
    >>> modes = pc.normal_modes(pc.minimise("structures/ala10.pdb", method="newton"), k=2)
    >>> bool(modes.eigenvalues[0] < modes.eigenvalues[1])
    True
    """

    chain: Chain  # The chain, with free roots unless obstacles, the energy or ``fixed`` hold them.
    energy_function: Energy  # Energy of all terms.
    q: Floats  # (n_q,) float: Coordinates of the point.
    # (k,) float, 1/ps^2: Squares of the angular frequencies, the lowest first. Negative if the energy falls
    # along the mode.
    eigenvalues: Floats
    # (n_v, k) float: Rates of all freedoms, with a^T M a = 1 in amu nm^2, and without momentum in free
    # chains.
    modes: Floats
    residuals: Floats  # (k,) float: ``|K a - w^2 M a|``, relative to ``|K| |a|``.
    # (k,) float, 1/ps^2: Upper limits of the errors of eigenvalues by differences of torques, which are 1e-8
    # of K.
    errors: Floats
    largest_eigenvalue: float  # 1/ps^2: Largest eigenvalue of all modes, NaN if it was not found.
    # (n,) float or None, 1/ps^2: All eigenvalues, if the whole Hessian was computed, of up to 2000 freedoms.
    spectrum: Floats | None
    log_det_mass: float  # Logarithm of det M of the counted freedoms.
    # Logarithm of det K of these, if the whole was computed and no mode is negative.
    log_det_hessian: float | None
    max_torque: float  # kJ/mol/rad: Largest torque at the point.
    held_by: str  # Reason for the fixed position of the whole. Empty if its six zero modes were removed.
    n_products: int  # Products with the Hessian, each two evaluations, 0 if it was computed as a whole.
    seconds: float  # Run time.

    @property
    def is_free(self) -> bool:
        """Whether all roots are free."""
        tree = self.chain.tree
        return bool((tree.kind[tree.parent < 0] == HingeKind.FREE).all())

    @property
    def n_modes(self) -> int:
        """Number of modes."""
        return len(self.eigenvalues)

    @cached_property
    def frequencies(self) -> Floats:
        """(k,) float, 1/cm: w/2 pi c, negative for modes along which the energy falls."""
        values = self.eigenvalues
        return np.sign(values) * np.sqrt(np.abs(values)) / (2.0 * np.pi * LIGHT)

    @property
    def n_negative(self) -> int:
        """Number of these modes along which the energy falls by more than the error of differences."""
        return int(np.sum(self.eigenvalues < -self.errors))

    @property
    def is_minimum(self) -> bool:
        """Whether the torques vanish, within 1 kJ/mol/rad, and no mode is negative."""
        return self.max_torque <= FLAT and not self.n_negative

    @property
    def is_stable(self) -> bool:
        """Whether all modes are above zero, so that each has an equilibrium."""
        return bool(self.eigenvalues[0] > self.errors[0])

    @property
    def verdict(self) -> str:
        """Kind of the point, in words."""
        torque = f"largest torque {self.max_torque:.2g} kJ/mol/rad"
        if self.is_minimum:
            return f"a minimum: {torque}, no mode is negative"
        if self.n_negative:
            lowest = f"{self.frequencies[0]:.3g} 1/cm"
            least = "at least " if self.n_negative == self.n_modes < self.n_freedoms else ""
            negative = f"{least}{self.n_negative} negative of {self.n_modes} modes"
            return f"not a minimum: {negative}, {lowest}; {torque}"
        return f"not a minimum: {torque}; minimise it first"

    @cached_property
    def x(self) -> Floats:
        """(na, 3) float, nm: positions at the point."""
        return pose(self.chain, self.q).x

    @property
    def structure(self) -> Structure:
        """Structure at the point."""
        return self.chain.structure.with_positions(self.x)

    def displacements(self, mode: int) -> Floats:
        """Displacements of all atoms along a mode.

        Parameters
        ----------
        mode : int
            From 0.

        Returns
        -------
        (na, 3) float, nm
            J a, for a unit amplitude.
        """
        at = pose(self.chain, self.q)
        twists = multibody.velocities(self.chain.tree, at.frames, self.modes[:, self._check_mode(mode)])
        atom_twists = twists[self.chain.atom_body]
        arm = at.x - at.frames.origin[self.chain.atom_body]
        return np.asarray(atom_twists[:, 3:] + np.cross(atom_twists[:, :3], arm))

    def _check_mode(self, mode: int) -> int:
        if not isinstance(mode, int | np.integer) or not 0 <= mode < self.n_modes:
            raise refusal("mode", repr(mode), f"give a whole number from 0 to {self.n_modes - 1}")
        return int(mode)

    @cached_property
    def _alphas(self) -> Floats:
        """(k, nca, 3) float, nm: displacements of the C-alphas."""
        alpha = self.chain.structure.alpha_carbons
        return np.array([self.displacements(mode)[alpha] for mode in range(self.n_modes)])

    @cached_property
    def collectivity(self) -> Floats:
        """(k,) float: share of the C-alphas that a mode moves, from 1/n to 1.

        exp(-sum p ln p)/n, p shares of squared displacements (Bruschweiler, J. Chem. Phys. 102:3396, 1995).
        """
        return np.array([share_moved(mode) for mode in self._alphas])

    def mean_squares(self, temperature: float = TEMPERATURE) -> Floats:
        """Mean square displacements of the atoms by the modes, each with energy kT.

        Parameters
        ----------
        temperature : float, K

        Returns
        -------
        (na,) float, angstrom^2
            ``kT sum |J a|^2 / w^2``, only over the computed modes.

        Raises
        ------
        ProtochainError
            If a mode is not above zero, because such a point has no equilibrium.
        """
        kt = MOLAR_GAS * positive(temperature, "temperature", "kelvin")
        if not self.is_stable:
            raise ProtochainError(
                f"{self.chain.structure.name}: mode 0 has {self.frequencies[0]:.3g} 1/cm, so there is no "
                "equilibrium; minimise it, or connect its parts"
            )
        squares = np.zeros(self.chain.n_atoms)
        for mode, eigenvalue in enumerate(self.eigenvalues):
            squares += np.sum(self.displacements(mode) ** 2, axis=1) * kt / eigenvalue
        return squares * ANGSTROM_PER_NM**2

    def fluctuations(self, temperature: float = TEMPERATURE) -> "pd.DataFrame":
        """Fluctuations and B factors of the residues that have a C-alpha.

        Parameters
        ----------
        temperature : float, K

        Returns
        -------
        pandas.DataFrame
            Chain, number and name, root mean square displacement of the C-alpha in angstrom, and B factors
            in angstrom^2: 8 pi^2/3 of its square for the C-alpha, the mean over the residue's heavy atoms,
            and the C-alpha's B factor in the file, NaN if the file has another quantity there.

        Raises
        ------
        ProtochainError
            As :meth:`mean_squares`.
        """
        s = self.chain.structure
        squares = self.mean_squares(temperature)
        alpha = s.alpha_carbons
        heavy = s.atom_element != "H"
        means = means_by(s.atom_residue[heavy], squares[heavy], s.n_residues)
        return alpha_residues(s).assign(
            ca_fluctuation_angstrom=np.sqrt(squares[alpha]),
            ca_b_factor_angstrom2=_B * squares[alpha],
            b_factor_angstrom2=_B * means[s.atom_residue[alpha]],
            ca_b_factor_in_file_angstrom2=self._in_file,
        )

    @property
    def b_factor_correlation(self) -> float | None:
        """Pearson's correlation of the C-alphas' B factors with the file's, None without B factors."""
        alpha = self.chain.structure.alpha_carbons
        if len(alpha) < 3 or not np.ptp(self._in_file) > 0.0 or not self.is_stable:
            return None
        return float(np.corrcoef(self.mean_squares()[alpha], self._in_file)[0, 1])

    @property
    def _in_file(self) -> Floats:
        """B factors of the C-alphas in the file, NaN if its column has another quantity."""
        s = self.chain.structure
        return np.where(s.b_factor_quantity == B_FACTOR, s.b_factor[s.alpha_carbons], np.nan)

    def overlap(self, other: Any) -> Floats:
        """Overlap of each mode with the change to another structure.

        Parameters
        ----------
        other : Structure, Solution, path, or anything that :func:`protochain.as_structure` accepts
            Residues are matched as by :func:`protochain.rmsd`.

        Returns
        -------
        (k,) float
            ``|d . D| / |d| |D|`` over C-alphas, with d the displacements of a mode and D the change after
            superposition, both without their rigid motion: Marques, Sanejouand, Proteins 23:557 (1995).

        Raises
        ------
        ProtochainError
            If fewer than three residues match, or nothing changes.
        """
        modes, change = self._modes_and_change(other)
        sizes = np.linalg.norm(modes, axis=1)
        return np.abs(modes @ change) / np.where(sizes > 0.0, sizes, 1.0)

    def cumulative_overlap(self, other: Any) -> Floats:
        """Overlap of the lowest modes together with the change to another structure.

        Parameters
        ----------
        other : Structure, Solution, path, or anything that :func:`protochain.as_structure` accepts

        Returns
        -------
        (k,) float
            Length of the change's projection on the first 1, 2 ... modes, relative to its length. C-alpha
            displacements of torsional modes are not orthogonal, and are orthogonalised first.

        Raises
        ------
        ProtochainError
            As :meth:`overlap`.
        """
        modes, change = self._modes_and_change(other)
        basis = np.linalg.qr(modes.T)[0]
        return np.sqrt(np.minimum(1.0, np.cumsum((change @ basis) ** 2)))

    def _modes_and_change(self, structure: Any) -> tuple[Floats, Floats]:
        """Displacements (k, 3n) of matched C-alphas without rigid motion, and the unit change (3n,)."""
        start = self.structure
        target = structure_to_measure(structure)
        matches = match(start, target)
        alpha = {int(start.atom_residue[atom]): place for place, atom in enumerate(start.alpha_carbons)}
        alpha_of_residue = {int(target.atom_residue[atom]): int(atom) for atom in target.alpha_carbons}
        pairs = [
            (alpha[a], alpha_of_residue[b])
            for a, b in zip(matches.reference.tolist(), matches.model.tolist(), strict=True)
            if a in alpha and b in alpha_of_residue
        ]
        if len(pairs) < 3:
            raise ProtochainError(
                f"{start.name} and {target.name}: fewer than three residues match; give another structure"
            )
        alpha_indices, atoms = (np.array(side) for side in zip(*pairs, strict=True))
        start_positions = start.positions[start.alpha_carbons[alpha_indices]]
        end_positions = target.positions[atoms]
        turn, shift = motion(end_positions, start_positions)
        change = end_positions @ turn.T + shift - start_positions
        modes = np.array([_without_rigid(mode[alpha_indices], start_positions) for mode in self._alphas])
        change = _without_rigid(change, start_positions)
        size = np.linalg.norm(change)
        if not size > _STILL:
            raise ProtochainError(f"{target.name}: has the positions of {start.name}; give another")
        return modes, change / size

    def entropy(self, temperature: float = TEMPERATURE, quantum: bool = True) -> float:
        """Entropy of harmonic oscillators with the frequencies of all modes.

        Parameters
        ----------
        temperature : float, K
        quantum : bool
            Whether to use the energies hbar w (n + 1/2), or their classical limit, k sum (1 + ln kT/hbar w):
            Karplus, Kushick, Macromolecules 14:325 (1981).

        Returns
        -------
        float, kJ/mol/K
            Entropy of the internal freedoms.

        Raises
        ------
        ProtochainError
            If only some of the modes are known, or one is not above zero.
        """
        kt = MOLAR_GAS * positive(temperature, "temperature", "kelvin")
        if self.n_negative or self.max_torque > FLAT:
            raise ProtochainError(f"{self.chain.structure.name}: has no entropy, as it is {self.verdict}")
        hbar, n = MOLAR_PLANCK / (2.0 * np.pi), self.n_freedoms
        if not quantum and self.log_det_hessian is not None:
            half = 0.5 * (self.log_det_hessian - self.log_det_mass)
            return MOLAR_GAS * (n * (1.0 + float(np.log(kt / hbar))) - half)
        if self.spectrum is None or not self.spectrum[0] > 0.0:
            dense = Argument("method", "dense")
            raise ProtochainError(
                "the entropy requires all modes, but only some were computed; give ", dense,
                ", and above 2000 freedoms quantum=False",
            )  # fmt: skip
        x = hbar / kt * np.sqrt(self.spectrum)
        return MOLAR_GAS * float(np.sum(x / np.expm1(x) - np.log(-np.expm1(-x))))

    @property
    def n_freedoms(self) -> int:
        """Number of counted freedoms: all except the six rigid motions of a free chain."""
        return self.chain.n_v - (0 if self.held_by or not self.is_free else 6)

    @property
    def largest_stable_step(self) -> float:
        """Longest time step of the leapfrog in torsions, in ps: 2/w of the fastest mode, NaN if unknown."""
        return 2.0 / float(np.sqrt(self.largest_eigenvalue))

    def swing(self, mode: int, amplitude: float = 1.0, n_frames: int = FRAMES) -> Iterator[Floats]:
        """Positions along one swing of a mode, by turns of the hinges, so that bonds are not stretched.

        Parameters
        ----------
        mode : int
            From 0.
        amplitude : float, angstrom
            Root mean square displacement of the C-alphas at the ends, in the limit of small amplitudes.
            Without C-alphas, of all atoms.
        n_frames : int
            Number of positions, of which the first and the last are at the point.

        Yields
        ------
        (na, 3) float, nm
        """
        amplitude, motion = positive(amplitude, "amplitude", "angstrom"), self.displacements(mode)
        alpha = self.chain.structure.alpha_carbons
        motion = motion[alpha] if len(alpha) else motion
        size = float(np.sqrt(np.mean(np.sum(motion**2, axis=1)))) * ANGSTROM_PER_NM
        for phase in np.linspace(0.0, 2.0 * np.pi, n_frames):
            change = amplitude / size * np.sin(phase) * self.modes[:, mode]
            yield pose(self.chain, multibody.integrate(self.chain.tree, self.q, change)).x

    def table(self) -> "pd.DataFrame":
        """Return a row for each mode, counted from 1: frequency, eigenvalue, collectivity, residual."""
        return pd.DataFrame(
            {
                "mode": np.arange(1, self.n_modes + 1),
                "frequency_per_cm": self.frequencies,
                "eigenvalue_per_ps2": self.eigenvalues,
                "collectivity": self.collectivity,
                "residual": self.residuals,
            }
        )

    def __repr__(self) -> str:
        name = self.chain.structure.name
        low = ", ".join(f"{frequency:.3g}" for frequency in self.frequencies[:3])
        return f"<NormalModes of {name}: {self.n_modes} modes, {low} ... 1/cm; {self.verdict}>"


def share_moved(displacements: Floats) -> float:
    """Collectivity of displacements (n, 3), NaN if they are 0."""
    squares = np.sum(displacements**2, axis=1)
    if not squares.sum() > 0.0:
        return float("nan")
    shares = squares / squares.sum()
    return float(np.exp(-np.sum(xlogy(shares, shares))) / len(shares))


def _without_rigid(displacements: Floats, x: Floats) -> Floats:
    """Displacements (n, 3) of points (n, 3) without their rigid motion, as (3n,)."""
    arm = x - x.mean(axis=0)
    turns = [np.cross(axis, arm).ravel() for axis in np.eye(3)]
    shifts = [np.tile(axis, len(x)) for axis in np.eye(3)]
    # Points on a line have only five.
    rigid, sizes, _ = np.linalg.svd(np.array([*turns, *shifts]).T, full_matrices=False)
    rigid = rigid[:, sizes > 1e-9 * sizes[0]]
    flat = displacements.ravel()
    return flat - rigid @ (rigid.T @ flat)


def positive(value: Any, name: str, unit: str) -> float:
    """Return a number or Quantity in a unit if it is above zero."""
    number = quantity(unit)(value, name)
    if not 0.0 < number < np.inf:
        raise refusal(name, number, "give a number above 0")
    return number
