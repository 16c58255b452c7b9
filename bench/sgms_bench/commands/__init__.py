"""Commands that an installed workbench adds to `sgms-mhe`, one per module."""
