"""Network servers of the virtual controller: RTDE, dashboard, script and administration.

Input: bytes from clients. Output: commands to the virtual robot, and its state as bytes.
"""
