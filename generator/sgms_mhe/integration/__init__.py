"""How an element is integrated: Runge-Kutta schemes, the flow in closed form, what work each precision takes."""
