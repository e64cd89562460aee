"""One loop for all minimisers; directions times step rules; OpenMM's minimiser as the reference."""

from protochain.minimisers.api import minimise
from protochain.minimisers.curvature import near_terms
from protochain.minimisers.descent import Descent, Direction
from protochain.minimisers.fire import Fire
from protochain.minimisers.kcm import KCM, Proportional
from protochain.minimisers.lbfgs import LBFGS
from protochain.minimisers.loop import Method, Stop, run
from protochain.minimisers.metrics import Euclidean, Mass, Preconditioner, Stiffness
from protochain.minimisers.newton import Newton, PseudoTransient
from protochain.minimisers.problem import BudgetSpentError, Evaluation, Problem
from protochain.minimisers.recipes import METHODS, RECIPES, Recipe, Run, recipe_of
from protochain.minimisers.solution import Solution
from protochain.minimisers.spaces import Cartesian, Torsions
from protochain.minimisers.starts import Starts, explore, parted
from protochain.minimisers.steps import AcceptReject, Armijo, Decaying, Fixed, StrongWolfe
from protochain.minimisers.verdict import Judgement, Status

minimize = minimise

__all__ = [
    "KCM", "LBFGS", "METHODS", "RECIPES", "AcceptReject", "Armijo", "BudgetSpentError",
    "Cartesian", "Decaying", "Descent", "Direction", "Euclidean", "Evaluation", "Fire", "Fixed",
    "Judgement", "Mass", "Method", "Newton", "Preconditioner", "Problem", "Proportional", "PseudoTransient",
    "Recipe", "Run", "Solution", "Starts", "Status", "Stiffness", "Stop", "StrongWolfe", "Torsions",
    "explore", "minimise", "minimize", "near_terms", "parted", "recipe_of", "run",
]  # fmt: skip
