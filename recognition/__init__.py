"""Recognition of strings: depth images with camera poses go in, a point chain model comes out.

`recognition.pipeline.recognise` runs the stages in the order of the paper's flowchart (Fig. 2):
preprocessing -> registration -> centre line -> tracing or shirakawa -> refinement -> assembly -> grasping -> model.
Each stage is a function on arrays that returns a small frozen dataclass; no stage knows files, robots or HTTP.

A string is the object on the table. A fragment (graph) or segment (paper) is a part of its centre line that was linked
without a gap. A strand consists of joined fragments or segments. A chain is a strand of the final model.
"""
