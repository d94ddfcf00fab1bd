"""Fixtures of the tests of policies."""

from tests.cli.conftest import cosim as cosim
