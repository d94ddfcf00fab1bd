"""A listener behind a router, with a certificate, and next to CAN."""

from __future__ import annotations

from pathlib import Path

import typer
from typer.testing import CliRunner

from bridge.can.interface import attach
from bridge.cli.paths.ping import ping
from bridge.cli.tell import tell
from bridge.deployment.zenoh_keys import names_of
from bridge.monitor.listener import Listener
from bridge.monitor.listener_view import view
from bridge.native.frame import Frame
from bridge.native.safety import LifeState
from bridge.node.buses import can_spec
from bridge.ping.measure import PingResponder
from bridge.ping.zenoh import node_responder, pinged_nodes
from bridge.zenoh.certificates import make_keys
from bridge.zenoh.node_channel import open_bus
from bridge.zenoh.options import ZenohOptions, options_of
from bridge.zenoh.session import configure, open_session
from cosim.base.clock import monotonic_ns, sleep
from cosim.base.copies import replace
from cosim.cli.options import flat
from tests.bridge.listening import ARMS, beat, encoded, followed, loaded, reached
from tests.bridge.ping.test_paths import answering
from tests.bridge.zenoh.rehearsed import CONFIGS, sockets
from tests.bridge.zenoh.test_channel import free_ports, until


def test_through_a_router(tmp_path: Path):
    (port,) = free_ports(1)
    where = f"tcp/127.0.0.1:{port}"
    client = CONFIGS / "zenoh" / "client.json5"
    settings = [
        f'deploy.buses.net.zenoh="{client}"',
        f'deploy.buses.net.options.connect="{where}"',
        *(f"deploy.buses.net.options.listen.{arm}=[]" for arm in ARMS),
    ]
    system = loaded(*settings)
    with Listener(system) as listener:  # comes first
        assert f"nobody connected; tries {where}" in "\n".join(
            text for text, _ in view(listener, monotonic_ns()).lines()
        )
        config = CONFIGS / "zenoh" / "router.json5"
        router = open_session(
            configure(ZenohOptions("router", (where,), config=config), "router"), "router"
        )
        master = open_bus(system, "net", "master")
        followed(listener, master, system)
        assert listener.there("master") and "1 connected" in listener.nets["net"].note
        master.close()
        reached(listener, lambda: listener.there("master") is False)
        router.close()


def secured(folder: Path) -> list[str]:
    """Settings: certificates in a folder, and the rules that go with them."""
    make_keys(folder, [*ARMS, "monitor", "operator"])
    ports = free_ports(2)
    return [
        f'deploy.buses.net.zenoh="{CONFIGS / "zenoh" / "secure.json5"}"',
        f'deploy.buses.net.options.keys="{folder}"',
        *(
            f'deploy.buses.net.options.listen.{arm}="tls/127.0.0.1:{port}"'
            for arm, port in zip(ARMS, ports, strict=True)
        ),
    ]


def test_by_a_certificate_that_may_hear_and_not_speak(tmp_path: Path):
    system = loaded(*secured(tmp_path))
    master, slave = (open_bus(system, "net", arm) for arm in ARMS)
    master.wait_for_peers()
    with Listener(system) as listener:
        followed(listener, master, system)
        assert listener.there("slave")
    options = replace(options_of(system.deployment, "net", "monitor"), listen=())
    config = configure(options, "monitor")
    config.insert_json5("access_control", '{"enabled": false}')  # it tries everything
    session = open_session(config, "net")
    until(lambda: slave.session.info.zid() in session.info.peers_zid())
    names = names_of(system.deployment, "net")
    number = system.messages["xi_master"].encoding.message.id
    slave.bus.drain()
    for _ in range(20):
        session.put(names.message("master", "master_control", "xi_master"), b"forged")
        session.put(names.shared("nmt"), b"forged")
        session.put(names.shared("estop"), b"forged")
        sleep(0.005)
    token = session.liveliness().declare_token(names.of("third", "alive"))
    assert list(session.get(names.of("master", "stop"), timeout=0.3)) == []
    master.bus.send(Frame.of(number, b"true"))
    came: list[Frame] = []

    def arrived() -> bool:
        came.extend(slave.bus.drain())
        return bool(came)

    until(arrived)
    assert {f.payload for f in came} == {b"true"} and token is not None
    assert slave.presence.there == {"master"}
    for closed in (session, master, slave):
        closed.close()


def test_an_operator_and_pings_with_certificates(tmp_path: Path):
    app, settings = typer.Typer(), secured(tmp_path)
    app.command()(tell)
    app.command()(flat(ping))
    said = ["--deploy", "zenoh", *(x for text in settings for x in ("--set", text))]
    scenario = str(CONFIGS / "teleoperation.toml")

    def call(*arguments: str) -> str:
        done = CliRunner().invoke(app, [*arguments, *said], catch_exceptions=False)
        assert done.exit_code == 0, done.output
        return done.output

    system = loaded(*settings)
    out = ("--rate", "100", "--duration", "0.1", "--ramp", "--json", "-")
    with node_responder(pinged_nodes(system)) as far, answering(PingResponder(far)):
        assert "steps" in call("ping", scenario, *out)
    master, slave = (open_bus(system, "net", arm) for arm in ARMS)
    nmt = system.services["net"].nmt
    assert nmt is not None
    call("tell", scenario, "arm")
    until(lambda: nmt.message.id in [f.id for f in master.bus.drain()])
    for end in (master, slave):
        end.close()


def test_can_and_zenoh_beside_each_other(tmp_path: Path, request):
    nodes = ("master_control", "slave_control")
    name = request.node.name
    settings = [
        f'deploy.buses.{bus}.{key}="{value}"'
        for bus in ("left", "right")
        for key, value in (("interface", "virtual"), ("channel", f"{name} {bus}"))
    ]
    system = loaded(*settings, *sockets(nodes, tmp_path), deployment="mixed")
    arm = attach(can_spec(system.deployment, "left"))
    other = attach(can_spec(system.deployment, "right"))
    control = open_bus(system, "net", "master_control")
    state, xi = system.messages["STATE_1"], system.messages["xi_master"]
    far = system.messages["STATE_3"]
    with Listener(system) as listener:

        def say() -> None:
            arm.bus.send(encoded(state.encoding, [1.0, 2.0, 0.0, 0.0], 0, LifeState.ACTIVE))
            other.bus.send(encoded(far.encoding, [1.0, 1.5, 0.0, 0.0], 0, LifeState.ACTIVE))
            control.bus.send(beat(system, "master_control", LifeState.ACTIVE))
            control.bus.send(encoded(xi.encoding, [5.0, 6.0], 0, LifeState.ACTIVE))

        heard = [listener.heard[m] for m in ("STATE_1", "STATE_3", "xi_master")]
        reached(listener, lambda: all(h.t_ns > 0 for h in heard), say)
        assert heard[2].values.tolist() == [5.0, 6.0]
        shown = "\n".join(text for text, _ in view(listener, monotonic_ns()).lines())
        assert "listening on left, right, net" in shown
        sync = next(text for text in shown.splitlines() if "sync error" in text)
        assert abs(float(sync.split()[-2]) - 0.5) < 1e-3
        assert "others" in shown and "master.tau_h" in shown  # on no bus
    with Listener(system, only=["net"]) as listener:
        assert [*listener.ears] == ["net"] and [*listener.heard] == ["xi_master", "xi_slave"]
    for end in (arm, other, control):
        end.close()
