"""The commands, one module each; :mod:`cosim.cli.commands` puts them together."""

import errno
import gc
import os
import sys

#: New objects between two collections of garbage. Nearly all that an import makes stays, so that
#: Python's 700 let a command search the same objects for garbage dozens of times.
_COLLECTED = 200_000


def main() -> None:
    """Entry point of the console script. All but the overview are supervised: nearly all load FMUs.

    NumPy's linear algebra (OpenBLAS) uses one thread unless the environment sets another number.
    The matrices are small here, and a second thread polls from the import of NumPy on, which takes
    0.1 s of processor time per command and disturbs nodes on the wall clock.
    """
    if sys.argv[1:] in ([], ["-h"], ["--help"]):
        from cosim.cli.overview import overview

        sys.exit(_written(overview()) or (0 if sys.argv[1:] else 2))
    gc.set_threshold(_COLLECTED)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from cosim.base.streams import open_standard_streams
    from cosim.cli.supervise import end, supervised

    open_standard_streams()
    end(supervised(_command))


def _written(text: str) -> int:
    """Write to standard output; the exit code. A closed one is not missed."""
    try:
        os.write(1, text.encode())
    except OSError as error:
        from cosim.base.streams import report

        error.filename = "standard output"
        return 0 if error.errno == errno.EBADF else report(error)
    return 0


def _command() -> None:
    from cosim.cli.commands import command

    command()
