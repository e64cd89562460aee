"""Exceptions for misuse and bad input, each with a message of one line that says what to do.

The outcome of a run is no exception but a :class:`protochain.minimisers.Status`.
"""


class ProtochainError(ValueError):
    """Bad input: one line that names the file, the place and the remedy."""


class StructureError(ProtochainError):
    """A structure file that cannot be read or prepared."""


class OnlyAlphaError(StructureError):
    """A chain of C-alpha atoms only, which can be measured but not prepared."""


class ForceFieldError(ProtochainError):
    """A force field that is unknown, unsafe, or does not fit the structure."""


class ChainError(ProtochainError):
    """A structure that cannot be modelled as rigid bodies joined by the requested hinges."""


class MechanicsError(ProtochainError):
    """An unphysical mechanism, or a pose at which its equations of motion are singular."""
