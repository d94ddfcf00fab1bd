"""Stamps inside messages: CDR of either order, ROS 1, JSON, and which definitions have a header."""

import json
import struct

import pytest
from rosbags.typesys import Stores, get_typestore

from bridge.captures.headers import begins_with_header, known_header, reader_of
from bridge.ping.exchanges import NONE

SECONDS, REST = 1_790_000_000, 123_456_789
STAMP = SECONDS * 10**9 + REST
HEADER = "std_msgs/Header header\n"


@pytest.mark.parametrize(
    ("encoding", "data"),
    [
        ("cdr", b"\0\1\0\0" + struct.pack("<iI", SECONDS, REST)),
        ("cdr", b"\0\0\0\0" + struct.pack(">iI", SECONDS, REST)),
        ("ros1", struct.pack("<III", 7, SECONDS, REST) + b"\0\0\0\0"),
        ("json", json.dumps({"header": {"stamp": {"sec": SECONDS, "nanosec": REST}}}).encode()),
        ("json", json.dumps({"timestamp": {"sec": SECONDS, "nsec": REST}, "x": 1}).encode()),
    ],
)
def test_the_stamp_is_read(encoding: str, data: bytes) -> None:
    assert reader_of(encoding, HEADER, "")(data) == STAMP


@pytest.mark.parametrize(
    ("encoding", "data"),
    [
        ("cdr", b"\0\1\0\0\1\2\3"),
        ("cdr", b"\0\7\0\0" + bytes(8)),
        ("ros1", b"\1"),
        ("json", b"{"),
        ("json", b"[1]"),
        ("json", b'{"timestamp": 3}'),
        ("json", b'{"header": {"stamp": {"sec": 1.5, "nanosec": 2}}}'),
        ("protobuf", bytes(20)),
    ],
)
def test_what_has_no_stamp_has_none(encoding: str, data: bytes) -> None:
    assert reader_of(encoding, HEADER, "")(data) == NONE


@pytest.mark.parametrize(
    ("definition", "found"),
    [
        ("Header header\nfloat64 x\n", True),
        ("# of a joint\n\nint32 MODE=3\nstd_msgs/msg/Header header  \n", True),
        ("float64 x\nstd_msgs/Header header\n", False),
        ("string data\n", False),
        ("", False),
        ("module m {\n  struct S {\n    std_msgs::msg::Header header;\n", True),
        ("my_msgs/Header header\n", False),
    ],
)
def test_definitions_that_begin_with_a_header(definition: str, found: bool) -> None:
    assert begins_with_header(definition) is found


def test_every_standard_type_is_known_by_name_and_by_definition() -> None:
    types = get_typestore(Stores.LATEST)
    names = [n for n in types.fielddefs if "/msg/" in n and types.fielddefs[n][1]]
    assert len(names) > 100
    for name in names:
        definition = types.generate_msgdef(name, ros_version=2)[0].partition("=" * 80)[0]
        assert begins_with_header(definition) is known_header(name), name
    assert not known_header("my_msgs/msg/Other")
