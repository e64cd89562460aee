"""What the native engine says of a System it cannot represent."""

from protochain.errors import ForceFieldError


class UnsupportedForceError(ForceFieldError):
    """A force without an exact counterpart among the native kernels; its text names the force."""
