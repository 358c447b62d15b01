"""Recognition of strings: from depth images with camera poses to a point chain model.

`recognition.pipeline.recognise` runs the stages in the order of the paper's flowchart (Fig. 2):
preprocessing -> registration -> centre line -> tracing or shirakawa -> refinement -> assembly -> grasping -> model.
Each stage is a function on arrays that returns a small frozen dataclass. No stage uses files, robots or HTTP.

A string is the object on the table. A fragment (graph method) or segment (paper's methods) is a part of the centre line
that was linked without a gap. A strand consists of joined fragments or segments. A chain is the ordered points of one
string in the model.
"""
