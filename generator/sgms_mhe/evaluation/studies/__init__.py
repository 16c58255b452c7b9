"""Statistics of the estimator, a module each; `python -m sgms_mhe.evaluation.studies NAME` prints one."""
