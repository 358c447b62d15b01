"""Tracing of strands by the graph method.

The input is the centre points c_i of eq. (1) and an occlusion map of the registered surface. The output is the strands,
with their nodes, their fragments and the joined pairs of fragment ends.

The graph method is not in the paper. It replaces the matching methods of sections II.G and III.
"""

from recognition.tracing.trace import TracedStrands, trace_strands

__all__ = ["TracedStrands", "trace_strands"]
