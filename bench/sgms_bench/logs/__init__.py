"""Logs as people's recorders write them: dialects, faults, random changes; and what came of reading each."""
