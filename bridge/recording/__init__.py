"""What was recorded, as a run folder: made of journals, read while they grow, recovered.

In come the journals of nodes, ended, running or killed; out come signals, link tables and bus logs
as every other tool reads them.
"""
