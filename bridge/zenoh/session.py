"""A Zenoh session from its configuration file and a deployment's options, checked before it opens.

Zenoh refuses unknown keys, but it detects an invalid protocol of an endpoint or an invalid
certificate file only when it opens, or never. Defaults for missing entries: no scouting, no
automatic connections, retries within 200 ms.
"""

from __future__ import annotations

import json
import os
import threading
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

import zenoh

from bridge.can.socket import BusError
from bridge.zenoh.options import ZenohOptions, check_endpoint
from cosim.base.errors import ScenarioError

#: s that a session may take to close.
CLOSING = 2.0
#: s that a session may wait for what it must connect to.
WITHIN = 30.0
#: What holds where the configuration file has nothing.
DEFAULTS: dict[str, Any] = {
    "mode": "peer",
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": False,
    "scouting/delay": 50,
    "connect/timeout_ms": -1,
    "connect/exit_on_failure": False,
    "connect/retry": {
        "period_init_ms": 50,
        "period_max_ms": 200,
        "period_increase_factor": 1.5,
    },
}
SHARED = "transport/shared_memory/enabled"
#: What holds without a configuration file, besides.
WITHOUT_FILE: dict[str, Any] = {
    "transport/link/tx/lease": 3000,  # a busy machine stops a process for more than a second
    "transport/link/tx/keep_alive": 4,
    "transport/link/tx/queue/size/real_time": 16,
    "transport/unicast/open_timeout": 1000,
    "transport/unicast/accept_timeout": 1000,
    SHARED: False,
}
#: One thread that receives, where the environment says nothing: with two (Zenoh's default) each
#: message wakes both, on two processors.
RUNTIME = "(rx: (worker_threads: 1))"
_FILES = (
    *(f"transport/link/tls/{name}" for name in ("root_ca_certificate",)),
    *(
        f"transport/link/tls/{side}_{what}"
        for side in ("listen", "connect")
        for what in ("private_key", "certificate")
    ),
    "transport/auth/usrpwd/dictionary_file",
)


def configure(
    options: ZenohOptions, node: str, access: Mapping[str, object] | None = None
) -> zenoh.Config:
    """The configuration of a node's session.

    `access`: the section ``access_control`` where the file enables it and gives no rules.

    In the file, ``{node}`` is the node's name and ``{keys}`` the folder of its certificates; other
    relative paths are beside the file. Raises ScenarioError.
    """
    config = _read(options, node)
    for key, value in DEFAULTS.items():
        if _get(config, key) is None:
            config.insert_json5(key, json.dumps(value))
    unsaid = _get(zenoh.Config(), "listen/endpoints")  # any address of this machine
    for kind, endpoints in (("listen", options.listen), ("connect", options.connect)):
        if endpoints or (kind == "listen" and _get(config, "listen/endpoints") == unsaid):
            config.insert_json5(f"{kind}/endpoints", json.dumps(list(endpoints)))
        for endpoint in _flat(_get(config, f"{kind}/endpoints")):
            check_endpoint(endpoint, f"{_place(options)}: {kind}", insecure=options.insecure)
    asked = _get(config, "access_control/enabled")
    if access and asked and _get(config, "access_control/rules") is None:
        config.insert_json5("access_control", json.dumps(access))
    _check_scouting(config, options)
    _check_files(config, options)
    return config


def _place(options: ZenohOptions) -> str:
    return str(options.config or options.place)


def _read(options: ZenohOptions, node: str) -> zenoh.Config:
    if options.config is None:
        config = zenoh.Config()
        for key, value in WITHOUT_FILE.items():
            config.insert_json5(key, json.dumps(value))
        return config
    text = options.config.read_text(encoding="utf-8")
    text = text.replace("{node}", node).replace("{keys}", str(options.keys.resolve()))
    try:
        config = zenoh.Config.from_json5(text)
    except zenoh.ZError as error:
        raise ScenarioError(f"{error}", str(options.config)) from error
    if "shared_memory" not in text:  # each session would leave a file open, to the process's end
        config.insert_json5(SHARED, json.dumps(WITHOUT_FILE[SHARED]))
    return config


def _get(config: zenoh.Config, key: str) -> Any:
    return json.loads(config.get_json(key))


def _flat(value: Any) -> list[str]:
    """Endpoints as Zenoh has them: a list, or lists by mode."""
    if isinstance(value, dict):
        return [e for listed in value.values() for e in listed or []]
    return list(value or [])


def _check_scouting(config: zenoh.Config, options: ZenohOptions) -> None:
    if _get(config, "scouting/multicast/enabled") and not options.insecure:
        raise ScenarioError(
            "multicast scouting announces this node on all its networks and connects to "
            "every peer that answers; expected scouting to be off, or insecure = true",
            _place(options),
        )


def _check_files(config: zenoh.Config, options: ZenohOptions) -> None:
    for key in _FILES:
        name = _get(config, key)
        if name is None:
            continue
        path = (_beside(options) / name).resolve()
        if not path.is_file():
            raise ScenarioError(
                f"{key}: no file {path}; cosim keys creates certificates", _place(options)
            )
        config.insert_json5(key, json.dumps(str(path)))


def _beside(options: ZenohOptions) -> Any:
    return (options.config or options.keys).parent


def lease_time(config: zenoh.Config) -> float:
    """After how long without a sign a session gives a connection up, s."""
    return float(_get(config, "transport/link/tx/lease")) / 1e3


def listens_on(config: zenoh.Config) -> list[str]:
    """The endpoints on which a session listens."""
    return _flat(_get(config, "listen/endpoints"))


def open_session(config: zenoh.Config, bus: str, within: float | None = WITHIN) -> zenoh.Session:
    """Open a session. Raises BusError, which names what could not be opened.

    `within`: time for Zenoh to connect to its endpoints, s; None: unlimited. The first session of a
    process determines Zenoh's threads: `RUNTIME`.
    """
    os.environ.setdefault("ZENOH_RUNTIME", RUNTIME)
    found: list[zenoh.Session | zenoh.ZError] = []
    late = threading.Event()

    def opening() -> None:
        try:
            found.append(zenoh.open(config))
        except zenoh.ZError as error:
            found.append(error)
        if late.is_set() and isinstance(found[0], zenoh.Session):
            close_session(found[0])

    thread = threading.Thread(target=opening, name="open", daemon=True)
    thread.start()
    thread.join(within)
    if found and isinstance(found[0], zenoh.Session):
        return found[0]
    late.set()
    why = _short(found[0]) if found else f"no connection after {within:g} s"
    listen = ", ".join(_flat(_get(config, "listen/endpoints"))) or "nothing"
    connect = ", ".join(_flat(_get(config, "connect/endpoints"))) or "nothing"
    raise BusError(
        f"bus {bus}: Zenoh: {why} (listen endpoints: {listen}; connect endpoints: {connect})"
    )


def close_session(session: zenoh.Session) -> None:
    """Close a session, or leave it to the end of the process where that takes more than `CLOSING`.

    Zenoh may wait for a peer that has gone, and gives up with an error after 10 s.
    """

    def close() -> None:
        with suppress(zenoh.ZError):
            session.close()  # type: ignore[no-untyped-call]

    thread = threading.Thread(target=close, name="close", daemon=True)
    thread.start()
    thread.join(CLOSING)


def _short(error: object) -> str:
    """Without the places in Zenoh's own source."""
    return str(error).partition(" at /")[0]
