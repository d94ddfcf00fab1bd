"""An FMU in a process of its own: the instance here, the process there, and their messages."""
