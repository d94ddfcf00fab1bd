"""Participants: programs in place of a node's process."""
