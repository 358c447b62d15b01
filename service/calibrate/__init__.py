"""The command line's calibrating: `pointchain calibrate board | run | verify | solve | activate`."""
