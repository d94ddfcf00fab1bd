"""Two ends of a Zenoh bus on this machine."""

from itertools import count
from pathlib import Path

from bridge.deployment.zenoh_keys import Names
from bridge.native.journal import Journal
from bridge.zenoh.channel import ZenohAttachment, ZenohTraffic
from bridge.zenoh.options import ZenohOptions

NAMES = Names("test")
NUMBER = count()
#: Numbers of frames that go each way; more than the 16 of a burst.
IDENTIFIERS = range(0x100, 0x110)


def key(node: str, identifier: int) -> str:
    return NAMES.message(node, "component", f"m{identifier:x}")


def traffic(node: str, other: str) -> ZenohTraffic:
    return ZenohTraffic(
        node,
        {key(node, i): i for i in IDENTIFIERS},
        {key(other, i): i for i in IDENTIFIERS},
        (other,),
        tuple(key(node, i) for i in IDENTIFIERS),
        tuple(key(other, i) for i in IDENTIFIERS),
    )


def endpoint(tmp_path: Path) -> str:
    return f"unixsock-stream/{tmp_path}/{next(NUMBER)}.sock"


def opened(
    node: str, other: str, log: Journal | None = None, wait: float = 20.0, **said: object
) -> ZenohAttachment:
    options = ZenohOptions("test", wait=wait, **said)  # type: ignore[arg-type]
    return ZenohAttachment("net", NAMES, traffic(node, other), options, log=log)


def both(
    where: str, log: Journal | None = None, **said: object
) -> tuple[ZenohAttachment, ZenohAttachment]:
    first = opened("a", "b", log, listen=(where,), **said)
    second = opened("b", "a", connect=(where,), **said)
    first.wait_for_peers()
    second.wait_for_peers()
    return first, second
