"""From depth views to point chain models: the method of Shirakawa et al., one file a stage.

`pipeline.recognise` reads like the paper's flowchart (Fig. 2). All stages are functions on arrays that return
small frozen values; nothing here knows of files, robots or HTTP.
"""
