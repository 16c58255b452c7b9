"""The public functions of `import sgms_mhe`: one per task; the commands of the same names call them too.

The package's own `__init__` hands each on when it is asked for, so that `import sgms_mhe` alone costs nothing.
"""
