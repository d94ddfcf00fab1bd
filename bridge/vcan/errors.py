"""Reasons that keep a command from getting a kernel with CAN."""

from __future__ import annotations

from cosim.base.errors import CosimError


class VcanError(CosimError, RuntimeError):
    """No kernel with CAN is available, or it did not start.

    The exit code is the one that ``env`` and ``timeout`` use for their own failures: those of
    the command stay apart.
    """

    exit_code = 125
