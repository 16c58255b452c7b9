"""Logs behind the signal chain as rows and blocks, their excitation, and the evidence of a fit."""
