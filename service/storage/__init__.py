"""What survives a restart: rows in SQLite, and the files in the data folder."""
