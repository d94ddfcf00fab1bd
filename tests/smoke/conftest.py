"""The command as a fixture."""

from tests.cli.conftest import cosim

__all__ = ["cosim"]
