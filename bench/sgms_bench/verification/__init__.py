"""What emitted C holds whatever comes in, wherever it is compiled: `python -m sgms_bench.verification`."""
