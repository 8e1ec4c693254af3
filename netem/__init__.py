"""The emulated link: replays one-way delays that were recorded on a real link or simulated."""
