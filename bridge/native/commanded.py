"""``commanded.h``: a drive as the node sees it that commands it."""

from __future__ import annotations

from bridge.native.enums import Failure, Lacks, Phase, StepKind, Told
from bridge.native.structs import CommandedStruct, DriveEvent, StepStruct, ToldStruct

__all__ = [
    "CommandedStruct", "DriveEvent", "Failure", "Lacks", "Phase", "StepKind",
    "StepStruct", "Told", "ToldStruct",
]  # fmt: skip
