"""``commanded.h``: a drive as the node sees it that commands it."""

from __future__ import annotations

from bridge.native.enums import Failure, Lacks, Phase, StepKind, Told
from bridge.native.structs import CommandedStruct, DriveEvent, DriveEvents, StepStruct, ToldStruct

__all__ = [
    "CommandedStruct", "DriveEvent", "DriveEvents", "Failure", "Lacks", "Phase", "StepKind",
    "StepStruct", "Told", "ToldStruct",
]  # fmt: skip
