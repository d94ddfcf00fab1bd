"""The commands, a module each; :mod:`cosim.cli.commands` puts them together."""


def main() -> None:
    """Entry point of the console script."""
    from cosim.cli.commands import main as start

    start()
