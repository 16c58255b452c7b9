"""What a machine's observer is worth: benchmarks, studies, the paper's experiment, comparisons, and their figures."""
