"""Writes the link files next to it: ``python configs/can/generate.py``.

The .dbc files are what counts and what is shipped; this only spares writing the same message for
eight nodes. What the bytes mean is in docs/can.md.
"""

from __future__ import annotations

from pathlib import Path

from bridge.can.link_dbc import classic, common, fd, servo, text


def files() -> dict[str, str]:
    """Name -> contents."""
    seven = {"_A": (1, 2, 3), "_B": (4, 5, 6), "_C": (7,)}
    return {
        "link.dbc": text(
            common() + classic(seven, False), "CAN", "Classic CAN, arms of up to seven joints."
        ),
        "link2.dbc": text(
            common() + classic({"": (1, 2)}, True), "CAN", "Classic CAN, arms of two joints."
        ),
        "link_fd.dbc": text(common() + fd(7), "CAN FD", "CAN FD, arms of up to seven joints."),
        "link_fd2.dbc": text(common() + fd(2), "CAN FD", "CAN FD, arms of two joints."),
        "servo_fd6.dbc": text(
            common() + fd(6) + servo(6),
            "CAN FD",
            "CAN FD, arms of six joints that take positions or velocities.",
        ),
    }


if __name__ == "__main__":
    for name, contents in files().items():
        Path(__file__).with_name(name).write_text(contents, encoding="ascii")
