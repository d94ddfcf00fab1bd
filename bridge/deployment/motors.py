"""Motors of an arm in a deployment: one table in place of a message for each motor and direction.

The table ``[motors.NAME]`` becomes the messages ``NAME_KIND_JOINT`` before anything else is read,
joints from 1: entry i of every port of ``messages.KIND.carries`` travels in the message of joint
i + 1. Keys of ``[messages.NAME_KIND_JOINT]`` in the file come before those of the table.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import msgspec

from cosim.base.convert import Number, convert_each
from cosim.base.errors import ScenarioError


class MotorsSpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The motors of one arm on one bus, joint by joint.

    `drives`: node numbers of the drives. `profile`: of the drives, relative to the deployment;
    `gear`, `direction`, `zero`, `fd`: as in a message. Each of the five is one for all joints or an
    array with an entry for each. `messages`: by a name, `carries` with whole
    ports (``component.port``) and other keys of messages.
    """

    bus: str
    drives: tuple[int, ...]
    profile: str | tuple[str, ...]
    gear: float | tuple[float, ...] = 1.0
    direction: Literal[1, -1] | tuple[Literal[1, -1], ...] = 1
    zero: Number | tuple[Number, ...] = 0.0
    fd: bool | tuple[bool, ...] | None = None
    messages: dict[str, dict[str, Any]]


_EACH = ("profile", "gear", "direction", "zero", "fd")


def expand(document: dict[str, Any], path: Path) -> None:
    """Replace the tables ``[motors.NAME]`` of a parsed deployment by messages, in place.

    Raises ScenarioError for tables that are not as described, with their place.
    """
    found = document.pop("motors", {})
    if not isinstance(found, dict):
        raise ScenarioError("motors is no table, expected [motors.NAME]", str(path))
    messages: dict[str, Any] = {}
    for name, motors in convert_each(found, MotorsSpec, path, "motors").items():
        place = f"{path} at motors.{name}"
        for joint in range(len(motors.drives)):
            for kind, keys in motors.messages.items():
                messages[f"{name}_{kind}_{joint + 1}"] = _message(motors, keys, joint, place)
    own = document.get("messages", {})
    if not isinstance(own, dict):
        return  # the reader of messages says so
    for name, keys in own.items():
        messages[name] = messages[name] | keys if name in messages else keys
    if messages:
        document["messages"] = messages


def _message(motors: MotorsSpec, keys: dict[str, Any], joint: int, place: str) -> dict[str, Any]:
    """The keys of one joint's message."""
    carries = keys.get("carries", ())
    if not isinstance(carries, list) or not carries:
        text = f"carries is {carries!r}, expected an array of ports, component.port"
        raise ScenarioError(text, f"{place}.messages")
    own = {"bus": motors.bus, "drive": motors.drives[joint]}
    for key in _EACH:
        value = _entry(getattr(motors, key), joint, len(motors.drives), f"{place}.{key}")
        own |= {} if value is None else {key: value}
    return {**own, **keys, "joint": joint, "carries": [f"{port}[{joint}]" for port in carries]}


def _entry(value: Any, joint: int, joints: int, place: str) -> Any:
    """The value of a joint. Raises ScenarioError for an array of another length."""
    if not isinstance(value, tuple):
        return value
    if len(value) != joints:
        raise ScenarioError(f"has {len(value)} entries, expected {joints}, as drives has", place)
    return value[joint]
