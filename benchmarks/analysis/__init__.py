"""Analyses that only benchmarks and tests use: observability, Cramér-Rao bound, fits of index models."""
