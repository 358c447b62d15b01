"""Other programs' files: ROS bags in, point clouds and tables of models out."""
