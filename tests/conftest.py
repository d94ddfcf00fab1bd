"""What holds for all tests."""

import signal


def pytest_configure() -> None:
    """Commands that tests start heed Ctrl-C, also where the tests run in the background."""
    if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
