"""Kernels of the processor: C++ for what takes most of a query's time, built with the package. Tensors say the same in the step itself."""
