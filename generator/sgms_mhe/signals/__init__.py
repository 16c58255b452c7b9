"""Measured and estimated signals: logs, the chain from log to signals, estimates and their status."""
