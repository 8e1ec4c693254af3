"""Generate delay profiles of a 5G mmWave link; `docs/network-model.md`."""
