"""Import and export of files of other programs.

In: ROS bags, point clouds and folders of depth images, which become recordings. Out: models as point clouds with edges
(PLY), tables (CSV) and scenes (MCAP). Each module serves one command and prints its report to stderr.
"""
