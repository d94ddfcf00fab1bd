"""FMUs in WebAssembly: their components run by wasmtime, behind the C functions of FMI 3.0.

In: a component of the FMI Layered Standard for WebAssembly, and limits. Out: function pointers as a
shared library has them, so that all that calls FMUs calls these as well.
"""
