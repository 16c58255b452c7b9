"""The simulated axis, independent of the model that the estimator is generated from, and the moves that it makes."""
