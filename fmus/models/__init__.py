"""One file a model. Each has ``model(**sizes)``, ``fmu(version, **sizes)`` and a Python class."""
