"""The view of a run, live or afterwards: the robot in 3D, and plots that explain its motion.

The viewer only reads telemetry, in a separate process, so that watching never slows the control
loop. It is the only package that imports rerun.
"""
