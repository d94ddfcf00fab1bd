"""A campaign of faults of drives: whole lives of nodes in simulated time, judged by their buses."""
