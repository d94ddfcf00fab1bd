"""The C engine (``cosim/c``) through ctypes: structs, functions, and what FMUs log."""
