"""What is measured and what is estimated from it: logs, the chain from log to signals, estimates and their status."""
