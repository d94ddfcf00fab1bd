"""Answers a question of a supervised command on a separate terminal; prints the result."""

from __future__ import annotations

import os

from cosim.cli.supervise import allow_terminal_input, supervised
from tests.children import fork_on_terminal


def ask() -> None:
    """Ask like a command."""
    with allow_terminal_input():
        answer = input("go on? ")
    print(f"answer={answer}", flush=True)


def main() -> None:
    """Start it on a terminal, answer, and pass on what it prints."""
    child, terminal = fork_on_terminal(lambda: supervised(ask))
    said = b""
    while not said.endswith(b"go on? "):
        said += os.read(terminal, 1000)
    os.write(terminal, b"yes\n")
    while not said.endswith(b"answer=yes\r\n"):
        said += os.read(terminal, 1000)
    _, status = os.waitpid(child, 0)
    print("answer=yes", f"code={os.waitstatus_to_exitcode(status)}")


if __name__ == "__main__":
    main()
