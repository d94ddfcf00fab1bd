"""``python -m bridge.vcan run|setup|status``."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from bridge.vcan import capabilities, host, packages, supervise, uml
from bridge.vcan.errors import VcanError
from bridge.vcan.guest import GuestCommand
from cosim.base.errors import CosimError
from cosim.base.streams import end_with

_BACKENDS = {"host": host.run, "uml": uml.run}


def main(arguments: Sequence[str] | None = None) -> int:
    """The exit status: of `run`, the command's own; 124 time-out; 125 no kernel."""
    options = _parser().parse_args(arguments)
    try:
        if options.action == "setup":
            packages.obtain()
            sys.stdout.write(f"{', '.join(packages.PACKAGES)}: in {packages.cache()}\n")
            return 0
        return _status() if options.action == "status" else _run(options)
    except CosimError as error:
        sys.stderr.write(f"error: {error}\n")
        return error.exit_code


def _run(options: argparse.Namespace) -> int:
    command = options.command[options.command[:1] == ["--"] :]
    if not command:
        raise VcanError("no command; expected python -m bridge.vcan run -- COMMAND ...")
    request = GuestCommand(tuple(command), options.timeout, options.mem, options.cpu, options.buses)
    capabilities.bytes_of(request.memory)
    backend = _BACKENDS[options.backend if options.backend != "auto" else _best(options.mem)]
    return supervise.supervised(lambda: backend(request))


def _best(memory: str) -> str:
    """The backend to use: the host's kernel if that has CAN."""
    tried = []
    for ability in (capabilities.host, lambda: capabilities.uml(memory)):
        found = ability()
        if found.possible:
            return found.backend
        tried.append(f"{found.backend}: {found.why}")
    raise VcanError("no kernel with CAN is available; " + "; ".join(tried))


def _status() -> int:
    found = [capabilities.host(), capabilities.uml()]
    for ability in found:
        sys.stdout.write(
            f"{ability.backend:5}{'yes' if ability.possible else 'no ':4}{ability.why}\n"
        )
    best = next((ability.backend for ability in found if ability.possible), None)
    sys.stdout.write(f"run uses: {best or 'nothing: no kernel with CAN is available'}\n")
    return 0 if best else VcanError.exit_code


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m bridge.vcan", description="Run a command on a kernel with CAN."
    )
    actions = parser.add_subparsers(dest="action", required=True)
    actions.add_parser("setup", help="download the packages for User-Mode Linux")
    actions.add_parser("status", help="print the available backends, with reasons")
    run = actions.add_parser("run", help="run a command in a network with vcan0, vcan1, ...")
    run.add_argument("--backend", choices=("auto", *_BACKENDS), default="auto")
    run.add_argument(
        "--timeout", type=float, default=float("inf"), metavar="S", help="time limit, s"
    )
    run.add_argument("--mem", default="1G", help="memory of the guest (default 1G)")
    run.add_argument("--cpu", default="", metavar="N|free", help="CPU to run on (default: idlest)")
    run.add_argument("--buses", type=int, default=2, metavar="N", help="number of vcan interfaces")
    run.add_argument("command", nargs=argparse.REMAINDER, metavar="-- COMMAND ...")
    return parser


if __name__ == "__main__":
    end_with(main)
