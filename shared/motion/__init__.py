"""The reference of the robot as a function of time: pure, the same at both ends of the link."""
