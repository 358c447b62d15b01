"""From chains and crossings to grasps of a parallel gripper."""
