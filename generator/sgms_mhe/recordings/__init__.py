"""Logs behind the signal chain as rows and blocks, what they excite, and what a fit to them proves."""
