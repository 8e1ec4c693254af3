"""Measure a real path as a delay profile; `docs/recording.md`."""
