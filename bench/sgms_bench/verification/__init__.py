"""Properties of emitted C for any input and any compiler: `python -m sgms_bench.verification`."""
