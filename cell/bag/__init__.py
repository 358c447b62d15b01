"""ROS 1 and ROS 2 bags of a depth camera on an arm, as recordings.

In: a bag with depth images and transforms. Out: a recording with one view for each position at which the arm stood
still. `rosbags`, the optional package that reads bags, is imported when a bag is opened.
"""
