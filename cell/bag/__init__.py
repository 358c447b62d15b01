"""ROS 1 and ROS 2 bags of a depth camera on an arm, as recordings.

`rosbags`, the optional package that reads them, is imported when a bag is opened and not before.
"""
