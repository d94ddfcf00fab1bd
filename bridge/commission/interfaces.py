"""CAN interfaces of the kernel: up, without errors, and with the bit timing of the deployment."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from bridge.deployment.spec import BusSpec, Deployment

State = Literal["good", "limited", "missing"]


@dataclass(frozen=True, slots=True)
class StepFinding:
    """A step that was checked: its name, its state, what was `found`, and what cures it."""

    name: str
    state: State
    found: str
    cure: str = ""


def check_interfaces(d: Deployment, buses: tuple[str, ...]) -> Iterator[StepFinding]:
    """A finding for each of these buses."""
    for name in buses:
        spec = d.buses[name]
        if spec.interface != "socketcan":
            text = f"not checked: {spec.interface} is no interface of the kernel"
            yield StepFinding(f"bus {name}", "limited", text, "use SocketCAN for real drives")
            continue
        yield interface_finding(name, spec, _link(spec.channel))


def _link(channel: str) -> Mapping[str, Any] | str:
    """``ip -details -json link`` of an interface; a text: why there is none."""
    words = ["ip", "-details", "-json", "link", "show", channel]
    try:
        done = subprocess.run(words, capture_output=True, text=True, timeout=10)
        found = json.loads(done.stdout) if done.returncode == 0 else []
    except (OSError, subprocess.SubprocessError, ValueError) as error:
        return str(error)
    return found[0] if found else done.stderr.strip() or "ip found nothing"


def interface_finding(name: str, spec: BusSpec, link: Mapping[str, Any] | str) -> StepFinding:
    """The finding on an interface, from what ``ip`` says of it. Bit rates: bit/s."""
    label, fd = f"bus {name}", spec.fd
    data = f" dbitrate {spec.data_bitrate} fd on" if fd else ""
    set_up = f"sudo ip link set {spec.channel} type can bitrate {spec.bitrate}{data} restart-ms 100"
    if isinstance(link, str):
        return StepFinding(label, "missing", f"{spec.channel}: {link}", set_up)
    if "UP" not in link.get("flags", ()):
        cure = f"sudo ip link set {spec.channel} up"
        return StepFinding(label, "missing", f"{spec.channel} is down", cure)
    info = link.get("linkinfo", {})
    kind, facts = info.get("info_kind", "?"), info.get("info_data", {})
    if kind == "vcan":
        good = not fd or int(link.get("mtu", 0)) >= 72
        text = f"{spec.channel} is up; not checked: a virtual bus has no bit timing"
        text += "" if good else "; not FD"
        return StepFinding(label, "limited" if good else "missing", text, set_up)
    wrong = list(_wrong(spec, facts))
    rate = facts.get("bittiming", {}).get("bitrate", "?")
    text = f"{spec.channel} is up, {rate} bit/s, {facts.get('state', '?')}"
    if wrong:
        cure = f"sudo ip link set {spec.channel} down; {set_up} up"
        return StepFinding(label, "missing", f"{text}; {'; '.join(wrong)}", cure)
    return StepFinding(label, "good", text)


def _wrong(spec: BusSpec, facts: Mapping[str, Any]) -> Iterator[str]:
    """Settings that differ from the deployment, or hurt."""
    rate = facts.get("bittiming", {}).get("bitrate")
    if rate != spec.bitrate:
        yield f"bit rate {rate}, expected {spec.bitrate}"
    modes = [str(mode).upper() for mode in facts.get("ctrlmode", ())]
    if spec.fd and "FD" not in modes:
        yield "classic CAN, expected CAN FD"
    if spec.fd and (found := facts.get("data_bittiming", {}).get("bitrate")) != spec.data_bitrate:
        yield f"data bit rate {found}, expected {spec.data_bitrate}"
    if odd := sorted({"LISTEN-ONLY", "LOOPBACK"} & set(modes)):
        yield f"in mode {', '.join(odd)}, expected neither"
    if (state := facts.get("state", "ERROR-ACTIVE")) != "ERROR-ACTIVE":
        yield f"state {state}, expected ERROR-ACTIVE: check wiring, termination and bit rate"
