"""``cosim doctor``: what it looks at on this machine, and what it says of what is not there."""

from __future__ import annotations

import json
import os
import platform
import socket
from pathlib import Path

import pytest

from bridge.cli import doctor
from bridge.vcan import capabilities
from cosim.base.errors import FmuError
from tests.cli.command import Command


def test_it_looks_at_everything_and_cures_what_it_can(cosim: Command) -> None:
    done = cosim("doctor", "--json", "-")
    assert done.code == 0, done.out
    found = json.loads(done.out)
    assert found["schema"] == "cosim.doctor/1"
    state = {c["name"]: c["state"] for c in found["checks"]}
    assert (state["Python"], state["engine"], state["disk"]) == ("good", "good", "good")
    assert len(state) == 14
    for c in found["checks"]:
        assert c["found"] and c["purpose"] and (c["cure"] or c["state"] == "good"), c
    named = {c["name"]: c for c in found["checks"]}
    assert "tick" in named["engine"]["found"] and "GiB free" in named["disk"]["found"]


def test_what_a_run_needs_and_is_missing_ends_with_1(
    cosim: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    from cosim.engine import engine

    def broken(*_: object) -> None:
        raise FmuError("the library is cut short")

    monkeypatch.setattr(engine, "Engine", broken)
    monkeypatch.setattr(doctor, "_wakeups", doctor._governor)
    done = cosim("doctor")
    assert done.code == 1
    (line,) = [line for line in done.out.splitlines() if line.startswith("✗")]
    assert "the library is cut short" in line and "cure: reinstall" in done.out


def test_a_port_in_use_is_named() -> None:
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        s.listen()
        port = s.getsockname()[1]
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(doctor, "ZENOH", port)
            found = doctor._zenoh_port()
    assert found.state == "limited" and "in use" in found.found and str(port) in found.cure


@pytest.mark.parametrize(
    ("system", "machine", "state", "found"),
    [("Linux", "x86_64", "good", "Linux x86_64: offline runs, rehearsals and hardware"),
     ("Linux", "aarch64", "good", "Linux aarch64: offline runs; rehearsals and hardware have not"),
     ("Darwin", "arm64", "limited", "macOS arm64: offline runs only"),
     ("Windows", "AMD64", "limited", "Windows AMD64: offline runs only")],
)  # fmt: skip
def test_the_system_says_what_works_there(
    monkeypatch: pytest.MonkeyPatch, system: str, machine: str, state: str, found: str
) -> None:
    monkeypatch.setattr(platform, "system", lambda: system)
    monkeypatch.setattr(platform, "machine", lambda: machine)
    made = doctor._system()
    assert made.state == state and made.found.startswith(found)
    assert ("Linux" in made.cure) == (state == "limited")


def test_missing_extras_are_named_with_the_command(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "EXTRAS", {"no-such-package": ("nothing", "nothing at all")})
    found = doctor._extras()
    assert (found.state, found.cure) == ("limited", "pip install 'cosim-bridge[nothing]'")


def test_a_folder_that_cannot_be_written(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    assert doctor._disk().state == "missing"
    monkeypatch.undo()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(doctor, "SPACE", 2**60)
    assert doctor._disk().state == "limited"


@pytest.mark.parametrize(
    ("own", "guest", "state", "cure"),
    [(True, False, "good", ""), (False, True, "limited", "bridge.vcan run"),
     (False, False, "limited", "modprobe vcan")],
)  # fmt: skip
def test_can_in_this_kernel_or_in_a_guest(
    monkeypatch: pytest.MonkeyPatch, own: bool, guest: bool, state: str, cure: str
) -> None:
    ability = capabilities.Ability
    monkeypatch.setattr(capabilities, "host", lambda: ability("host", own, "because"))
    monkeypatch.setattr(capabilities, "uml", lambda: ability("uml", guest, "because"))
    found = doctor._can()
    assert found.state == state and cure in found.cure
