"""From the point clouds of all views to one cloud, with the covariance of the corrected camera poses."""
