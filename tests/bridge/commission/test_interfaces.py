"""Interfaces of the kernel, by what ``ip -details -json link`` says of them."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from bridge.commission.interfaces import interface_finding
from bridge.deployment.spec import BusSpec

BUS = BusSpec(
    interface="socketcan", channel="can0", bitrate=1_000_000, data_bitrate=5_000_000, fd=True
)


def link(**changes: Any) -> dict[str, Any]:
    """As iproute2 prints a CAN FD interface that is up."""
    data = {
        "state": "ERROR-ACTIVE", "ctrlmode": ["FD"], "restart_ms": 100,
        "bittiming": {"bitrate": 1_000_000, "sample_point": "0.750"},
        "data_bittiming": {"bitrate": 5_000_000, "sample_point": "0.750"},
    } | changes  # fmt: skip
    return {
        "ifname": "can0", "flags": ["NOARP", "UP", "LOWER_UP", "ECHO"], "mtu": 72,
        "linkinfo": {"info_kind": "can", "info_data": data},
    }  # fmt: skip


def test_an_interface_with_the_timing_of_the_deployment() -> None:
    found = interface_finding("left", BUS, link())
    assert found.state == "good" and found.cure == ""


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"bittiming": {"bitrate": 500_000}}, "bit rate 500000, expected 1000000"),
        ({"data_bittiming": {"bitrate": 2_000_000}}, "data bit rate 2000000, expected 5000000"),
        ({"ctrlmode": []}, "classic CAN, expected CAN FD"),
        ({"ctrlmode": ["FD", "LISTEN-ONLY"]}, "in mode LISTEN-ONLY"),
        ({"state": "BUS-OFF"}, "state BUS-OFF, expected ERROR-ACTIVE"),
    ],
)
def test_what_differs_is_missing_with_the_command_that_cures_it(
    changes: dict[str, Any], text: str
) -> None:
    found = interface_finding("left", BUS, link(**changes))
    assert found.state == "missing" and text in found.found
    assert "bitrate 1000000 dbitrate 5000000 fd on" in found.cure


def test_an_interface_that_is_down_or_not_there() -> None:
    down = link() | {"flags": ["NOARP", "ECHO"]}
    assert "can0 is down" in interface_finding("left", BUS, down).found
    gone = interface_finding("left", BUS, 'Device "can0" does not exist.')
    assert gone.state == "missing" and "does not exist" in gone.found


@pytest.mark.parametrize(("mtu", "state"), [(72, "limited"), (16, "missing")])
def test_a_virtual_bus_has_no_timing(mtu: int, state: str) -> None:
    virtual = {"flags": ["UP"], "mtu": mtu, "linkinfo": {"info_kind": "vcan"}}
    assert interface_finding("left", BUS, virtual).state == state
    classic = msgspec.structs.replace(BUS, fd=False)
    assert interface_finding("left", classic, virtual).state == "limited"
