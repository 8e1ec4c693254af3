"""Benchmarks, measured in one run on one pinned core and stated with machine and versions."""
