"""Figures of the reproduction of the paper."""
