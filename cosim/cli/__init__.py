"""The commands, a module each; :mod:`cosim.cli.commands` puts them together."""

import sys


def main() -> None:
    """Entry point of the console script: nearly every command loads FMUs, so all are supervised."""
    from cosim.cli.supervise import supervised

    sys.exit(supervised(_command))


def _command() -> None:
    from cosim.cli.commands import command

    command()
