"""``commanded.h``: a drive as the node sees it that commands it."""

from __future__ import annotations

from bridge.native.enums import Failure, Phase, StepKind, Told
from bridge.native.structs import CommandedStruct, DriveEvent, DriveEvents, StepStruct, ToldStruct

__all__ = [
    "CommandedStruct", "DriveEvent", "DriveEvents", "Failure", "Phase", "StepKind",
    "StepStruct", "Told", "ToldStruct",
]  # fmt: skip
