"""The run folder: the files of a run, written during the run and read back afterwards.

``runs/<scenario>-<date>-<time>/`` holds

* ``trajectories.parquet``: column ``t`` (s) and one float64 column per recorded scalar, its unit in
  the field's metadata;
* ``run.json``: scenario, seeds, versions, results;
* ``links/<name>.parquet``: the table of sent samples of each link;
* ``SHA256SUMS``: the sums of all these files, written last;
* ``last.parquet``: the last ticks of *all* signals, only after a run that had to stop;
* during the run, ``trajectories.parquet.part``, ``trajectories.live`` and
  ``links/<name>.rows`` in place of what is complete only at the end.

This package handles columns and rows, whatever the signals mean.
"""

from cosim.record.folder import claim_folder, held_folder, link_file, read_metadata, write_metadata
from cosim.record.recorder import Column, Recorder
from cosim.record.run import Run
from cosim.record.sums import seal, verify

__all__ = [
    "Column",
    "Recorder",
    "Run",
    "claim_folder",
    "held_folder",
    "link_file",
    "read_metadata",
    "seal",
    "verify",
    "write_metadata",
]
