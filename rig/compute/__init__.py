"""How work is done: worker processes, clusters, compiled kernels."""
