"""Mechanics of arms, shared by the models: dynamics, tables of serial arms, and robots from files.

``dynamics`` is the planar arm (M, C, g and Y); ``chain`` is any serial arm, given by a table, with
``chain_law`` (regressor), ``task_space`` and ``natural`` (parameters that a body can have).
``urdf`` reads a file strictly, ``body`` adds and checks inertias, ``serial`` follows the chain
from base to tip, ``options`` is what models offer to scenarios, and ``identification`` fits the
table to a recorded motion.
"""
