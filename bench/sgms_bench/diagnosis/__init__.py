"""How often a diagnosis is right: causes hidden in simulated logs, and what it makes of them."""
