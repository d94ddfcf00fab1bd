"""What a new project starts with: a controller, a scenario and a test that work at once."""

from cosim.scaffold.controller import write_controller

__all__ = ["write_controller"]
