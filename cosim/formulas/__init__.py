"""Formulas over signals in time: how they are written, and by how much they hold

In come texts such as ``norm(a.q - b.q) <= 0.1 rad`` and rows of signals; out comes the robustness
of signal temporal logic: the distance, in the unit of the signals, by which a formula holds at each
row, negative where it does not. Requirements of a scenario (``[require.NAME]``) are formulas.
"""
