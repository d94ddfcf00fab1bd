"""Commands that measure a path between two machines: ping and pong."""
