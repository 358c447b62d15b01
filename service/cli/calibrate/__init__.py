"""The commands `pointchain calibrate board | run | verify | solve | activate`."""
