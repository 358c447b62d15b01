"""From checked observations to the hand-eye transform with its covariance."""
