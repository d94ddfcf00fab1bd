"""Keys and bytes, against a decoder written from docs/network.md only."""

import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bridge.deployment import zenoh_keys
from bridge.deployment.system import load_system
from bridge.native.message import Decoded, E2EProfile, Header
from bridge.zenoh.node_channel import traffic_of
from cosim.base.errors import ScenarioError

CONFIGS = Path(__file__).parents[3] / "configs"
KEY = "teleoperation/master/master_control/xi_master"


def reflected_table(polynomial: int) -> list[int]:
    table = []
    for byte in range(256):
        for _ in range(8):
            byte = byte >> 1 ^ (polynomial if byte & 1 else 0)
        table.append(byte)
    return table


TABLE = reflected_table(0xC8DF352F)  # 0xF4ACFB13 reflected


def crc(data: bytes) -> int:
    value = 0xFFFFFFFF
    for byte in data:
        value = value >> 8 ^ TABLE[(value ^ byte) & 0xFF]
    return value ^ 0xFFFFFFFF


def read(data: bytes, key: str) -> tuple[int, int, int, list[float]]:
    """Counter, status, time and values as another language would read them."""
    length, counter, identifier, check = struct.unpack(">HHII", data[:12])
    assert length == len(data) and identifier == zlib.crc32(key.encode())
    assert check == crc(data[:8] + data[12:])
    status, t_us = struct.unpack("<BxxxIxxxx", data[12:24])
    return counter, status, t_us, list(struct.unpack(f"<{(length - 24) // 8}d", data[24:]))


@given(
    values=st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=1, max_size=26),
    counter=st.integers(0, 0xFFFF),
    status=st.integers(0, 255),
    t_us=st.integers(0, 2**32 - 1),
)
def test_bytes_are_as_documented(values: list[float], counter: int, status: int, t_us: int):
    codec = zenoh_keys.codec(KEY, 0x1000, [f"v{i}" for i in range(len(values))])
    data = codec.encode(values, status, t_us, counter)
    found = read(data, KEY)
    assert found[:3] == (counter, status, t_us)
    assert np.array(found[3]).tobytes() == np.array(values).tobytes()


@given(place=st.integers(0, 39), bit=st.integers(0, 7))
def test_one_wrong_bit_is_noticed(place: int, bit: int):
    codec = zenoh_keys.codec(KEY, 0x1000, ["xi1", "xi2"])
    data = bytearray(codec.encode([1.0, -2.0], 3, 4, 5))
    data[place] ^= 1 << bit
    assert codec.decode(bytes(data))[0] is not Decoded.OK


def test_a_sample_on_the_key_of_another_is_noticed():
    ours, theirs = (zenoh_keys.codec(key, 0x1000, ["x"]) for key in (KEY, KEY + "2"))
    assert theirs.decode(ours.frame([1.0], Header()).payload)[0] is Decoded.CRC


def test_what_a_node_says_and_hears():
    system = load_system(CONFIGS / "teleoperation.toml", "zenoh")
    master = traffic_of(system, "net", "master")
    assert set(master.publishes) == {
        "teleoperation/master/master_control/xi_master",
        "teleoperation/master/heartbeat",
        "teleoperation/estop",
        "teleoperation/epoch",
    }
    assert set(master.hears) == {
        "teleoperation/slave/slave_control/xi_slave",
        "teleoperation/slave/heartbeat",
        "teleoperation/estop",
        "teleoperation/epoch",
        "teleoperation/nmt",
    }
    assert master.peers == ("slave",)
    assert master.heard_by_others == ("teleoperation/master/master_control/xi_master",)


def test_numbers_are_the_same_at_both_ends_of_every_key():
    system = load_system(CONFIGS / "network.toml", "network")
    ends = [traffic_of(system, "net", node) for node in system.nodes]
    found: dict[str, set[int]] = {}
    for end in ends:
        for key, number in {**end.publishes, **end.hears}.items():
            found.setdefault(key, set()).add(number)
    assert {len(numbers) for numbers in found.values()} == {1}
    streams = [key for key in found if key.count("/") == 3]
    assert len({n for key in streams for n in found[key]}) == len(streams) == 6


@pytest.mark.parametrize("deployment", ["mixed", "gateway"])
def test_on_a_network_services_are_protected_whatever_else_a_node_is_on(deployment: str):
    found = load_system(CONFIGS / "teleoperation.toml", deployment).services
    profiles = {name: e.message.e2e for name, e in found["net"].named().items()}
    assert set(profiles.values()) == {E2EProfile.P04}
    assert profiles.keys() == found["left"].named().keys() - {"SYNC"}


@pytest.mark.parametrize("prefix", ["a//b", "/a", "a/", "a*", "ä", "a b", "a?b"])
def test_what_is_no_key(prefix: str):
    with pytest.raises(ScenarioError, match=r"zenoh.toml at buses.net.prefix: .*part of a key"):
        load_system(
            CONFIGS / "teleoperation.toml", "zenoh", [f'deploy.buses.net.prefix="{prefix}"']
        )
