"""Default of every setting. Signatures, commands and their documentation refer to these values."""

from typing import Literal

FORCEFIELD = "amber14"
SOLVENT = "obc2"
SALT = 0.0  # mol/l
ENGINE = "auto"
DEVICE = "auto"
DEVICE_FROM, DEVICE_FROM_IN_FRAMES = 5_000, 1_000
"""Atoms from which a GPU pays, by itself and if many structures share one context. On one H200 that needs
1.1 to 1.9 s to make. There a minimisation in OBC2 needs 0.11 s at 7,561 atoms, 3.5 s on 16 cores, and an
evaluation 0.2 ms at 2,500 atoms. At 2,000 atoms 16 cores are as quick."""
JUDGE = "auto"
CUTOFF: Literal["auto"] = "auto"
FULL_UP_TO = 20_000
"""Atoms up to which engines without a tree sum all pairs in a solvent."""
LONG_CUTOFF = 2.0  # nm. Forces differ by 1 to 4 kJ/mol/nm RMS from those of all pairs.
ACCURACY: Literal["auto"] = "auto"
TREE_FROM = 5_000
TREE_FROM_IN_VACUUM = 9_000
"""Atoms from which a tree sums far pairs, because it is quicker. In vacuum no solvent screens them."""
TREE_ACCURACY = 1e-3  # kJ/mol/nm, RMS error of the forces

HINGES = "phi psi chi"
ROOT = "auto"
MOVE = "all"
LIGAND = "ligand"  # what moves in a rigid protein
PH = 7.0
LIGAND_CHARGES = "nagl"  # what Sage 2.3.0, the force field of ligands, was fitted with
KEEP = ("near",)
"""Molecules that become fixed obstacles: all but waters, if an atom is near the protein."""
CAP, CAPPED = "none", ("none", "breaks", "ends", "all")
KEEP_WITHIN = 5.0  # angstrom from a heavy atom of the protein

METHOD = "cartesian"  # ends near its start
FRAME_METHOD = "lbfgs"  # keeps the bond lengths and angles of the dynamics that made the frames
COMPARED = ("kcm", "md", "lbfgs", "cartesian", "openmm")
"""The two methods of the original comparison, the best in torsions, the default, and the reference."""
REPEATS = 3
TOLERANCE = 1.0
"""kJ/mol/rad of the largest torque, or kJ/mol/nm of the RMS force: if hinges turn, and if minima are
compared (:func:`protochain.compare`, many starts)."""
TOLERANCE_IN_ALL_ATOMS = 5.0
"""kJ/mol/nm, of a minimisation by itself: near the start, and 1.0 kJ/mol per residue above the minimum (0.5
to 1.6 in 12 proteins, and 0.9 to 4.0 at 10). OpenMM's default, 10 of the RMS length of the atoms' forces, is
5.8 of their components. The curve is in analysis/docs/measured/minimisers.md."""
MAX_EVALUATIONS = 5000
SEED = 0
PRESET = "predicted"
MAX_ITERATIONS = 2000  # of a relaxation, as ColabFold has it
MAX_OUTER_ITERATIONS = 3
N_STARTS = 10
SPREAD = 0.2  # rad, standard deviation of a perturbed dihedral

TEMPERATURE = 300.0  # K
TIME_STEP = 0.005  # ps
N_STEPS = 10_000
THERMOSTAT = "langevin"
FRICTION = 1.0  # 1/ps
INTEGRATOR = "leapfrog"
LOOPS = "open"
TRAJECTORY_LENGTH = 10
EVERY = 100
TRAJECTORY = "dcd"
CHECKPOINT_EVERY = 10
PULL_STIFFNESS = 1000.0  # kJ/mol/nm^2
PULL_SPEED = 0.01  # nm/ps

BALANCE = 0.03
"""Energy that a motion of a mechanism may gain or lose by its integrator, of the largest in motion."""

BATCH_THREADS = 1
TIME_LIMIT = 3600.0  # s
IMPACT_TOLERANCE = 1e-10
"""Error of a step of an impact's path, relative to its impulse. Plane paths are exact."""

SEARCH = "csa"
SEARCH_TEMPERATURES = (300.0, 600.0)  # K
SEARCH_EVALUATIONS = 400_000
"""100,000 for each walk. From extended Met-enkephalin, 5 of 6 walks then end in its lowest known minimum."""
N_WALKERS = 4
"""Not the number of cores, on which no result may depend."""
N_REPLICAS = 6
PILOT = 120  # rounds
