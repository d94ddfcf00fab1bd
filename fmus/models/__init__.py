"""One file per model: its declaration ``model(**sizes)`` and its ``law``; the C file is in fmus/c.

From both, :func:`fmus.build.reference.derive` makes the functions that scenarios use:
``fmu(version, **sizes)``, ``kernel(**sizes)`` and the class of the NumPy reference (such as
``Xi``).

Several models share ``adaptive_variables`` (declarations), ``static_feedback`` (adaptive laws whose
reference follows from the inputs alone) and ``serial_arm`` (adaptive laws of an arm with a table).
"""
