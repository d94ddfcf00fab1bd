"""The plug-ins on the path, with LeRobot's abstract classes: its own, or the stand-in."""

import sys
from importlib.util import find_spec
from pathlib import Path

HERE = Path(__file__).parent
sys.path.append(str(HERE.parents[2] / "integrations/lerobot"))
if find_spec("lerobot") is None:
    sys.path.append(str(HERE / "stand_in"))
