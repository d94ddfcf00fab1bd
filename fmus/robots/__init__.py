"""Robots from files: a URDF becomes the table of a serial arm (``fmus.models.chain``).

``urdf`` reads the file strictly, ``body`` adds and checks inertias, ``serial`` follows the chain
from base to tip, and ``options`` is what models offer to scenarios.
"""
