"""Nodes of a deployment as FMUs for other tools."""
