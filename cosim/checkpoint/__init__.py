"""Checkpoints of a run: its state in the run folder, and the run resumed from it.

Input: a running engine, and its recorder; nodes in lock-step save theirs by the same parts
(:mod:`bridge.node.saved_state`). Output: ``.checkpoints/`` in the run folder, until the
run, and what is made of it, is complete. Rows of link tables are not saved: they are drawn again
from their seeds.
"""

from cosim.checkpoint.keeper import CheckpointInterval, CheckpointKeeper
from cosim.checkpoint.resumption import Resumption

__all__ = ["CheckpointInterval", "CheckpointKeeper", "Resumption"]
