"""The commands, one module each; :mod:`cosim.cli.commands` puts them together."""

import gc
import os
import sys

#: New objects between two collections of garbage. Nearly all that an import makes stays, so that
#: Python's 700 let a command search the same objects for garbage dozens of times.
_COLLECTED = 50_000


def main() -> None:
    """Entry point of the console script: nearly every command loads FMUs, so all are supervised.

    NumPy's linear algebra (OpenBLAS) uses one thread unless the environment says otherwise. Its
    matrices are small here, and a second thread waits busily from the import of NumPy on, which
    costs a command 0.1 s of processor time and disturbs nodes on the wall clock.
    """
    gc.set_threshold(_COLLECTED)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from cosim.cli.supervise import supervised

    sys.exit(supervised(_command))


def _command() -> None:
    from cosim.cli.commands import command

    command()
