"""Templates for a new project: a scenario, its rehearsal on a bus, and a test.

Input: a name, or the URDF file of an arm. Output: files that run
as they are, to be changed.
"""

from bridge.scaffold.arm import write_arm
from bridge.scaffold.controller import write_controller

__all__ = ["write_arm", "write_controller"]
