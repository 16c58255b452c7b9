"""The simulated axis, independent of the model the estimator is generated from, and the moves it makes."""
