"""Benchmarks: what the project reaches, figure by figure, with the command `make bench`."""
