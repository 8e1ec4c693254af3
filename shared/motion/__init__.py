"""Where the robot should be, as a function of time: pure, the same at both ends of the link."""
