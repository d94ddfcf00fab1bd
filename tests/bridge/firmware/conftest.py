"""Images of a controller, built once."""

from __future__ import annotations

import shutil

import pytest

from tests.bridge.export.test_firmware import built
from tests.bridge.firmware.running import NODE, system_of


@pytest.fixture(scope="session")
def native(tmp_path_factory):
    """The controller of the master for this machine."""
    if shutil.which("make") is None:
        pytest.skip("no make")
    return built(system_of(), NODE, tmp_path_factory.mktemp("native"))


@pytest.fixture(scope="session")
def cortex_m4(tmp_path_factory):
    """The same for a Cortex-M4."""
    if shutil.which("qemu-system-arm") is None or shutil.which("arm-none-eabi-gcc") is None:
        pytest.skip("no QEMU for ARM, or no compiler")
    return built(system_of(), NODE, tmp_path_factory.mktemp("cortex-m4"), "cortex-m4")
