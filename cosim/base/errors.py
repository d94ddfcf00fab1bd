"""Everything that ends a run on purpose.

``CosimError``
 ├── ``ScenarioError``  a scenario says something that cannot be (file and TOML path)
 ├── ``UnitError``      a unit that does not exist or does not fit
 ├── ``FmuError``       an FMU that cannot be read, loaded or started
 ├── ``MujocoError``    MuJoCo or a scene of it cannot be loaded
 ├── ``PlanError``      components that cannot be put in an order
 └── ``RunError``       a run that had to stop (component, tick, time)

Each derives from :class:`CosimError` and from the fitting builtin. A message says what was
found, what was expected and where.
"""

from __future__ import annotations

#: How Python says that the system does not let it start a thread.
NO_THREAD = "can't start new thread"
#: The text of the SystemError of a library that found no memory and did not say so.
NO_REASON = "error return without exception set"


class CosimError(Exception):
    """Base of all errors of this project."""

    exit_code = 2


class ScenarioError(CosimError, ValueError):
    """A scenario or an option is wrong; `place` is the file and the path inside it."""

    def __init__(self, message: str, place: str = "") -> None:
        super().__init__(f"{place}: {message}" if place else message)
        self.place = place


class UnitError(CosimError, ValueError):
    """A unit is unknown, or two units measure different things."""


class FmuError(CosimError, RuntimeError):
    """An FMU cannot be read, loaded, instantiated or initialised."""


class MujocoError(CosimError, RuntimeError):
    """MuJoCo is missing, or a scene of it cannot be read."""


class PlanError(CosimError, ValueError):
    """The components of a scenario cannot be ordered or wired."""


class RunError(CosimError, RuntimeError):
    """A run stopped: the message names component, tick and time.

    `saved` is the folder with everything recorded up to the stop, if there is one.
    """

    exit_code = 1

    def __init__(
        self, message: str, *, component: str = "", tick: int = -1, time: float = float("nan")
    ) -> None:
        super().__init__(message)
        self.component = component
        self.tick = tick
        self.time = time
        self.saved: str | None = None


class FolderWarning(UserWarning):
    """A warning of a reader about a run folder that it can read."""


class CutShort(FolderWarning):
    """The run did not come to its end; it is read as far as it goes."""


class Unverified(FolderWarning):
    """The folder has no sums of its files."""


class Interrupted(KeyboardInterrupt):
    """A run was interrupted (Ctrl-C) at `time` (s); its recorded data is in the folder `saved`."""

    def __init__(self, time: float, saved: str) -> None:
        super().__init__(f"interrupted at t = {time:.6g} s")
        self.time = time
        self.saved = saved


def shortage(error: BaseException) -> str:
    """The resource that the system lacks, as a sentence; "" for any other error.

    A lack of memory also appears as libraries that cannot be loaded, which some packages report as
    their own ImportError or without a reason, and as threads that cannot be started.
    """
    match error:
        case MemoryError():
            return "there is not enough memory for this"
        case OSError():
            return f"{error.filename or 'the system'}: {error.strerror or error}"
        case RuntimeError() if str(error) == NO_THREAD:
            return f"not enough memory, or too many threads: {error}"
        case SystemError() if str(error) == NO_REASON:
            return f"not enough memory, or a library that fails: {error}"
        case ImportError() if error.path and not error.path.endswith(".py"):
            return f"a library cannot be loaded: {error}"
        case ImportError() if error.__context__ is not None:
            return shortage(error.__context__)
    return ""
