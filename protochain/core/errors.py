"""Exceptions for misuse and bad input, each with a message of one line and a remedy.

The outcome of a run is a :class:`protochain.minimisers.Status`, not an exception.
"""

import errno
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum


@dataclass(frozen=True)
class Argument:
    """An argument in a message, with the text of Python, as ``time_step`` or ``keep="all"``."""

    name: str
    value: str | bool | None = None  # What to give.

    def __str__(self) -> str:
        value = f'"{self.value}"' if isinstance(self.value, str) else self.value
        return self.name if value is None else f"{self.name}={value}"


@dataclass(frozen=True)
class Angle:
    """An angle in a message, with its unit."""

    radians: float

    def __str__(self) -> str:
        return f"{self.radians:g} rad"


class Fault(Enum):
    """Machine-readable cause of a refusal. The text is for people."""

    BENDS = "nothing is left to bend"
    DEPENDENT = "rows that depend on others"
    DRIVEN = "a driven hinge has no momentum"
    ENDLESS = "an event without end"
    FAR = "far from the origin"
    FRICTION = "friction too high for one solution"
    HALF_TURN = "half a turn"
    IMMOVABLE = "nothing can move"
    INCOMPLETE = "atoms missing or unknown"
    JAMMED = "a contact that sticks"
    NEGATIVE = "below zero"
    NOT_FINITE = "not a finite number"
    NO_EQUILIBRIUM = "no equilibrium"
    NO_INERTIA = "a hinge without inertia"
    NO_INVERSE = "no inverse inertia"
    NO_STIFFNESS = "no stiffness"
    ONLY_ALPHA = "C-alpha atoms only"
    OPEN = "a loop that does not close"
    OVERLAP = "overlap"
    POINTED = "pointed"
    SHAPE = "another shape"
    STEP = "time step too long"
    UNDERCUT = "undercut"


class ProtochainError(ValueError):
    """Bad input: one line that names the file, the place and the remedy.

    Its text names arguments as Python does, :meth:`render` as the caller knows them.

    Parameters
    ----------
    *parts : str, Argument or Angle
        Parts of the line.
    fault : Fault, optional
        Cause, if a caller needs it.

    Examples
    --------
    >>> try:
    ...     pc.load("none.pdb")
    ... except pc.ProtochainError as error:
    ...     print(error)
    none.pdb: cannot be read (No such file or directory); check the name
    """

    fault: Fault | None = None

    def __init__(self, *parts: object, fault: Fault | None = None) -> None:
        super().__init__(*parts)
        if fault is not None:
            self.fault = fault

    def __str__(self) -> str:
        return self.render(str)

    @property
    def parts(self) -> tuple[object, ...]:
        """The line in parts, for an error with a longer message."""
        return self.args

    def render(self, say: Callable[["Argument | Angle"], str]) -> str:
        """Return the line with arguments and angles in the words of ``say``."""
        return "".join(say(part) if isinstance(part, Argument | Angle) else str(part) for part in self.parts)


def refusal(name: str, value: object, *remedy: object) -> ProtochainError:
    """Return the refusal of an argument: its name, its value, and the remedy."""
    return ProtochainError(Argument(name), f" {value}: ", *remedy)


class WriteError(ProtochainError):
    """A file that could not be written, with the system's reason, the other saved files, and the remedy."""

    def __init__(self, path: object, reason: OSError | str, saved: str = "", *then: str | Argument) -> None:
        super().__init__(str(path), reason, saved, *then)

    @property
    def parts(self) -> tuple[object, ...]:
        """The line in parts."""
        path, reason, saved, *then = self.args
        cause = getattr(reason, "strerror", None) or reason
        remedy = _REMEDIES.get(getattr(reason, "errno", errno.ENOSPC), "check the path")
        after = (", then ", *then) if then else (", or give another path, and run again",)
        return (f"{path}: not written ({cause}){saved and f'; saved: {saved}'}; {remedy}", *after)

    def with_saved(self, saved: str, *then: str | Argument) -> "WriteError":
        """Return the same error with a report of the saved files, and a second remedy."""
        path, reason, *_ = self.args
        return WriteError(path, reason, saved, *then)


_REMEDIES = {
    **dict.fromkeys((errno.ENOSPC, errno.EDQUOT, errno.EFBIG), "free space there"),
    **dict.fromkeys((errno.EACCES, errno.EPERM), "change the permissions there"),
    **dict.fromkeys((errno.EMFILE, errno.ENFILE), "allow more open files"),
    errno.EROFS: "make the drive writable",
    errno.ENAMETOOLONG: "give a shorter name",
    errno.EIO: "check the drive",
    errno.ENOENT: "create the folder again",
}
"""What to do about a reason of the system. A reason that is a text is a full disk."""


class WriteWarning(RuntimeWarning):
    """A secondary file could not be written. The result itself is complete."""


class StrayWarning(RuntimeWarning):
    """A run has gone far from a start whose atoms overlapped. It goes on."""


class InertiaWarning(RuntimeWarning):
    """A file of a robot has an inertia that no body can have. The program uses it unchanged."""


class DeviceWarning(RuntimeWarning):
    """A device does not compute, so the processor does."""


class StructureError(ProtochainError):
    """A structure file that cannot be read or prepared."""


class OnlyAlphaError(StructureError):
    """A chain of C-alpha atoms only, which can be measured but not prepared."""

    fault = Fault.ONLY_ALPHA


class ForceFieldError(ProtochainError):
    """A force field that is unknown, unsafe, or does not fit the structure."""


class ChainError(ProtochainError):
    """A structure that cannot be modelled as rigid bodies joined by the requested hinges."""


class MechanicsError(ProtochainError):
    """An unphysical mechanism, or a pose at which its equations of motion are singular."""


class BodyError(MechanicsError):
    """Error of one body of a tree, by its number, with a remedy."""

    def __init__(self, body: int, stated: str, fault: Fault | None = None) -> None:
        super().__init__(int(body), stated, fault=fault)

    @property
    def parts(self) -> tuple[object, ...]:
        """The line in parts."""
        return (f"body {self.args[0]}: {self.args[1]}",)

    def by_name(self, names: Sequence[str]) -> MechanicsError:
        """Return the same error with the name of the body in place of its number."""
        body, stated = self.args
        return MechanicsError(f'body "{names[body]}": {stated}', fault=self.fault)
