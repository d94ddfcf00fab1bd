"""Tests of MuJoCo scenes as components; skipped where MuJoCo is not installed."""
