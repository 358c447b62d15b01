"""Tracing of the strands, by the graph method.

The centre points c_i of eq. (1) and a height map of the registered surface go in. Strands come out, with the nodes and
fragments they were traced from and the pairs of fragment ends that were joined. The method is ours: it replaces the
matching methods of sections II.G and III of the paper.
"""

from recognition.tracing.trace import TracedStrands, trace_strands

__all__ = ["TracedStrands", "trace_strands"]
