"""One command on the host's kernel, in a separate network namespace with vcan interfaces."""

from __future__ import annotations

import signal

from bridge.vcan import supervise
from bridge.vcan.capabilities import namespace_command
from bridge.vcan.guest import GuestCommand

_SCRIPT = """
ip link set lo up || exit 125
i=0
while [ $i -lt $0 ]; do
    ip link add dev vcan$i type vcan && ip link set vcan$i mtu 72 up || exit 125
    i=$((i + 1))
done
command -v "$1" >/dev/null || { echo "error: $1: not found" >&2; exit 127; }
exec "$@"
"""


def run(request: GuestCommand) -> int:
    """The command's exit status; in the watcher (`supervise`)."""
    script = ["sh", "-c", _SCRIPT, str(request.buses), *request.command]
    process = supervise.start_command([*namespace_command(), *script], start_new_session=True)

    def tell(number: signal.Signals) -> None:
        process.send_signal(number)

    cause = supervise.wait_for_process(process, request.timeout, tell)
    status = supervise.as_status(process.returncode)
    return supervise.status_of(cause, status) or 0
