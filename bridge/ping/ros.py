"""Facts that samples of ROS 2 over rmw_zenoh carry, read without ROS.

Keys are ``DOMAIN/TOPIC/TYPE/HASH``. The attachment of a sample has the number of the publisher and
its time of publishing; messages with a std_msgs/Header begin with the stamp of their content.

Source: rmw_zenoh (design document and sources, releases up to July 2026): attachment of 33 bytes,
before 0.2.4 with text labels; OMG DDS-XTypes 7.4.3 for the encapsulation of CDR.
"""

from __future__ import annotations

import re
import struct
from typing import NamedTuple

_NEW = struct.Struct("<qq")
_LABEL = b"\x0fsequence_number"
_SECOND = b"\x10source_timestamp"
#: Types that begin with a Header.
_STAMPED = re.compile(
    r"/(geometry_msgs::msg::dds_::\w+Stamped_|sensor_msgs::msg::dds_::"
    r"(JointState|MultiDOFJointState|Imu|Image|CompressedImage|PointCloud2|LaserScan|Joy"
    r"|MagneticField|NavSatFix|Range|Temperature|FluidPressure|BatteryState)_"
    r"|nav_msgs::msg::dds_::(Odometry|Path|OccupancyGrid)_"
    r"|trajectory_msgs::msg::dds_::JointTrajectory_)/"
)


class RosAttachment(NamedTuple):
    """Number of a sample (by its publisher), and when it was published, ns since 1970."""

    sequence: int
    published_ns: int


def attachment(data: bytes) -> RosAttachment | None:
    """The content of an attachment; None if it is not one of rmw_zenoh."""
    if data.startswith(_LABEL):
        second = data.find(_SECOND)
        if second != len(_LABEL) + 8 or len(data) < second + len(_SECOND) + 8:
            return None
        number = struct.unpack_from("<q", data, len(_LABEL))[0]
        return RosAttachment(number, struct.unpack_from("<q", data, second + len(_SECOND))[0])
    if len(data) == 33 and data[16] == 16:
        return RosAttachment(*_NEW.unpack_from(data))
    return None


def header_stamp(key: str, payload: bytes) -> int | None:
    """The stamp of a message's content, ns, from its std_msgs/Header; None if there is none.

    0: the publisher did not fill it.
    """
    if not _STAMPED.search(key + "/") or len(payload) < 12 or payload[0] or payload[1] > 1:
        return None
    seconds, nanoseconds = struct.unpack_from("<iI" if payload[1] else ">iI", payload, 4)
    return int(seconds) * 1_000_000_000 + int(nanoseconds)
