"""Studies: many lockstep trials, played on all cores and kept as they finish."""
