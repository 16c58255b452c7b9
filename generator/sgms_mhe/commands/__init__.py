"""The commands of `sgms-mhe`, one module each with its click command as `command`.

Modules import at their top only the needs of --help; the computing modules are imported where they are used, so that
--help answers at once.
"""
