"""What holds for all tests."""

import signal

from hypothesis import HealthCheck, settings

# One profile for all property tests: a loaded machine is slow, and slowness is measured elsewhere.
settings.register_profile(
    "project", deadline=None, suppress_health_check=[HealthCheck.too_slow], print_blob=True
)
settings.load_profile("project")


def pytest_configure() -> None:
    """Commands that tests start heed Ctrl-C, also where the tests run in the background."""
    if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
