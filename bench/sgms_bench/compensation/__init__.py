"""Friction compensation in closed loop, by several methods."""
