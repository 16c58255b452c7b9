"""Generator of embedded friction observers: S-GMS friction model, moving horizon estimation, emitted C."""

__version__ = "0.1.0"
