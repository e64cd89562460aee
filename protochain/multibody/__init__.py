"""O(n) mechanics of trees of rigid bodies. Knows nothing of proteins or energies."""

from protochain.multibody.kinematics import Frames, integrate, pose, pull_back
from protochain.multibody.tree import HingeKind, Tree

__all__ = ["Frames", "HingeKind", "Tree", "integrate", "pose", "pull_back"]
