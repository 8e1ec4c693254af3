"""The robot: simulated plant, sensors, and the cheap local controller at 1 kHz."""
