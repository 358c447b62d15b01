"""Judge grasps on the true scene: simulate them with contact and friction, and measure the clearance of the gripper.

In: the truth of a simulated scene, a gripper, and the grasps of a model. Out: whether each grasp lifts the right string
and what the gripper touches. The physics engine is MuJoCo, which is imported when a world is built. Only development
needs this package, and the wheel does not contain it.
"""
