"""The state of the virtual robot: joints, program, safety, registers.

In: commands of the servers and the time. Out: the state that the servers report.
"""
