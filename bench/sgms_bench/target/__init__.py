"""The package on an emulated microcontroller: instructions, memory, stack."""
