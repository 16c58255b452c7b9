"""Time, instructions and errors of an update, beside what CasADi exports."""
