"""A rehearsal looked at while it runs or afterwards, without disturbing it.

In come the journals of a run folder or the frames of its buses, out come snapshots, tables, a
figure, and messages for plotting tools.
"""
