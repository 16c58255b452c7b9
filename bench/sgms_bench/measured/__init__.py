"""Records of real axes: ours beside the numbers that were published of them."""
