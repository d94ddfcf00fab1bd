"""Fixtures of the tests of scenes."""

from tests.cli.conftest import cosim as cosim
