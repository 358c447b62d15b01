"""Hand-eye calibration: images of a board with flange poses go in, the pose of the camera on the flange comes out.

`calibration.hand_eye.solve_hand_eye` runs the steps: input_checks -> pose_estimation -> solver -> assessment.
A dataset folder holds the images, storage writes the result, and verification checks later whether it still holds.
"""
