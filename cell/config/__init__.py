"""The settings of a cell, validated: arm, camera, mounting, workspace, hand-eye calibration and scan.

In: values of a configuration file. Out: a frozen `CellSettings`, or an error that names the wrong value. Nothing here
opens a device.
"""
