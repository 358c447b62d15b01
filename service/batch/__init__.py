"""Recognition of many recordings with several processes or machines, and the comparison of two runs.

In: recordings, and how to recognise them. Out: one line per recording, on stdout or in a JSON lines or Parquet file.
`compare` takes two such files and lists what changed.
"""
