"""The commands of `sgms-mhe`, one module each with its click command as `command`.

Modules import at their top only what --help needs; what computes is imported where it is used, so that --help answers
at once.
"""
