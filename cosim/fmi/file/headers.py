"""Headers that the sources of FMUs include and need not bring with them."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

#: Types of FMI 1.0 (§2.1 of its documents); of later versions FMPy has the standard's headers.
_TYPES = """#ifndef fmiPlatformTypes_h
#define fmiPlatformTypes_h
#define fmiPlatform "standard32"
#define fmiModelTypesPlatform "standard32"
#define fmiTrue 1
#define fmiFalse 0
#define fmiUndefinedValueReference ((fmiValueReference)-1)
typedef void *fmiComponent;
typedef unsigned int fmiValueReference;
typedef double fmiReal;
typedef int fmiInteger;
typedef char fmiBoolean;
typedef const char *fmiString;
#endif
"""
_FUNCTIONS = """#ifndef fmiFunctions_h
#define fmiFunctions_h
#include <stddef.h>
#include "fmiPlatformTypes.h"
#define fmiPasted(a, b) a##b
#define fmiPaste(a, b) fmiPasted(a, b)
#define fmiFullName(name) fmiPaste(MODEL_IDENTIFIER, name)
#ifndef DllExport
#define DllExport
#endif
#define fmiVersion "1.0"
typedef enum { fmiOK, fmiWarning, fmiDiscard, fmiError, fmiFatal, fmiPending } fmiStatus;
typedef enum { fmiDoStepStatus, fmiPendingStatus, fmiLastSuccessfulTime } fmiStatusKind;
typedef void (*fmiCallbackLogger)(fmiComponent, fmiString, fmiStatus, fmiString, fmiString, ...);
typedef void *(*fmiCallbackAllocateMemory)(size_t, size_t);
typedef void (*fmiCallbackFreeMemory)(void *);
typedef void (*fmiStepFinished)(fmiComponent, fmiStatus);
typedef struct {
    fmiCallbackLogger logger;
    fmiCallbackAllocateMemory allocateMemory;
    fmiCallbackFreeMemory freeMemory;
#ifndef fmiModelFunctions_h
    fmiStepFinished stepFinished;
#endif
} fmiCallbackFunctions;
typedef struct {
    fmiBoolean iterationConverged, stateValueReferencesChanged, stateValuesChanged;
    fmiBoolean terminateSimulation, upcomingTimeEvent;
    fmiReal nextEventTime;
} fmiEventInfo;
NAMES
#endif
"""
#: Functions, whose names in a library begin with the identifier of the model.
_NAMES = (
    *("GetModelTypesPlatform", "GetTypesPlatform", "GetVersion", "SetDebugLogging"),
    *(f"{verb}{kind}" for verb in ("Get", "Set") for kind in ("Real", "Integer", "Boolean")),
    *("GetString", "SetString", "InstantiateModel", "FreeModelInstance", "SetTime"),
    *("SetContinuousStates", "CompletedIntegratorStep", "Initialize", "GetDerivatives"),
    *("GetEventIndicators", "EventUpdate", "GetContinuousStates", "GetNominalContinuousStates"),
    *("GetStateValueReferences", "Terminate", "InstantiateSlave", "InitializeSlave"),
    *("TerminateSlave", "ResetSlave", "FreeSlaveInstance", "SetRealInputDerivatives"),
    *("GetRealOutputDerivatives", "CancelStep", "DoStep", "GetStatus", "GetRealStatus"),
    *("GetIntegerStatus", "GetBooleanStatus", "GetStringStatus"),
)
_DEFINED = "\n".join(f"#define fmi{name} fmiFullName(_fmi{name})" for name in _NAMES)
_FMI1 = {
    "fmiPlatformTypes.h": _TYPES,
    "fmiModelTypes.h": '#include "fmiPlatformTypes.h"\n',
    "fmiFunctions.h": _FUNCTIONS.replace("NAMES", _DEFINED),
    "fmiModelFunctions.h": "#define fmiModelFunctions_h\n" + '#include "fmiFunctions.h"\n',
}


def header_folder(fmi: str, scratch: Path) -> Path | None:
    """A folder with the headers of an FMI version; those of 1.0 are written into `scratch`.

    None: there are none here.
    """
    if fmi == "1.0":
        for name, text in _FMI1.items():
            (scratch / name).write_text(text, encoding="utf-8")
        return scratch
    found = find_spec("fmpy")
    places = found.submodule_search_locations if found is not None else None
    folder = Path(places[0], "c-code") if places else None
    return folder if folder is not None and folder.is_dir() else None
