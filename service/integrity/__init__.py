"""Integrity check of the data folder: compares the database with the files, and repairs what can be repaired.

In: a data folder, which may be in use by a service. Out: a list of findings, each with what to do. A repair copies the
database to `lost+found`, corrects or removes rows, and moves files to `lost+found`. It deletes no file that holds data.
"""
