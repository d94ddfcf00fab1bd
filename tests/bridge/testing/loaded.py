"""Modules that stay: pytester forgets those that are imported while it runs tests."""

from importlib import import_module


def all_that_runs_use() -> None:
    """Import them before."""
    for module in ("cosim.api.running", "cosim.reporting.rewritten", "bridge.replay.diff"):
        import_module(module)
    for module in ("bridge.results.outcome", "bridge.rehearsal.supervisor", "bridge.faults.load"):
        import_module(module)
    for module in ("buses", "case", "limit", "networks", "references", "rehearsals", "runs"):
        import_module(f"bridge.testing.{module}")
