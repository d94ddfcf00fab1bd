"""One file a model. Each has ``model(**sizes)``, ``fmu(version, **sizes)`` and a Python class.

Shared by several: ``start`` (values on the way in and out), ``dynamics`` (M, C, g and Y),
``arm`` and ``adaptive_variables`` (declarations), ``static_feedback`` (adaptive laws whose
reference follows from the inputs alone).
"""
