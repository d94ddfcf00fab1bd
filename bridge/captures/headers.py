"""Stamps inside recorded messages: the ``std_msgs/Header`` of ROS, and JSON with time stamps.

A message has a header if the first field of its definition is one; only 8 to 12 bytes are read.

Source: OMG DDS-XTypes 7.4.3 for the encapsulation of CDR; ROS 1 wiki, "msg" for its serialization.
"""

from __future__ import annotations

import json
import re
import struct
from collections.abc import Callable
from functools import lru_cache
from typing import Any

from bridge.ping.exchanges import NONE

#: A function that returns the stamp of a message, ns since its clock's zero, NONE without one.
StampOf = Callable[[bytes], int]

#: First field of a definition (.msg, or .idl as its first member).
_FIELD = re.compile(r"^\s*(?:std_msgs(?:/|::)(?:msg(?:/|::))?)?Header\s+\w+\s*;?\s*$")
_SKIPPED = re.compile(
    r"^\s*(#.*|//.*|@.*|\{?|=+|MSG:.*|IDL:.*|module .*|struct .*|\w+\s+\w+\s*=.*)$"
)


def no_stamp(_data: bytes) -> int:
    """NONE, for messages that have no stamp."""
    return NONE


def begins_with_header(definition: str) -> bool:
    """True if the first field of a message definition (ROS 1 or 2, .msg or .idl) is a Header."""
    for line in definition.splitlines():
        if not _SKIPPED.match(line):
            return _FIELD.match(line) is not None
    return False


@lru_cache(maxsize=1024)
def known_header(name: str) -> bool:
    """True if a message type (``sensor_msgs/msg/JointState``) of ROS 2 begins with a Header.

    False for types that rosbags does not know.
    """
    from rosbags.typesys import Stores, get_typestore

    fields = get_typestore(Stores.LATEST).fielddefs.get(name)
    if fields is None or not fields[1]:
        return False
    return "std_msgs/msg/Header" in repr(fields[1][0])


def cdr_stamp(data: bytes) -> int:
    """The stamp of a message in CDR that begins with a Header."""
    if len(data) < 12 or data[0] or data[1] > 1:
        return NONE
    seconds, rest = struct.unpack_from("<iI" if data[1] else ">iI", data, 4)
    return int(seconds) * 1_000_000_000 + int(rest)


def ros1_stamp(data: bytes) -> int:
    """The stamp of a message of ROS 1 that begins with a Header."""
    if len(data) < 12:
        return NONE
    seconds, rest = struct.unpack_from("<II", data, 4)
    return int(seconds) * 1_000_000_000 + int(rest)


def json_stamp(data: bytes) -> int:
    """The stamp of a message in JSON: ``header.stamp``, ``timestamp`` or ``stamp``, an object."""
    try:
        message = json.loads(data)
    except ValueError:
        return NONE
    if not isinstance(message, dict):
        return NONE
    header = message.get("header")
    found = header.get("stamp") if isinstance(header, dict) else None
    return _object(found or message.get("timestamp") or message.get("stamp"))


def _object(found: Any) -> int:
    if not isinstance(found, dict):
        return NONE
    seconds = found.get("sec", found.get("secs"))
    rest = found.get("nsec", found.get("nanosec", found.get("nsecs")))
    if not isinstance(seconds, int) or not isinstance(rest, int):
        return NONE
    return seconds * 1_000_000_000 + rest


def reader_of(encoding: str, definition: str, type_name: str) -> StampOf:
    """The function that reads the stamps of messages of an `encoding` (cdr, ros1, json)."""
    if encoding == "json":
        return json_stamp
    if encoding not in ("cdr", "ros1"):
        return no_stamp
    if not (begins_with_header(definition) if definition else known_header(type_name)):
        return no_stamp
    return cdr_stamp if encoding == "cdr" else ros1_stamp
