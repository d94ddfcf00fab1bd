"""Wrong options of a simulated channel: found, expected, where."""

from __future__ import annotations

import tomllib
from importlib import import_module
from pathlib import Path
from typing import Any

import can
import pytest

from bridge.simulated_can.bus import CosimBus
from tests.bridge.simulated_can.benches import Bench, bench, message

__all__ = ["bench"]

CLASSIC = can.BitTiming.from_sample_point(8_000_000, 500_000, 87.5)
FLEXIBLE = can.BitTimingFd.from_sample_point(80_000_000, 500_000, 80, 2_000_000, 80)


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"bitrate": None}, "found no bitrate, expected one"),
        ({"bitrate": "fast"}, "found bitrate='fast', expected a number"),
        ({"bitrate": 0}, "found a bit rate of 0.0 bit/s"),
        ({"data_bitrate": 2e6}, "found data_bitrate=2e\\+06 on a classic bus, expected fd=True"),
        ({"timing": CLASSIC, "fd": True}, "found fd=True with the timing of a classic bus"),
        ({"timing": FLEXIBLE, "fd": False}, "found fd=False with the timing of a CAN FD bus"),
        ({"speed": "quick"}, "found speed='quick', expected a number above 0 or \"simulated\""),
        ({"speed": 0}, "found speed=0, expected"),
        ({"error_rate": 1.5}, "found error_rate=1.5, expected 0 to less than 1"),
        ({"queue": "stack"}, "found queue='stack', expected one of fifo, sorted, mailboxes"),
        ({"tx_queue_size": 0}, "found tx_queue_size=0, expected 1 to 65535 frames"),
        ({"bit_rate": 5}, "found the option 'bit_rate', expected 'bitrate'"),
    ],
    ids=str,
)
def test_an_option_that_cannot_be_is_named(
    bench: Bench, options: dict[str, Any], text: str
) -> None:
    with pytest.raises(can.CanInitializationError, match=text):
        bench.bus(**options)
    assert bench.name not in [c["channel"] for c in CosimBus._detect_available_configs()]


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"bitrate": 250_000}, "found bitrate=250000 bit/s, expected 500000 bit/s"),
        ({"fd": True}, "found fd=True, expected False"),
        ({"speed": 1}, "found speed=1, expected simulated"),
        ({"error_rate": 0.1}, "found error_rate=0.1, expected 0"),
    ],
    ids=str,
)
def test_buses_of_one_channel_agree(bench: Bench, options: dict[str, Any], text: str) -> None:
    bench.bus(bitrate=500_000)
    with pytest.raises(can.CanInitializationError, match=f"{bench.name}.*{text}"):
        bench.bus(**{"bitrate": 500_000, **options})
    bench.bus(bitrate=None, speed=None)


def test_options_of_other_interfaces_are_ignored(bench: Bench) -> None:
    bench.bus(single_handle=True, app_name="test")


def test_a_timing_is_as_good_as_bit_rates(bench: Bench) -> None:
    bench.bus(bitrate=None, timing=FLEXIBLE)
    assert "500000 bit/s, data 2e+06 bit/s" in str(bench.bus(bitrate=500_000, fd=True))


@pytest.mark.parametrize(
    ("sent", "text"),
    [
        (message(1, is_fd=True), "found a CAN FD message on a classic bus"),
        (message(1, is_error_frame=True), "found an error frame to send"),
        (message(0x800, check=False), "found identifier 0x800, expected 11 bits"),
        (message(1, bytes(9), check=False), "found 9 bytes of data"),
    ],
    ids=str,
)
def test_a_message_that_is_no_frame_of_the_bus_is_refused(
    bench: Bench, sent: can.Message, text: str
) -> None:
    bus = bench.bus()
    with pytest.raises(can.CanOperationError, match=text):
        bus.send(sent)


def test_the_entry_point_names_the_class() -> None:
    root = Path(__file__).parents[3]
    project = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    module, _, name = project["entry-points"]["can.interface"]["cosim"].partition(":")
    assert getattr(import_module(module), name) is CosimBus
