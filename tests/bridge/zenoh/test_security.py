"""configs/zenoh/secure.json5: who may connect, and who may publish what."""

import stat
from collections.abc import Iterator
from pathlib import Path

import pytest
import zenoh

from bridge.native.frame import Frame
from bridge.zenoh.access import access_control
from bridge.zenoh.certificates import make_keys
from bridge.zenoh.channel import ZenohAttachment
from bridge.zenoh.options import ZenohOptions
from bridge.zenoh.session import configure, open_session
from cosim.base.clock import sleep
from cosim.base.errors import CosimError, ScenarioError
from tests.bridge.zenoh.ends import NAMES, key, traffic
from tests.bridge.zenoh.rehearsed import CONFIGS
from tests.bridge.zenoh.test_channel import exchange, free_ports, until

SECURE = CONFIGS / "zenoh" / "secure.json5"
NODES = ("a", "b", "c")
QUIET = 0.5  # s in which what is allowed has long arrived


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("keys")
    make_keys(folder, [*NODES, "thief", "operator"])
    return folder


def end(node: str, other: str, keys: Path, **said: object) -> ZenohAttachment:
    options = ZenohOptions("test", config=SECURE, keys=keys, **said)  # type: ignore[arg-type]
    access = access_control(NAMES, NODES)
    return ZenohAttachment("net", NAMES, traffic(node, other), options, access=access)


@pytest.fixture
def pair(keys: Path) -> Iterator[tuple[ZenohAttachment, ZenohAttachment, str]]:
    (port,) = free_ports(1)
    where = f"tls/127.0.0.1:{port}"
    a, b = end("a", "b", keys, listen=(where,)), end("b", "a", keys, connect=(where,))
    a.wait_for_peers()
    b.wait_for_peers()
    yield a, b, where
    a.close()
    b.close()


def session(node: str, keys: Path, where: str) -> zenoh.Session:
    """With a certificate, and no rules of its own: it tries everything."""
    options = ZenohOptions("test", config=SECURE, keys=keys, connect=(where,))
    config = configure(options, node)
    config.insert_json5("access_control", '{"enabled": false}')
    return open_session(config, "net")


def test_named_nodes_exchange(pair: tuple[ZenohAttachment, ZenohAttachment, str]):
    a, b, _ = pair
    exchange(a, b, b"hello")
    assert a.presence.there == {"b"}


@pytest.mark.parametrize("who", ["c", "thief"])
def test_nobody_says_what_is_anothers(
    who: str, pair: tuple[ZenohAttachment, ZenohAttachment, str], keys: Path
):
    a, b, where = pair
    other = session(who, keys, where)
    until(lambda: a.session.info.zid() in other.info.peers_zid())  # the certificate is right
    for _ in range(20):
        other.put(key("b", 0x100), b"forged")
        sleep(0.005)
    token = other.liveliness().declare_token(NAMES.of("b2", "alive"))
    b.bus.send(Frame.of(0x100, b"true"))
    sleep(QUIET)
    assert {frame.payload for frame in a.bus.drain()} == {b"true"}
    assert a.presence.there == {"b"}
    assert token is not None
    other.close()


def test_a_valid_certificate_of_no_node_hears_nothing(
    pair: tuple[ZenohAttachment, ZenohAttachment, str], keys: Path
):
    a, b, where = pair
    thief = session("thief", keys, where)
    until(lambda: a.session.info.zid() in thief.info.peers_zid())
    heard = thief.declare_subscriber("**", zenoh.handlers.RingChannel(16))
    exchange(a, b, b"secret")
    sleep(QUIET)
    assert heard.try_recv() is None
    assert list(thief.liveliness().get("**", timeout=QUIET)) == []
    thief.close()


def test_another_authority_with_the_same_name_is_refused(
    pair: tuple[ZenohAttachment, ZenohAttachment, str], tmp_path: Path
):
    a, _, where = pair
    make_keys(tmp_path, ["b"])
    other = session("b", tmp_path, where)
    sleep(QUIET)
    assert other.info.peers_zid() == [] and len(a.session.info.peers_zid()) == 1
    other.close()


def test_a_stranger_is_refused(pair: tuple[ZenohAttachment, ZenohAttachment, str], keys: Path):
    """Who knows the authority, but has no certificate; and who tries without TLS."""
    a, _, where = pair
    texts = [
        f'{{transport: {{link: {{tls: {{root_ca_certificate: "{keys}/ca.pem"}}}}}}}}',
        "{}",
    ]
    for text, endpoint in zip(texts, (where, where.replace("tls", "tcp")), strict=True):
        config = zenoh.Config.from_json5(text)
        config.insert_json5("scouting/multicast/enabled", "false")
        config.insert_json5("listen/endpoints", "[]")
        config.insert_json5("connect/endpoints", f'["{endpoint}"]')
        stranger = zenoh.open(config)
        sleep(QUIET)
        assert stranger.info.peers_zid() == []
        assert len(a.session.info.peers_zid()) == 1
        stranger.close()


def test_without_certificates_a_sentence(tmp_path: Path):
    with pytest.raises(ScenarioError, match=r"root_ca_certificate: no file .*cosim keys creates"):
        end("a", "b", tmp_path / "none")


def test_clear_text_is_refused_before_the_session(keys: Path):
    with pytest.raises(ScenarioError, match="is reachable from other machines without encryption"):
        end("a", "b", keys, listen=("tcp/0.0.0.0:0",))


def test_keys_are_their_owners_only_and_made_anew(tmp_path: Path):
    first = make_keys(tmp_path, ["a"])
    assert {p.name for p in first} == {"ca.pem", "ca.key", "a.pem", "a.key"}
    assert all(stat.S_IMODE(p.stat().st_mode) == 0o600 for p in first if p.suffix == ".key")
    authority, certificate = (tmp_path / "ca.pem").read_bytes(), (tmp_path / "a.pem").read_bytes()
    again = make_keys(tmp_path, ["a"])
    assert {p.name for p in again} == {"a.pem", "a.key"}
    assert (tmp_path / "ca.pem").read_bytes() == authority
    assert (tmp_path / "a.pem").read_bytes() != certificate
    assert {p.name for p in tmp_path.iterdir()} == {*(p.name for p in first), "ca.srl"}


def test_names_that_are_none(tmp_path: Path):
    for name in ("a/b", "a b", "", "a,DNS:evil"):
        with pytest.raises(CosimError, match="cannot be part of a key"):
            make_keys(tmp_path, [name])
