"""The plug-in of pytest: scenarios, twins, rehearsals, buses and networks as fixtures.

In come the files next to a test; out come runs with questions that a test asserts, and, of a test
that fails, its report, its seed and the command that repeats it. pytest loads
:mod:`bridge.testing.plugin` in every run of tests on a machine where this distribution is
installed, so that module imports nothing but pytest; all else is imported by the fixture that a
test uses.
"""
