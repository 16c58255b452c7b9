"""Emitted packages compiled for this computer and called from Python."""
