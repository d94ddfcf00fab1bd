"""Errors in a configuration are reported before a session opens."""

import json
import sys
from pathlib import Path

import pytest

from bridge.deployment import spec
from bridge.zenoh.options import ZenohOptions, check_endpoint, is_loopback, options_of
from bridge.zenoh.session import configure, open_session
from cosim.base.errors import ScenarioError
from tests.footprint import open_files

CONFIGS = Path(__file__).parents[3] / "configs"


def options(*settings: str, node: str = "slave"):
    found = spec.load(CONFIGS / "deploy" / "zenoh.toml", settings)
    return options_of(found, "net", node)


def test_a_node_listens_where_it_is_said_and_connects_to_those_before_it():
    master, slave = options(node="master"), options(node="slave")
    assert (master.listen, master.connect) == (("tcp/127.0.0.1:7461",), ())
    assert (slave.listen, slave.connect) == (("tcp/127.0.0.1:7462",), ("tcp/127.0.0.1:7461",))


def test_where_to_connect_may_be_said():
    router = 'buses.net.options.connect="tcp/127.0.0.1:7447"'
    assert options(router, node="master").connect == ("tcp/127.0.0.1:7447",)
    by_node = 'buses.net.options.connect={master = ["tcp/127.0.0.1:1", "tcp/127.0.0.1:2"]}'
    assert options(by_node, node="master").connect == ("tcp/127.0.0.1:1", "tcp/127.0.0.1:2")
    assert options(by_node).connect == ()


@pytest.mark.parametrize(
    ("said", "why"),
    [
        ("lissen={}", "unknown key 'lissen'"),
        ("listen=[]", r"options.listen: \[\]; expected endpoints by node"),
        ('listen={pilot="tcp/127.0.0.1:1"}', r"options.listen: no node 'pilot'; there are"),
        ("listen={slave=7}", r"options.listen.slave: 7; expected an endpoint"),
        ('listen={slave="tpc/127.0.0.1:1"}', "unknown protocol 'tpc'; expected PROTOCOL/ADDRESS"),
        ('listen={slave="127.0.0.1:1"}', "unknown protocol"),
        ('listen={slave="tcp/127.0.0.1"}', "expected HOST:PORT"),
        ('listen={slave="tcp/127.0.0.1:99999"}', "expected HOST:PORT"),
        ('listen={slave="unixsock-stream/"}', "has no path"),
        (
            'listen={slave="tcp/0.0.0.0:7461"}',
            "is reachable from other machines without encryption",
        ),
        ('listen={slave="tcp/[::]:7461"}', "is reachable from other machines without encryption"),
        ('connect="tcp/192.0.2.1:7461"', "is reachable from other machines without encryption"),
        ('reliability="some"', "options.reliability: 'some'; expected best-effort or reliable"),
        ('wait="long"', r"options.wait"),
        ("insecure=1", "options.insecure: 1; expected true or false"),
        ("keys=1", "options.keys: 1; expected a text"),
    ],
)
def test_wrong_options_are_named(said: str, why: str):
    with pytest.raises(ScenarioError, match=why):
        options(f"buses.net.options.{said}")


def test_insecure_has_to_be_said():
    said = 'buses.net.options.listen={slave="tcp/0.0.0.0:7461"}'
    assert options(said, "buses.net.options.insecure=true").listen == ("tcp/0.0.0.0:7461",)
    for endpoint in ("tls/0.0.0.0:1", "quic/192.0.2.1:1", "unixsock-stream//run/x.sock"):
        check_endpoint(endpoint, "here", insecure=False)


def test_loopback():
    assert [h for h in ("127.0.0.1", "127.9.9.9", "[::1]", "localhost") if not is_loopback(h)] == []
    assert not any(map(is_loopback, ("0.0.0.0", "[::]", "192.0.2.1", "example", "")))


def get(config, key: str):
    return json.loads(config.get_json(key))


def test_defaults_are_quiet():
    config = configure(options(), "slave")
    assert get(config, "listen/endpoints") == ["tcp/127.0.0.1:7462"]
    assert get(config, "scouting/multicast/enabled") is False
    assert get(config, "scouting/gossip/enabled") is False
    assert get(config, "transport/link/tx/lease") == 3000


def test_without_endpoints_nothing_listens():
    config = configure(options("buses.net.options={}"), "slave")
    assert (get(config, "listen/endpoints"), get(config, "connect/endpoints")) == ([], [])


def test_a_file_is_filled_in_and_checked(tmp_path: Path):
    path = tmp_path / "x.json5"

    def configured(text: str, *settings: str):
        path.write_text(text)
        return configure(options(f'buses.net.zenoh="{path}"', *settings), "slave")

    config = configured("{mode: 'client', /* a comment */ metadata: {name: '{node}'}}")
    assert (get(config, "mode"), get(config, "metadata")) == ("client", {"name": "slave"})
    assert get(config, "scouting/multicast/enabled") is False
    with pytest.raises(ScenarioError, match=r"x.json5: unknown field `lisen`"):
        configured("{lisen: {}}")
    with pytest.raises(ScenarioError, match=r"x\.json5"):
        configured("{mode: ")
    clear = "{listen: {endpoints: ['tcp/[::]:7447']}}"
    with pytest.raises(ScenarioError, match=r"x.json5: connect: .*without encryption"):
        configured(clear.replace("listen", "connect"), "buses.net.options={}")
    with pytest.raises(ScenarioError, match="multicast scouting"):
        configured("{scouting: {multicast: {enabled: true}}}")
    with pytest.raises(ScenarioError, match=r"root_ca_certificate: no file .*/nokeys/ca.pem"):
        configured(
            "{transport: {link: {tls: {root_ca_certificate: '{keys}/ca.pem'}}}}",
            'buses.net.options.keys="nokeys"',
        )
    with pytest.raises(ScenarioError, match=r"zenoh: no file .*missing.json5"):
        options('buses.net.zenoh="missing.json5"')


@pytest.mark.skipif(sys.platform != "linux", reason="counts files in /proc")
@pytest.mark.parametrize("config", [None, "router.json5"])
def test_sessions_that_are_closed_leave_no_file_of_shared_memory(config):
    """A node opens a session again after each outage."""
    path = CONFIGS / "zenoh" / config if config else None
    options = ZenohOptions("test", ("tcp/127.0.0.1:0",), config=path, insecure=True)
    for _ in range(2):
        open_session(configure(options, "test"), "net").close()
    assert open_files()[".zenoh"] == 0
