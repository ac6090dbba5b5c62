"""The machine: devices, memory, compilation of kernels, signals."""
