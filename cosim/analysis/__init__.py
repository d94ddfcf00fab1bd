"""Numbers from a run: what the summary of a run says."""
