"""The service around the cell: its HTTP API, its jobs, its data on disk, and the command line.

A request enters in `api`, becomes a job in `jobs`, and its recording is recognised in `processing`; `storage` keeps the
rows and files. `cli` starts the service and has the commands that need none.
"""
