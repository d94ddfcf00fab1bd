"""Templates for a new project: a controller, a scenario and a test that run without changes."""

from cosim.scaffold.controller import write_controller

__all__ = ["write_controller"]
