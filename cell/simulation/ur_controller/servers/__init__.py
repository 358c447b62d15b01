"""The network ports of the virtual controller: RTDE, dashboard, script and administration.

In: bytes of clients. Out: commands to the virtual robot, and its state as bytes.
"""
