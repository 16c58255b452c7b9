"""What `import sgms_mhe` gives: one function per thing to do, which the commands of the same names call too.

The package's own `__init__` hands each on when it is asked for, so that `import sgms_mhe` alone costs nothing.
"""
