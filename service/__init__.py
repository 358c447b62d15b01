"""The service around the cell: HTTP, jobs, results on disk, configuration and the command line."""
