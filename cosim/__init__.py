"""Fixed-step co-simulation of controllers and FMU plants over links with real latency.

The package handles ticks, ports, wires and links. It contains no robots, buses or networks:
models are in :mod:`fmus`, real time is in :mod:`bridge`. Importing it is cheap on purpose;
NumPy, Parquet and plotting are imported where they are used.
"""

__version__ = "0.1.0"
