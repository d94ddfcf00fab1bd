"""Fixed-step co-simulation of controllers and FMU plants over links with real latency.

The package knows ticks, ports, wires and links. It knows no robot, no bus and no network:
models live in :mod:`fmus`, real time in :mod:`bridge`. Importing it is cheap on purpose;
NumPy, Parquet and plotting are imported where they are used.
"""

__version__ = "0.1.0"
