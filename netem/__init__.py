"""The emulated link: replays one-way delays recorded on, or simulated of, a real one."""
