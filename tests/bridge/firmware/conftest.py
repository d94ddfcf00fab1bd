"""Images of a controller, built once."""

from __future__ import annotations

import pytest

from bridge.export.firmware import firmware
from tests.bridge.export.test_firmware import built, needs
from tests.bridge.firmware.running import NODE, system_of


def image_for(target, factory):
    made = firmware(system_of(), NODE, target)
    return built(made, factory.mktemp(target), target)


@pytest.fixture(scope="session")
def native(tmp_path_factory):
    """The controller of the master for this machine."""
    needs("native")
    return image_for("native", tmp_path_factory)


@pytest.fixture(scope="session")
def cortex_m4(tmp_path_factory):
    """The same for a Cortex-M4."""
    needs("cortex-m4")
    return image_for("cortex-m4", tmp_path_factory)
