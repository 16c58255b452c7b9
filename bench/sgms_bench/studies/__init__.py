"""Statistics of the estimator, a module each; `python -m sgms_bench.studies NAME` prints one."""
