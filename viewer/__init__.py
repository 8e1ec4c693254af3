"""A picture of a run, while it lasts or afterwards: the robot in 3D and the plots that explain it.

The viewer only reads telemetry, in a process of its own, so that watching never slows the control
loop. It is the only package that imports rerun.
"""
