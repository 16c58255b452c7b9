"""Estimators along logs: comparison with the reference, prediction, tuning, watching, acceptance in CI."""
