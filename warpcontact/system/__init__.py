"""Interface to the machine: devices, memory, compilation of kernels, signals."""
