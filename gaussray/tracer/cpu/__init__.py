"""The tracer in machine code for CPUs (Numba): lists of bundles, marches, and their gradients."""
