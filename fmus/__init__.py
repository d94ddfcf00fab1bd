"""The models: mathematics in fixed steps, and how they become ``.fmu`` files.

Imports :mod:`cosim` at most; never :mod:`bridge`. Each model is declared once, in
``fmus/models/NAME.py`` (variables, units, start values, law), and its C99 kernel stands in
``fmus/c/NAME.c``. From both come the FMUs, FMI 2.0 and 3.0, with the same binary.
"""
