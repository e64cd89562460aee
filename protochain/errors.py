"""Misuse and bad input, as exceptions whose text is one line a user can act on.

How a run ended is not an error: that is :class:`protochain.minimisers.Status`.
"""


class ProtochainError(ValueError):
    """Bad input: one line naming the file, the place and the mend."""


class StructureError(ProtochainError):
    """A structure file that cannot be used as it is."""


class ForceFieldError(ProtochainError):
    """A force field that is unknown, unsafe, or does not fit the structure."""


class ChainError(ProtochainError):
    """A structure that cannot be modelled as rigid bodies joined by the hinges asked for."""


class MechanicsError(ProtochainError):
    """A mechanism that no rigid bodies can have, or a pose at which its equations have no answer."""
