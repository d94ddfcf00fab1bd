"""A model as C99 for a microcontroller, from the sources of its FMU, with a check of its bits.

``sources`` writes the two files of a model, ``targets`` knows processors and compilers, ``folder``
writes everything that a board needs, ``measure`` builds and runs it, and ``page`` describes it.
"""
