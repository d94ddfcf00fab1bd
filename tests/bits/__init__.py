"""The bits of kernels and engine under any compiler, processor and byte order."""
