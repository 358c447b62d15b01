"""Hand-eye calibration: images of a board with flange poses go in, the pose of the camera on the flange comes out.

`calibration.hand_eye.solve_hand_eye` runs the steps: input_checks -> pose_estimation -> solver -> assessment.
`dataset` reads folders of images, `storage` reads and writes results, and `verification` checks a stored calibration.
"""
