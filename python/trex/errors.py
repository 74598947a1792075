"""Exceptions: one class for each code of the library, four parts as attributes.

``what`` failed, ``where`` (a path with a line or a byte, a setting, a ray), the ``numbers`` that show it, and the
``next_step``. All are text; ``numbers`` may be empty. ``code`` is the stable name that the command prints too.
"""

from __future__ import annotations


class TrexError(Exception):
    """An error of trex. Catch one of its subclasses, or compare ``code``."""

    #: Stable name of the kind of error.
    code = ""

    def __init__(
        self,
        what: str,
        where: str = "",
        numbers: str = "",
        next_step: str = "",
        smallest_limit_bytes: int | None = None,
        message: str | None = None,
    ) -> None:
        self.what = what
        self.where = where
        self.numbers = numbers
        self.next_step = next_step
        #: The smallest memory limit that would do, where the limit is what failed and that is known.
        self.smallest_limit_bytes = smallest_limit_bytes
        # One argument: OSError, which some classes are, gives meaning to more.
        super().__init__(message if message is not None else self._lines())

    def _lines(self) -> str:
        parts = (("where", self.where), ("numbers", self.numbers), ("next", self.next_step))
        lines = [f"{self.what} [{self.code}]"] + [f"  {name}: {part}" for name, part in parts if part]
        return "\n".join(lines)

    def __str__(self) -> str:
        return str(self.args[0])

    def __reduce__(self):
        parts = (self.what, self.where, self.numbers, self.next_step, self.smallest_limit_bytes, self.args[0])
        return type(self), parts


class UsageError(TrexError, ValueError):
    """The call itself makes no sense: arguments that contradict each other, an output that exists."""

    code = "usage"


class InputFormatError(TrexError, ValueError):
    """An input is not what its name or header says."""

    code = "input-format"


class InputTruncatedError(TrexError, ValueError):
    """An input ends early."""

    code = "input-truncated"


class InputRangeError(TrexError, ValueError):
    """An index or a count of an input points outside of what it holds."""

    code = "input-range"


class InputEmptyError(TrexError, ValueError):
    """An input holds no triangle that can be used."""

    code = "input-empty"


class InputUnreadableError(TrexError, OSError):
    """A file cannot be opened: missing, a folder, no permission."""

    code = "input-unreadable"


class InputMismatchError(TrexError, ValueError):
    """Inputs that do not go together."""

    code = "input-mismatch"


class SceneFormatError(TrexError, ValueError):
    """A scene has an unknown key or a value out of range."""

    code = "scene-format"


class MemoryLimitError(TrexError, MemoryError):
    """The work cannot be done under the memory limit; ``smallest_limit_bytes`` says what would do."""

    code = "memory-limit"


class DiskFullError(TrexError, OSError):
    """No space is left, or the quota is used up."""

    code = "disk-full"


class DamagedError(TrexError):
    """A page file is damaged: answers that it may have changed are not given."""

    code = "damaged"


class VersionError(TrexError):
    """A page file of a version, or with features, that this build does not know."""

    code = "version"


class IoError(TrexError, OSError):
    """Reading or writing failed."""

    code = "io"


class InterruptedWorkError(TrexError):
    """The work was stopped. Ctrl-C raises ``KeyboardInterrupt``, as everywhere in Python."""

    code = "interrupted"


class BugError(TrexError, RuntimeError):
    """A mistake in trex."""

    code = "bug"


#: The class of each code.
BY_CODE: dict[str, type[TrexError]] = {kind.code: kind for kind in TrexError.__subclasses__()}


def exception(
    code: str, message: str, what: str, where: str, numbers: str, next_step: str, smallest_limit_bytes: int | None
) -> TrexError:
    """The exception of an error of the library; called by it."""
    return BY_CODE[code](what, where, numbers, next_step, smallest_limit_bytes, message)
