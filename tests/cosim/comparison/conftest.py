from tests.cli.conftest import cosim

__all__ = ["cosim"]
