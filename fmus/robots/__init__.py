"""Work of commands on robots from files: a report of a URDF, and identification from a run."""
