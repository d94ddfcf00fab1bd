"""Certificates for trying mutual TLS: an authority of one's own, one certificate a node.

Keys are made by ``openssl`` (P-256); each is readable by its owner only. The authority's key signs
whatever it is asked to: it belongs on no machine that runs a node.
"""

from __future__ import annotations

import ipaddress
import socket
import ssl
import subprocess
from collections.abc import Iterable, Sequence
from pathlib import Path

from bridge.deployment.zenoh_keys import check_chunk
from cosim.base.errors import CosimError

AUTHORITY = "ca"
DAYS = 365
#: s for each step of a handshake.
HANDSHAKE = 1.0
HOSTS = ("localhost", "127.0.0.1")


def make_keys(
    folder: Path, nodes: Iterable[str], hosts: Sequence[str] = HOSTS, days: int = DAYS
) -> list[Path]:
    """Write ``NODE.pem`` and ``NODE.key`` into `folder`, signed by ``ca.pem`` there.

    The authority is made if there is none. The common name is the node's; `hosts` are where nodes
    may listen. Certificates that are there are made anew. Returns what was written. Raises
    CosimError.
    """
    folder.mkdir(parents=True, exist_ok=True)
    folder.chmod(0o700)
    listed = list(nodes)
    for node in (*listed, *hosts):
        check_chunk(node.replace(":", "."), f"cosim keys {folder}")
    written = [] if (folder / f"{AUTHORITY}.key").is_file() else _authority(folder, days)
    for node in listed:
        written += _certificate(folder, node, hosts, days)
    return written


def refusal(endpoint: str, keys: Path, node: str) -> str:
    """The reason why TLS with an endpoint, ``tls/ADDRESS:PORT``, fails; "": it does not, or nothing
    listens there.

    `keys`: folder of certificates, with ``ca.pem`` and those of `node`.
    """
    address, _, port = endpoint.partition("/")[2].rpartition(":")
    context = ssl.create_default_context(cafile=keys / f"{AUTHORITY}.pem")
    try:
        context.load_cert_chain(keys / f"{node}.pem", keys / f"{node}.key")
        with (
            socket.create_connection((address, int(port)), HANDSHAKE) as plain,
            context.wrap_socket(plain, server_hostname=address) as secured,
        ):
            secured.recv(1)  # TLS 1.3 tells only here that our certificate is refused
    except ssl.SSLCertVerificationError as error:
        return f"it has a certificate that {AUTHORITY}.pem here refuses: {error.verify_message}"
    except ssl.SSLError as error:
        return f"it refuses the certificate {node}.pem, or speaks without TLS: {error.reason}"
    except OSError:
        pass
    return ""


def _authority(folder: Path, days: int) -> list[Path]:
    key, certificate = folder / f"{AUTHORITY}.key", folder / f"{AUTHORITY}.pem"
    _new_key(key)
    _openssl(
        *("req", "-x509", "-new", "-key", key, "-out", certificate, "-days", days),
        *("-subj", "/CN=cosim test authority"),
        *("-addext", "keyUsage=critical,keyCertSign,cRLSign"),
    )
    return [certificate, key]


def _certificate(folder: Path, node: str, hosts: Sequence[str], days: int) -> list[Path]:
    key, certificate = folder / f"{node}.key", folder / f"{node}.pem"
    request, facts = folder / f"{node}.csr", folder / f"{node}.ext"
    _new_key(key)
    names = [f"DNS:{node}", *(f"{'IP' if _is_address(h) else 'DNS'}:{h}" for h in hosts)]
    facts.write_text(
        f"subjectAltName={','.join(names)}\nextendedKeyUsage=serverAuth,clientAuth\n"
        "basicConstraints=CA:FALSE\n"
    )
    _openssl("req", "-new", "-key", key, "-out", request, "-subj", f"/CN={node}")
    _openssl(
        *("x509", "-req", "-in", request, "-out", certificate, "-days", days),
        *("-CA", folder / f"{AUTHORITY}.pem", "-CAkey", folder / f"{AUTHORITY}.key"),
        *("-CAcreateserial", "-extfile", facts),
    )
    request.unlink()
    facts.unlink()
    return [certificate, key]


def _new_key(path: Path) -> None:
    path.unlink(missing_ok=True)
    path.touch(mode=0o600)
    _openssl("genpkey", "-algorithm", "EC", "-pkeyopt", "ec_paramgen_curve:P-256", "-out", path)


def _is_address(host: str) -> bool:
    try:
        ipaddress.ip_address(host)
    except ValueError:
        return False
    return True


def _openssl(*arguments: object) -> None:
    try:
        found = subprocess.run(
            ["openssl", *map(str, arguments)], capture_output=True, text=True, check=False
        )
    except OSError as error:
        raise CosimError(f"cannot make certificates without openssl: {error}") from error
    if found.returncode:
        raise CosimError(f"openssl {arguments[0]}: {found.stderr.strip()}")
