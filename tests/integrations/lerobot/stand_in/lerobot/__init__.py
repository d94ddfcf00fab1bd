"""The parts of LeRobot that a plug-in needs, for machines without it (it needs torch: 3 GB)."""
