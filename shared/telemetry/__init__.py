"""Rows of measurements: their columns, their way out of a loop, and metrics from them."""
